"""The sweep of ablations: its table, what it takes away, what it compares with, and how it judges."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from experiments.ablate import EVERYTHING, NOTHING, PARTS, SWEEPS, Settings, floor_deg, run, table, without
from experiments.common.at_place import bank_with, judged_at_place, only, scores_at_place
from experiments.common.frames import GROUND_RANGE_M, TestFrame
from experiments.common.metrics import summary_deg
from experiments.common.runs import Job
from experiments.common.trainings import ALONE, SIZES, VARIANTS, recipe_of
from sonarjax.segment.training import find_recipe
from sonarjax.sensor import SensorModel


def frame(yaw_deg: float, is_target: bool = True, tilt_deg: float = 20.0) -> TestFrame:
    """A frame of which only the truth matters."""
    nothing = np.zeros((1, 1), np.float32)
    return TestFrame(nothing, nothing, is_target, math.radians(yaw_deg), tilt_deg)


def bank_of(templates: np.ndarray) -> sj.TemplateBank:
    """A bank (yaw, h, w) of which only the templates matter."""
    place = (jnp.float32(v) for v in (2.2, 0.0, 0.35))
    return sj.TemplateBank(jnp.asarray(templates), jnp.arange(float(len(templates))), jnp.zeros(2, int), *place)


@pytest.mark.parametrize("width", [2.0, 30.0])
def test_floor_is_that_of_rounding_to_the_nearest_bin(width, rng):
    yaw = rng.uniform(0.0, 360.0, 200_000)
    drawn = summary_deg(np.abs(yaw - width * np.round(yaw / width)))
    for name, value in floor_deg(width).items():  # a share of 200,000 draws is good to 0.2 %
        assert value == pytest.approx(drawn[name], rel=0.01)


def test_only_one_class_is_left_of_a_template():
    grey = np.array([[0.0, 0.3, 0.5], [0.5, 0.8, 1.0]], np.float32)
    np.testing.assert_array_equal(only("both", grey), grey)
    np.testing.assert_array_equal(only("highlight", grey), np.float32([[0.5, 0.5, 0.5], [0.5, 0.8, 1.0]]))
    np.testing.assert_array_equal(only("shadow", grey), np.float32([[0.0, 0.3, 0.5], [0.5, 0.5, 0.5]]))


def test_a_map_matches_its_own_template_of_a_part(rng):
    templates = rng.choice(np.float32([0.0, 0.5, 1.0]), (4, 8, 6))
    image = np.full((40, 20), 0.5, np.float32)
    image[5:13, 7:13] = templates[2]
    for part in ("highlight", "shadow"):
        bank = bank_of(only(part, templates))
        scores = scores_at_place([only(part, image)], [frame(0.0)], {20.0: bank})
        assert scores.shape == (1, 4) and scores[0, 2] == pytest.approx(1.0, abs=1e-4) and scores.argmax() == 2
        whole = scores_at_place([image], [frame(0.0)], {20.0: bank})
        assert whole[0, 2] < 0.95  # what the template lacks is there in the map


def test_each_tilt_is_matched_with_its_own_bank(rng):
    template = {tilt: rng.random((4, 8, 6), np.float32) for tilt in (15.0, 25.0)}
    frames = [frame(0.0, tilt_deg=tilt) for tilt in (25.0, 15.0)]
    maps = [np.pad(template[f.tilt_deg][1], ((9, 23), (7, 7)), constant_values=0.5) for f in frames]
    banks = {tilt: bank_of(views) for tilt, views in template.items()}
    scores = scores_at_place(maps, frames, banks)
    np.testing.assert_allclose(scores[:, 1], 1.0, atol=1e-4)
    assert (np.delete(scores, 1, axis=1) < 0.9).all()


def test_scores_are_judged_by_bin_and_threshold():
    scores = np.full((4, 36), 0.1)
    scores[0, 3], scores[0, 9] = 0.9, 0.4  # 30°: right, and the best of the wrong ones 60° off
    scores[1, 34], scores[1, 35], scores[1, 0] = 0.6, 0.8, 0.7  # 354°: 350° is nearer than 360°
    scores[2, 20], scores[2, 2] = 0.7, 0.5  # 21°: taken for 200°
    scores[3, 5] = 0.75  # the other object
    found = judged_at_place(scores, [frame(30.0), frame(354.0), frame(21.0), frame(0.0, is_target=False)])
    assert found["best_accuracy"] == 0.75 and found["best_threshold"] == 0.8
    assert found["bin_right"] == pytest.approx(2 / 3)
    assert found["score_own"] == pytest.approx((0.9 + 0.8 + 0.5) / 3)
    assert found["score_wrong"] == pytest.approx((0.4 + 0.1 + 0.7) / 3)
    assert found["score_other"] == 0.75


def test_a_bank_is_rendered_for_the_wrong_geometry(monkeypatch):
    monkeypatch.setattr(
        sj, "template_bank", lambda mesh, sonar, yaws, *, x, engine: (math.degrees(float(sonar.tilt)), x)
    )
    bank_of = bank_with.__wrapped__  # not the one that is kept
    assert bank_of(20.0, -5.0, 0.0) == pytest.approx((15.0, GROUND_RANGE_M[20.0]))
    assert bank_of(25.0, 0.0, 0.3) == pytest.approx((25.0, GROUND_RANGE_M[25.0] + 0.3))


def test_switching_off_changes_only_what_it_names():
    nominal = SensorModel.nominal()
    assert without(NOTHING) == nominal
    for part, change in PARTS.items():
        model = without(part)
        differing = {f.name for f in fields(nominal) if getattr(model, f.name) != getattr(nominal, f.name)}
        assert differing == set(change)
    everything = without(EVERYTHING)
    for part, change in PARTS.items():
        assert replace(everything, **change) == everything, part


@pytest.mark.parametrize(("vary", "value", "said"), [
    ("yaw_bin", "7", "divisors of 360, got 7"), ("yaw_bin", "0", "divisors of 360, got 0"),
    ("tilt", "x", "numbers, got 'x'"), ("sensor", "rain", "speckle, .* got 'rain'"),
    ("training", "eq. 4", "eq. 3, .* got 'eq. 4'"),
])  # fmt: skip
def test_a_value_that_there_is_not_is_refused(vary, value, said):
    with pytest.raises(ValueError, match=f"^--values: expected (some of )?.*{said}"):
        Settings(vary=vary, values=(str(SWEEPS[vary].values[0]), value))


def test_values_are_the_tables_or_some_or_the_first_of_them():
    assert Settings(vary="tilt").chosen() == list(SWEEPS["tilt"].values)
    assert Settings(vary="training").chosen() == list(VARIANTS)
    assert Settings(vary="training", values=tuple(SIZES)).chosen() == list(SIZES)
    assert Settings(vary="distance", values=("-0.07", "2")).chosen() == [-0.07, 2.0]
    assert Settings(vary="sensor", most=1).chosen() == [NOTHING]


@pytest.mark.parametrize("vary", SWEEPS)
def test_a_table_has_a_column_for_each_head(vary):
    heads = ("value", "map", *SWEEPS[vary].columns)
    lines = table({"vary": vary, "rows": [dict.fromkeys(heads, 0.5)]}).splitlines()
    assert lines[0].count("|") == len(heads) + 1 == lines[2].count("|") and "–" not in lines[2]
    assert all(line.partition(": ")[0] in lines[0] for line in lines[4:])  # what the columns mean


@pytest.mark.slow
@pytest.mark.parametrize("vary", SWEEPS)
def test_each_sweep_has_a_row_for_each_value_and_map_with_all_that_its_table_shows(vary, tmp_path):
    small = {"step_deg": 180, "tilts_deg": (20.0,), "width": 4, "images": 8, "pairs": 8, "validation_pairs": 8}
    several = vary == "template"  # a quick one; of the others one row shows what their tables need
    values, maps = (SWEEPS[vary].values[1:3], ("none", "truth")) if several else (SWEEPS[vary].values[1:2], ("truth",))
    settings = Settings(vary=vary, values=tuple(map(str, values)), maps=maps, **small)
    maps = ("pix2pix",) if vary == "training" else settings.maps
    rows = run(settings, Job(tmp_path, 0))["rows"]
    assert [(row["value"], row["map"]) for row in rows] == [(v, name) for v in settings.chosen() for name in maps]
    assert all(SWEEPS[vary].columns.keys() <= row.keys() for row in rows)


@pytest.mark.parametrize("variant", VARIANTS)
def test_trainings_are_a_third_of_the_papers_and_differ_in_one_thing(variant, tmp_path):
    paper, settings = find_recipe("paper-cpu"), Settings()
    recipe = recipe_of(variant, settings, 2, tmp_path).checked()
    assert 3 * recipe.steps == paper.steps and (recipe.batch, recipe.pairs) == (paper.batch, paper.pairs)
    usual = {"name": paper.name, "run_seed": 0, "passes": paper.passes, "source": None, "discriminative": False}
    assert replace(recipe, networks=paper.networks, **usual) == paper
    changed = {
        f.name for f in fields(paper.networks) if getattr(recipe.networks, f.name) != getattr(paper.networks, f.name)
    }
    assert changed == set(VARIANTS[variant])
    assert recipe.discriminative == (variant == ALONE)


@pytest.mark.parametrize(("variant", "pairs", "passes", "sets"), [
    ("a quarter of the pairs", 2, 8, 1), ("eq. 3", 8, 2, 1), ("four times the pairs", 8, 1, 4),
])  # fmt: skip
def test_more_or_fewer_pairs_are_seen_as_often_in_all(variant, pairs, passes, sets, tmp_path):
    settings = Settings(pairs=8, images=16 if variant != "four times the pairs" else 32, batch=2)
    recipe = recipe_of(variant, settings, 0, tmp_path)
    assert (recipe.pairs, recipe.passes, recipe.sets) == (pairs, passes, sets)
    assert recipe.source == (None if sets > 1 else str(tmp_path))
    assert recipe.steps * recipe.batch == settings.images
