"""The independent judge: that it is independent, and that its rays, speckle and frames are what physics says."""

from __future__ import annotations

import ast
import math
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the judge's ray tracer (extra `test` or `bench`) has no build for this machine")

import sonarjax
from experiments import judge
from experiments.judge import echoes
from experiments.judge.device import Device
from experiments.judge.display import grey, stored
from experiments.judge.frames import KINDS, JudgeFrame, iterate, judge_frames, mirrored, surface
from experiments.judge.labels import BACKGROUND, HIGHLIGHT, SHADOW, labels
from experiments.judge.raycast import FLOOR, OBJECT, Hits, cast, place
from experiments.judge.sensor import beam_pattern, field, store
from experiments.judge.view import SAMPLES, View
from sonarjax.scene import Mesh, objects
from sonarjax.sonar import Sonar

ALLOWED = ("sonarjax.scene", "sonarjax.sonar", "sonarjax.io.errors")
HEIGHT = 0.9
LOADED = """
import importlib, pkgutil, sys, types
package = types.ModuleType("sonarjax")
package.__path__ = [sys.argv[1]]  # an empty package stands in for sonarjax/__init__.py, which loads everything
sys.modules["sonarjax"] = package
from experiments import judge
for found in pkgutil.iter_modules(judge.__path__):
    importlib.import_module(f"experiments.judge.{found.name}")
print(*sorted({name.split(".")[1] for name in sys.modules if name.startswith("sonarjax.")}))
"""
"""Loads the judge, and prints the parts of the package that it needs."""


def view(tilt_deg: float = 20.0, **changes: bool) -> View:
    return View.of(Sonar.preset("didson-hf"), math.radians(tilt_deg), HEIGHT, **changes)


def block(x: float, size: tuple[float, float, float]) -> np.ndarray:
    """Triangles of a box on the floor around (x, 0)."""
    mesh = Mesh.from_arrays(*objects.box(size, (0.0, 0.0, size[2] / 2)))
    return place(*surface(mesh), x, 0.0, 0.0)


def middle(hits: Hits) -> int:
    """The sub-beam nearest straight ahead."""
    return int(np.abs(hits.view.sub_azimuth).argmin())


@pytest.fixture(scope="module")
def bare() -> Hits:
    return cast(np.zeros((0, 3, 3)), view())


@lru_cache
def frames_of(kind: str) -> list[JudgeFrame]:
    return judge_frames(1, kind, 360)


def imported(path: Path) -> set[str]:
    """Full names of everything a file imports; `from a import b` gives a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_the_judge_imports_nothing_of_what_it_judges() -> None:
    files = sorted(Path(judge.__file__).parent.rglob("*.py"))
    assert len(files) >= 8
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert "import_module" not in text and "__import__" not in text
        for name in imported(path):
            root = name.split(".")[0]
            assert root not in ("jax", "jaxlib", "flax"), f"{path}: {name}"
            if root == "sonarjax":
                assert any(name == known or name.startswith(known + ".") for known in ALLOWED), f"{path}: {name}"
            if root == "experiments":
                assert name.startswith("experiments.judge."), f"{path}: {name}"


def test_nothing_of_what_it_judges_is_loaded_by_other_parts_of_the_package() -> None:
    package = Path(sonarjax.__file__).parent
    run = [sys.executable, "-c", LOADED, str(package)]
    loaded = subprocess.run(run, capture_output=True, text=True, check=True, cwd=package.parent).stdout.split()
    assert set(loaded) == {"exact", "io", "records", "scene", "sonar"}


@pytest.mark.parametrize("conical", [False, True])
def test_a_boxs_front_and_shadow_lie_where_the_closed_form_says(conical: bool) -> None:
    front, back, top = 2.2, 2.4, 0.12
    hits = cast(block((front + back) / 2, (back - front, 0.4, top)), view(conical=conical))
    column = middle(hits)
    seen = hits.kind[:, column] == OBJECT
    step = hits.view.range_bin / SAMPLES
    assert hits.distance[seen, column].min() == pytest.approx(math.hypot(front, HEIGHT - top), abs=step)
    hidden = np.flatnonzero(seen[: len(hits.view.sample_ranges)])
    shadow_end = back * HEIGHT / (HEIGHT - top)
    assert hits.view.sample_ranges[hidden[0]] == pytest.approx(math.hypot(front, HEIGHT), abs=1.5 * step)
    assert hits.view.sample_ranges[hidden[-1]] == pytest.approx(math.hypot(shadow_end, HEIGHT), abs=1.5 * step)
    face = hits.distance[:, column] < math.hypot(front, HEIGHT - top) - step
    assert not face[seen].any()


def test_the_labels_are_the_box_and_its_shadow() -> None:
    front, back, top = 2.2, 2.4, 0.12
    hits = cast(block((front + back) / 2, (back - front, 0.4, top)), view())
    column = labels(hits, Device.nominal())[:, hits.view.n_beams // 2]
    r = hits.view.ranges
    near, far = (math.hypot(g, HEIGHT - top) for g in (front, back))
    end = math.hypot(back * HEIGHT / (HEIGHT - top), HEIGHT)
    expected = np.where((r > near) & (r < far), HIGHLIGHT, np.where((r >= far) & (r < end), SHADOW, BACKGROUND))
    assert (column != expected).sum() <= 3  # one bin at each end


def test_a_slabs_top_is_a_nearer_floor() -> None:
    top = 0.05
    hits = cast(block(2.4, (1.2, 3.0, top)), view())
    column = middle(hits)
    rows = np.flatnonzero((hits.kind[:, column] == OBJECT) & (hits.sine < 0.40) & (hits.sine > 0.32))
    assert len(rows) > 100
    np.testing.assert_allclose(hits.distance[rows, column], (HEIGHT - top) / hits.sine[rows], rtol=1e-5)
    np.testing.assert_allclose(hits.cosine[rows, column], hits.sine[rows], rtol=1e-4)


def test_elevation_and_direction_agree_with_the_depression() -> None:
    for conical in (False, True):
        seen = view(conical=conical)
        sine = seen.height / seen.sample_ranges[::50]
        rays = seen.directions(seen.elevation(sine), slice(None))
        np.testing.assert_allclose(-rays[..., 2], np.broadcast_to(sine[:, None], rays.shape[:2]), atol=2e-6)
        np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-6)


def test_a_mirror_images_range_is_that_of_the_path_over_the_floor() -> None:
    x, z = 2.3, 0.1
    spot = np.array([[[x, -0.02, z], [x, 0.02, z], [x, 0.0, z + 0.004]]])
    hits = cast(spot, view())
    direct, over = math.hypot(x, HEIGHT - z), math.hypot(x, HEIGHT + z)
    assert len(hits.two_bounces.length) > 0 and len(hits.one_bounce.length) > 0
    np.testing.assert_allclose(hits.two_bounces.length, over, atol=0.003)
    np.testing.assert_allclose(hits.one_bounce.length, (direct + over) / 2, atol=0.003)
    np.testing.assert_allclose(hits.direct().length, direct, atol=0.003)


def test_energy_over_a_flat_floor_follows_its_closed_form(bare: Hits) -> None:
    device = replace(Device.nominal(), droop_db=0.0, temperature_c=15.0)
    power = echoes.floor_echo(bare, device)[:, middle(bare)]
    r = bare.view.sample_ranges
    lit = (np.abs(bare.elevation[: len(r), middle(bare)]) < bare.view.aperture / 2 - 0.01) & (r > r[1]) & (r < r[-2])
    # Lambert's sine of depression / r² × the angle a step of range spans at the head.
    step = bare.view.range_bin / SAMPLES * HEIGHT / (r * np.sqrt(r**2 - HEIGHT**2))
    lost = 10 ** (-0.2 * echoes.absorption_db_m(1.8e6, 15.0) * r)
    expected = HEIGHT / r / r**2 * step * lost
    np.testing.assert_allclose((power / expected)[lit], (power / expected)[lit][0], rtol=0.01)
    assert echoes.absorption_db_m(1.8e6, 15.0) == pytest.approx(0.84, abs=0.02)  # Francois, Garrison 1982, A₃f²


def local_variation(intensity: np.ndarray, lit: np.ndarray) -> float:
    """Coefficient of variation of the intensity over the mean of 16 × 8 pixels around it."""
    rows, beams = (n // m * m for n, m in zip(intensity.shape, (16, 8), strict=True))
    tiles = intensity[:rows, :beams].reshape(rows // 16, 16, beams // 8, 8)
    inside = lit[:rows, :beams].reshape(tiles.shape).all(axis=(1, 3))
    mean = tiles.mean(axis=(1, 3))
    spread = (tiles**2).mean(axis=(1, 3)) - mean**2
    return float(np.sqrt((spread[inside] / mean[inside] ** 2).mean()))


@pytest.mark.parametrize(("texture_shape", "low", "high"), [(1e6, 0.93, 1.05), (8.0, 0.98, 1.2)])
def test_one_look_at_a_bare_floor_is_speckle(
    bare: Hits, rng: np.random.Generator, texture_shape: float, low: float, high: float
) -> None:
    device = replace(Device.nominal(), law="power", gamma=1.0, floor_grey=0.12, texture_shape=texture_shape)
    amplitude = store(bare, device, rng).astype(float)
    lit = np.abs(bare.elevation[1 : bare.view.n_ranges * SAMPLES : SAMPLES, bare.view.inner][:, ::4]) < 0.11
    assert lit.any()
    assert low < local_variation(amplitude**2, lit) < high


@pytest.mark.parametrize("ratio", [1.0, 1.6])
def test_neighbouring_beams_hang_together_as_their_patterns_overlap(rng: np.random.Generator, ratio: float) -> None:
    seen = view()
    device = replace(Device.nominal(), beam_width_ratio=ratio, stray_db=-200.0)
    even = np.ones((seen.n_ranges * SAMPLES, len(seen.sub_azimuth)), np.float32)
    amplitude = field(even, seen, device, rng)
    overlap = np.corrcoef(np.stack([amplitude[:, :-1].ravel(), amplitude[:, 1:].ravel()]))
    pattern = beam_pattern(seen, device)
    expected = (pattern[:, 40] * pattern[:, 41]).sum() / (pattern[:, 40] ** 2).sum()
    assert abs(overlap[0, 1]) == pytest.approx(expected, abs=0.03)
    # Intensities of neighbours correlate by its square: 0.06 (ARIS, hardly at all) to 0.6 (Oculus) were measured.
    assert 0.05 < expected**2 < 0.65


def test_a_beam_is_as_wide_as_it_says() -> None:
    seen = view()
    for both_ways in (False, True):
        device = replace(Device.nominal(), both_ways=both_ways, beam_width_ratio=1.3)
        power = beam_pattern(seen, device)[:, 48] ** 2
        half = seen.centers[48] + 1.3 * np.diff(seen.edges)[48] / 2
        assert np.interp(half, seen.sub_azimuth, power) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("law", ["db", "power", "arctan"])
def test_display_laws_rise_within_8_bits(law: str) -> None:
    device = replace(Device.nominal(), law=law, automatic_gain=0.0)
    power = np.concatenate([[0.0], np.logspace(-8, 8, 400)])
    shade = grey(power, device)
    assert (np.diff(shade) >= 0).all() and shade.min() >= 0 and shade.max() <= 1
    assert grey(np.array([1.0]), device)[0] == pytest.approx(device.floor_grey)
    picture = stored(power[:, None], device)
    assert picture.dtype == np.uint8 and (np.diff(picture[:, 0].astype(int)) >= 0).all()


def test_the_automatic_gain_darkens_the_rest_when_a_peak_comes() -> None:
    device = replace(Device.nominal(), automatic_gain=0.5)
    power = np.ones((4, 4))
    peak = power.copy()
    peak[0, 0] = 1e6
    assert (stored(peak, device)[1:] < stored(power, device)[1:]).all()


def test_faces_are_brighter_and_shadows_darker_than_the_floor() -> None:
    for frame in frames_of("offset"):
        band = np.flatnonzero((frame.labels != BACKGROUND).any(axis=1))
        near = np.zeros(frame.labels.shape, bool)
        near[band[0] : band[-1]] = True
        floor, bright, dark = (frame.image[near & (frame.labels == c)].mean() for c in (BACKGROUND, HIGHLIGHT, SHADOW))
        assert dark < floor < bright


def test_the_same_seed_gives_the_same_frames_and_another_does_not() -> None:
    first, again, other = (list(islice(iterate(seed, "devices", 360), 3)) for seed in (5, 5, 6))
    for a, b, c in zip(first, again, other, strict=True):
        assert (a.image == b.image).all() and (a.labels == b.labels).all() and a.yaw == b.yaw
        assert (a.image != c.image).any()


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_what_their_kind_says(kind: str) -> None:
    frames = frames_of(kind)
    assert [frame.is_target for frame in frames] == [True, False] * 4
    for frame in frames:
        assert frame.image.shape == frame.labels.shape == frame.sonar.shape
        assert frame.image.dtype == np.float32 and frame.image.min() >= 0 and frame.image.max() <= 1
        assert {HIGHLIGHT, SHADOW} <= set(np.unique(frame.labels))
        off_grid = abs((math.degrees(frame.yaw) + 90) % 180 - 90)
        assert off_grid < 1e-6 if kind == "severe" else off_grid <= 5
        assert abs(frame.tilt_deg - math.degrees(float(frame.sonar.tilt))) <= 1.001
        assert abs(frame.height - HEIGHT) <= 0.0101
    assert len({id(frame.sonar) for frame in frames}) == 4
    assert len({frame.image.shape for frame in frames}) == (4 if kind == "devices" else 1)


def test_a_mirror_image_keeps_its_outside_outside() -> None:
    vertices, faces = surface(objects.target())
    other, turned = mirrored((vertices, faces))

    def volume(v: np.ndarray, f: np.ndarray) -> float:
        a, b, c = (v[f[:, i]] for i in range(3))
        return float((a * np.cross(b, c)).sum() / 6)

    assert volume(other, turned) == pytest.approx(volume(vertices, faces))
    assert volume(vertices, faces) > 0


def test_impossible_wishes_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown kind"):
        judge_frames(0, "easy")
    with pytest.raises(ValueError, match="step_deg"):
        judge_frames(0, "offset", 0.0)
    with pytest.raises(ValueError, match="severity"):
        Device.nominal(0.0)
    with pytest.raises(ValueError, match="unknown display law"):
        grey(np.ones(1), replace(Device.nominal(), law="gamma"))
    with pytest.raises(ValueError, match="nearer than the floor"):
        cast(np.zeros((0, 3, 3)), replace(view(), range_min=0.5))
    assert (cast(np.zeros((0, 3, 3)), view()).kind == FLOOR).all()


def test_leaning_frames_lean_float_and_are_seen_from_two_sides() -> None:
    from scipy.spatial.transform import Rotation

    from experiments.judge.leaning import LEAN_DEG, LIFT_M, leaning_frames, rotation

    np.testing.assert_allclose(
        rotation(0.7, 0.2, -0.3), Rotation.from_euler("ZYX", [0.7, -0.3, 0.2]).as_matrix(), atol=1e-12
    )
    first, again = (list(leaning_frames(3, 2, 20.0, True)) for _ in range(2))
    vertices = np.asarray(objects.target().vertices, float)
    for one, same in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.images, same.images)
        x, y, z, yaw, roll, pitch = one.pose
        assert np.degrees(max(abs(roll), abs(pitch))) <= LEAN_DEG
        lowest = (vertices @ rotation(yaw, roll, pitch).T)[:, 2].min() + z
        assert 0 <= lowest <= LIFT_M
        # Both sonars have the object 2.2 to 2.4 m away, near their axis, and look at it from 90° apart.
        for sonar in one.sonars:
            c, s = np.cos(sonar[2]), np.sin(sonar[2])
            ahead, aside = c * (x - sonar[0]) + s * (y - sonar[1]), c * (y - sonar[1]) - s * (x - sonar[0])
            assert 2.19 < math.hypot(ahead, aside) < 2.41 and abs(math.atan2(aside, ahead)) < math.radians(4.01)
        assert one.sonars[1, 2] - one.sonars[0, 2] == pytest.approx(math.pi / 2)
        assert np.abs(one.images[0] - one.images[1]).mean() > 0.01
    off = next(leaning_frames(3, 1, 20.0, False))
    assert np.abs(off.images - first[0].images).mean() > 1e-3


def test_given_objects_are_turned_reproducibly():
    from experiments.judge.turned import turned_frames

    sonar = Sonar.preset("didson-hf", tilt=math.radians(20.0))
    meshes = [objects.target(), objects.target()]
    first, again = (list(turned_frames(3, meshes, sonar, 20.0)) for _ in range(2))
    assert [frame.exact for frame in first] == [True, False]
    assert [frame.yaw for frame in first] == [frame.yaw for frame in again]
    assert first[0].yaw != first[1].yaw
    for one, other in zip(first, again, strict=True):
        assert one.image.shape == sonar.shape and one.image.std() > 0.01
        np.testing.assert_array_equal(one.image, other.image)
