"""Many targets at once: compact banks against eq. 4, and which targets the first look finds in rendered frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import sonarjax as sj
from sonarjax.match import FirstLook, SearchConfig, Sighting, TargetSearch, leading, match_positions
from sonarjax.match.compact import CompactBank, match_compact
from sonarjax.match.search import KEPT_COMPACT
from sonarjax.render import template_bank
from sonarjax.scene.objects import box

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20), height=0.9, n_ranges=128, range_min=1.5, range_max=4.0)
CONFIG = SearchConfig(yaw_bins=12, coarse_yaws=12, decimation=2, range_step=0.2, rank=24)


def boxes() -> dict[str, sj.Mesh]:
    """Three boxes that differ, of 12 triangles each."""
    sizes = {"plate": (0.4, 0.3, 0.05), "post": (0.08, 0.08, 0.35), "bar": (0.4, 0.06, 0.1)}
    return {name: sj.Mesh.from_arrays(*box(size, (0.0, 0.0, size[2] / 2)), name=name) for name, size in sizes.items()}


@pytest.fixture(scope="module")
def look() -> FirstLook:
    return FirstLook([TargetSearch(mesh, SONAR, CONFIG, name=name, compact=True) for name, mesh in boxes().items()])


@pytest.mark.parametrize("size", [(40, 20), (64, 16), (100, 64)])
def test_compact_banks_score_as_eq_4_does(size: tuple[int, int], semantic_image: Callable[..., np.ndarray]) -> None:
    rng, image = np.random.default_rng(0), semantic_image(3)
    image = image + rng.normal(0, 0.05, image.shape).astype(np.float32)
    templates = np.clip(np.stack([image[20 : 20 + size[0], : size[1]], image[30 : 30 + size[0], : size[1]] ** 2]), 0, 1)
    bank = CompactBank.of(templates)
    found, exact = match_compact(image, bank), match_positions(image, bank.templates)
    np.testing.assert_allclose(found.scores, exact.scores, atol=1e-4)
    np.testing.assert_array_equal(found.row, exact.row)
    np.testing.assert_array_equal(found.col, exact.col)
    assert abs(bank.templates - templates).max() <= 0.5 / 255 + 1e-6


def test_a_window_that_does_not_exist_is_not_the_best() -> None:
    templates = np.random.default_rng(0).uniform(0, 1, (3, 16, 12)).astype(np.float32)
    image = 1 - templates[0]  # the one window correlates negatively with the first template
    found, exact = match_compact(image, CompactBank.of(templates)), match_positions(image, templates)
    np.testing.assert_allclose(found.scores, exact.scores, atol=1e-2)
    assert found.scores[0] < -0.99 and not np.any(found.row) and not np.any(found.col)


def test_a_frame_that_is_constant_up_to_rounding_shows_nothing(look: FirstLook) -> None:
    steps = np.random.default_rng(0).integers(-2, 3, (128, 96)).astype(np.float32)
    image = np.float32(0.5) + steps * np.spacing(np.float32(0.5))
    assert np.ptp(image) > 0
    bank = CompactBank.of(np.random.default_rng(1).uniform(0, 1, (3, 40, 20)))
    np.testing.assert_array_equal(match_compact(image, bank).scores, 0.0)
    assert {sighting.score for sighting in look.best(image).values()} == {0.0}


@pytest.mark.parametrize(("name", "masked"), [("plate", False), ("post", True), ("bar", False)])
def test_first_look_finds_the_target_and_its_distance(look: FirstLook, name: str, masked: bool) -> None:
    image = np.asarray(sj.render(boxes()[name], sj.Pose(2.35, 0.1, 0.5), SONAR).semantic())
    mask = np.ones(image.shape, bool)
    mask[:5] = False
    found = look.best(image, mask if masked else None)
    assert max(found, key=lambda key: found[key].score) == name
    assert abs(look.searches[0].distances[found[name].distance_index] - math.hypot(2.35, 0.1)) <= 0.15


def test_a_score_is_near_that_of_eq_4(look: FirstLook) -> None:
    image = np.asarray(sj.render(boxes()["bar"], sj.Pose(2.35, 0.0, 0.5), SONAR).semantic())
    exact = look.searches[2].find(image).scores.max()
    assert look.best(image)["bar"].score == pytest.approx(float(exact), abs=look.residual + 0.1)
    assert 0 < look.residual < 0.5


def sightings(**scores: float) -> dict[str, Sighting]:
    return {name: Sighting(None, 0, score) for name, score in scores.items()}  # type: ignore[arg-type]


def test_candidates_are_near_the_best_on_map_or_frame() -> None:
    config = SearchConfig(candidates=4, lead=0.1)
    on_map, on_frame = sightings(a=0.9, b=0.85, c=0.7, d=0.6, e=0.5), sightings(a=0.2, b=0.1, c=0.58, d=0.5, e=0.6)
    assert leading([on_map], config) == ["a", "b"]
    assert leading([on_map, on_frame], config) == ["a", "b", "c"]  # e is best on the frame, but four others score more
    assert leading([sightings(a=0.9, b=0.1, c=0.1)], config) == ["a", "b"]  # there is a runner-up
    assert leading([sightings(a=0.9, b=0.1)], SearchConfig(candidates=1)) == ["a"]


def test_a_target_that_is_nowhere_in_view_is_named() -> None:
    high = sj.Mesh.from_arrays(*box((0.1, 0.1, 0.1), (0.0, 0.0, 5.0)), name="balloon")
    search = TargetSearch(high, SONAR, CONFIG, name="balloon", compact=True)
    with pytest.raises(sj.SonarjaxError, match="balloon: at no distance"):
        search.find_near(0, np.zeros(SONAR.shape, np.float32))
    with pytest.raises(sj.SonarjaxError, match="targets: at no distance"):
        FirstLook([search, search]).prepare()


def test_only_the_banks_that_were_looked_at_last_are_kept(look: FirstLook, monkeypatch: pytest.MonkeyPatch) -> None:
    rendered: list[float] = []

    def noted(mesh: sj.Mesh, sonar: sj.Sonar, yaws: np.ndarray, *, x: float, **how: Any) -> Any:
        rendered.append(x)
        return template_bank(mesh, sonar, yaws, x=x, **how)

    monkeypatch.setattr("sonarjax.match.search.template_bank", noted)
    search = TargetSearch(boxes()["bar"], SONAR, CONFIG, compact=True)
    images = [np.asarray(sj.render(search.mesh, sj.Pose(x), SONAR).semantic()) for x in search.distances[1:7]]
    first = [search.find_near(k + 1, image).scores for k, image in enumerate(images)]
    assert len(set(rendered)) == len(rendered) == len(images) > KEPT_COMPACT
    last = search.find_near(len(images), images[-1]).scores
    assert len(rendered) == len(images)
    np.testing.assert_array_equal(last, first[-1])
    again = search.find_near(1, images[0]).scores
    assert rendered[len(images) :] == rendered[:1]
    np.testing.assert_array_equal(again, first[0])


def test_a_first_look_takes_what_was_not_measured_for_background(look: FirstLook) -> None:
    image = np.asarray(sj.render(boxes()["bar"], sj.Pose(2.35, 0.1, 0.5), SONAR).semantic())
    mask = np.ones(image.shape, bool)
    mask[:5] = mask[:, :4] = False
    plain, holed = look.best(image), look.best(np.where(mask, image, np.nan), mask)
    for name, one in plain.items():
        assert holed[name].score == pytest.approx(one.score, abs=1e-3)
        assert holed[name].distance_index == one.distance_index
