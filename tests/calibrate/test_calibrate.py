"""`calibrate` from end to end on simulated frames, and what it refuses."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from experiments.incidence_limit import darkened
from sonarjax.calibrate import detect
from sonarjax.calibrate.calibration import WIDENING, _first_guess, _note_few_frames, _possible
from sonarjax.calibrate.detect import Prepared
from sonarjax.calibrate.fit import FINE, Job, _put_back, _starts, fit_frames, relative_residual, with_nominal_look
from sonarjax.calibrate.inputs import check_floor
from sonarjax.calibrate.linearise import OWN, Observation, linearise
from sonarjax.calibrate.look import LOOK
from sonarjax.calibrate.parameters import changed_sonar
from sonarjax.calibrate.picture import make_sampling
from sonarjax.engine import PLAIN
from sonarjax.render import WindowSize
from sonarjax.sensor import SensorModel, observe_scene
from sonarjax.sonar import GeometryStd

NOMINAL = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
FREE, OFF = ("tilt", "height"), (math.radians(2.0), -0.06)
COUNT = 6


@pytest.fixture(scope="module")
def frames():
    """Frames (frame, range, beam) of the target seen by a sonar that is off, the last of them another object; poses."""
    true = changed_sonar(NOMINAL, FREE, jnp.array(OFF))
    poses = [sj.Pose(2.25 + 0.05 * k, 0.04 * k - 0.1, 1.1 * k) for k in range(COUNT)]
    meshes = [sj.objects.target()] * (COUNT - 1) + [sj.objects.non_target()]
    model = jax.tree.map(jnp.float32, SensorModel.nominal())
    images = [
        np.asarray(observe_scene(mesh, pose, true, model, key=jax.random.key(k))[0])
        for k, (mesh, pose) in enumerate(zip(meshes, poses, strict=True))
    ]
    return images, poses


@pytest.mark.slow
@pytest.mark.computes
def test_tilt_and_height_come_back_and_the_other_object_is_left_out(frames) -> None:
    images, poses = frames
    prior = {"tilt": math.radians(3.0), "height": 0.05}
    found = sj.calibrate(images, sj.objects.target(), NOMINAL, prior=prior)
    assert found.change[0] == pytest.approx(OFF[0], abs=math.radians(0.4))
    assert found.change[1] == pytest.approx(OFF[1], abs=0.01)
    assert found.determined == {"tilt": True, "height": True}
    assert not found.used[-1] and found.used[:-1].sum() >= 4
    for k in np.flatnonzero(found.used):
        assert math.cos(float(found.poses.yaw[k]) - float(poses[k].yaw)) > math.cos(math.radians(4.0))
    assert float(found.sonar.tilt) == pytest.approx(math.radians(20.0) + found.change[0])
    assert found.sonar.geometry_std.tilt == pytest.approx(found.std["tilt"])


@pytest.mark.parametrize(("present", "fitted"), [(False, [[0, 2, 4], [0, 2]]), (True, [list(range(8))] * 2)])
def test_unlikely_frames_are_left_out_unless_the_target_is_present(monkeypatch, present, fitted) -> None:
    """Without its search and fit: which frames are fitted, at first and with the nearly right sonar."""
    module = sys.modules["sonarjax.calibrate.calibration"]
    images = [np.full(NOMINAL.shape, 0.1 * k, np.float32) for k in range(8)]
    for image in images:
        image[-1] = 1.0  # a frame of one grey would be refused
    likely = [0.9, 0.1, 0.8, 0.2, 0.3, 0.0, 0.0, 0.0]
    seen, taken = [SimpleNamespace(pose=sj.Pose(2.2), probability=p) for p in likely], []

    def fit(job, frames, *rest):
        taken.append([round(10 * float(frame.image[0, 0])) for frame in frames])
        return SimpleNamespace(point=SimpleNamespace(shared=np.zeros(1 + len(LOOK)))), None

    def result(*given):
        made = object.__new__(sj.Calibration)
        object.__setattr__(made, "used", given[-1])
        return made

    monkeypatch.setattr(module, "detect", lambda *given: seen)
    monkeypatch.setattr(module, "fit_frames", fit)
    monkeypatch.setattr(module, "_as_calibration", result)
    segmenter = sj.load_segmenter()  # its rule says what is likely
    monkeypatch.setattr(type(segmenter), "semantic", lambda self, image, *rest: image)
    how = {"free": ("tilt",), "present": present, "segmenter": segmenter}
    found = sj.calibrate(images, sj.objects.brick(), NOMINAL, **how)
    assert taken == fitted and np.flatnonzero(found.used).tolist() == fitted[1]
    seen[:] = [SimpleNamespace(pose=one.pose, probability=0.1) for one in seen]
    if present:
        assert sj.calibrate(images, sj.objects.brick(), NOMINAL, **how).used.all()
    else:
        with pytest.raises(sj.SonarjaxError, match=r"frames: the target was not found in any of the 8 frames"):
            sj.calibrate(images, sj.objects.brick(), NOMINAL, **how)


@pytest.mark.slow
@pytest.mark.computes
def test_known_poses_leave_the_target_unsearched(frames, monkeypatch: pytest.MonkeyPatch) -> None:
    images, poses = frames
    at = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x, jnp.float32) for x in v]), *poses[:-1])
    at = sj.Pose(at.x, at.y, at.yaw, z=1e-3)
    how = {"poses": at, "prior": {"tilt": 0.05, "height": 0.05}}
    stated = NOMINAL.replace(geometry_std=GeometryStd(roll=0.02, height=0.2))
    found = sj.calibrate(images[:-1], sj.objects.target(), stated, **how)
    assert found.used.all()
    np.testing.assert_array_equal(found.poses.z, at.z)
    assert (found.sonar.geometry_std.roll, found.sonar.geometry_std.height) == (0.02, found.std["height"])
    assert found.change[1] == pytest.approx(OFF[1], abs=0.01)
    monkeypatch.setattr(sys.modules["sonarjax.calibrate.calibration"], "WIDENING", 1.0)
    plain = sj.calibrate(images[:-1], sj.objects.target(), NOMINAL, **how)
    np.testing.assert_array_equal(plain.change, found.change)
    for name in FREE:  # what the priors add is not widened
        assert 1.3 < found.std[name] / plain.std[name] < WIDENING


@pytest.mark.slow
@pytest.mark.computes
def test_an_uneven_beam_table_and_an_incidence_limit_come_back() -> None:
    """All at once, from frames at known poses. Which facets have no echo is computed from the mesh alone."""
    free, off, limit = ("beam_bend", "beam_skew", "highlight_max_incidence"), (0.06, -0.04), 62.0
    true, mesh = changed_sonar(NOMINAL, free[:2], jnp.array(off)), sj.objects.target()
    poses = [sj.Pose(2.2 + 0.02 * k, 0.08 * (k - 3.5), 0.8 * k) for k in range(8)]
    model = jax.tree.map(jnp.float32, SensorModel.nominal())
    images = []
    for k, pose in enumerate(poses):
        dark = darkened(mesh, pose, true, limit)
        images.append(np.asarray(observe_scene(dark, pose, true, model, key=jax.random.key(k))[0]))
    at = jax.tree.map(lambda *v: jnp.stack([jnp.asarray(x, jnp.float32) for x in v]), *poses)
    found = sj.calibrate(images, mesh, NOMINAL, free=free, poses=at)
    assert found.determined == dict.fromkeys(free, True)
    np.testing.assert_allclose(found.change[:2], off, atol=0.02)
    wanted = np.asarray(true.azimuth)
    assert (
        np.abs(np.asarray(found.sonar.azimuth) - wanted).max() < np.abs(np.asarray(NOMINAL.azimuth) - wanted).max() / 3
    )
    assert float(found.sonar.highlight_max_incidence) == pytest.approx(limit, abs=6.0)
    assert found.sonar.geometry_std.highlight_max_incidence == found.std["highlight_max_incidence"] < 8.0


def test_an_undetermined_number_is_put_back_but_no_limit_stays_no_limit() -> None:
    free = ("tilt", "highlight_max_incidence")
    sonar = NOMINAL.replace(highlight_max_incidence=70.0)
    job = Job([], sj.objects.brick(), sonar, free, np.ones(2), PLAIN, print)
    for change, loose, expected in (
        ([0.1, 5.0], ("highlight_max_incidence",), [0.1, 0.0]),
        ([0.1, 30.0], ("highlight_max_incidence",), [0.1, 20.0]),
        ([0.1, 5.0], ("tilt",), [0.0, 5.0]),
    ):
        np.testing.assert_array_equal(_put_back(job, np.array(change), loose), expected)
    assert _starts(job, "highlight_max_incidence") == [0.0, 20.0, 5.0, -10.0, -25.0]


class Linear:
    """An engine whose frames depend linearly on tilt and aperture, given in units of their priors `std` (2,).

    Each sees the tilt, mixed with some of the aperture, and next to nothing of the aperture alone.
    """

    def __init__(self, std: np.ndarray, frames: int) -> None:
        rows = np.zeros((6, OWN + 2 + len(LOOK)))
        rows[:4, :OWN] = 30 * np.eye(4)
        rows[4, OWN : OWN + 2] = 3.0 / std[0], 1.2 / std[1]
        rows[5, OWN + 1] = 0.3 / std[1]
        self.rows, self.noise = rows, np.random.default_rng(5).normal(size=(frames, 6))

    def map(self, function, values):
        return [function(value) for value in values]

    def run(self, function, seen, mesh, sonar, shared, own, *args, **kwargs):
        off = self.rows @ np.concatenate([own - [0, 0, 0, 0.2], shared - [0, 0, *LOOK]])
        off = off - self.noise[round(1000 * float(seen.start.z))]
        return self.rows.T @ self.rows, self.rows.T @ off, off @ off / 2, np.ones(128)


def test_an_undetermined_number_has_its_priors_error_and_passes_it_on() -> None:
    free, std, frames = ("tilt", "elevation_aperture"), np.array([0.05, 0.03]), 8
    images = [np.random.default_rng(k).random(NOMINAL.shape).astype(np.float32) for k in range(frames)]
    prepared = [Prepared(image, None, image) for image in images]
    starts = [sj.Pose(2.2, 0.0, 0.0, z=k / 1000) for k in range(frames)]
    job = Job(prepared, sj.objects.brick(), NOMINAL, free, std, Linear(std, frames), lambda text: None, WIDENING)
    fit, known = fit_frames(job, prepared, starts, with_nominal_look(np.zeros(2)), (FINE,))
    assert known.determined == {"tilt": True, "elevation_aperture": False} and fit.point.shared[1] == 0
    assert known.covariance[1, 1] == pytest.approx(std[1] ** 2)
    # The frames say 3 tilt + 1.2 aperture, in units of the priors: the aperture's error is 0.4 times that of the tilt.
    assert known.covariance[0, 1] / np.prod(std) == pytest.approx(-0.4, abs=0.01)
    assert 0.4 < math.sqrt(known.covariance[0, 0]) / std[0] < 0.5


def test_residuals_are_compared_over_measured_pixels() -> None:
    """Three frames with residuals of 1, 1 and 2, one of which was measured in a quarter of its pixels only."""
    quarter = np.arange(8).reshape(2, 4) < 2
    found = relative_residual(np.array([8.0, 2.0, 32.0]), [None, quarter, np.ones((2, 4), bool)])
    np.testing.assert_allclose(found, [1.0, 1.0, 2.0])


@pytest.mark.parametrize(("count", "said"), [(1, "only 1 frame was"), (2, "only 2 frames were"), (3, None)])
def test_too_few_frames_are_noted(count: int, said: str | None) -> None:
    texts: list[str] = []
    _note_few_frames(count, texts.append)
    assert len(texts) == (said is not None) and all(text.startswith(f"note: {said}") for text in texts)


def test_no_incidence_limit_is_above_90_degrees() -> None:
    free = ("tilt", "highlight_max_incidence")
    sonar = NOMINAL.replace(highlight_max_incidence=70.0)
    np.testing.assert_array_equal(_possible(sonar, free, np.array([30.0, 30.0])), [30.0, 20.0])
    np.testing.assert_array_equal(_possible(sonar, free, np.array([-80.0, -80.0])), [-80.0, -69.0])


@pytest.mark.slow
@pytest.mark.computes
@pytest.mark.parametrize(
    ("free", "off", "free_steps"),
    [
        (FREE, OFF, (2e-3, 2e-3)),
        (
            ("azimuth_scale", "beam_bend", "beam_skew", "roll", "elevation_aperture", "range_offset", "range_scale"),
            (0.01, 0.02, -0.02, 0.02, 0.01, 0.01, 0.004),
            (5e-3, 1e-2, 1e-2, 4e-3, 2e-3, 1e-3, 5e-4),
        ),
        (("highlight_max_incidence",), (-25.0,), (0.5,)),
    ],
)
def test_derivatives_are_finite_differences(frames, free, off, free_steps) -> None:
    """The gradient of the cost by shared and own numbers, away from the solution."""
    images, poses = frames
    size = WindowSize((NOMINAL.n_ranges, 48), 32)
    seen = Observation(images[0], np.ones(NOMINAL.shape, np.float32), poses[0], np.int32(24))
    sampling, std = make_sampling(NOMINAL.shape, 4.0), np.full(NOMINAL.n_ranges // 4, 0.3, np.float32)
    shared, own = np.array([*off, *LOOK], np.float32), np.array([0.01, 0.002, 0.001, 0.2], np.float32)

    def blocks(shared: np.ndarray, own: np.ndarray):
        args = seen, sj.objects.target(), NOMINAL, shared, own, sampling, std, np.float32(2.75)
        return linearise(*args, free=free, size=size)

    hessian, gradient, cost, _ = (np.asarray(v, float) for v in blocks(shared, own))
    steps = [2e-3, 1e-3, 1e-3, 2e-2, *free_steps, *[2e-2] * len(LOOK)]
    for k, step in enumerate(steps):
        move = np.eye(len(steps), dtype=np.float32)[k] * np.float32(step)
        costs = [float(blocks(shared + s * move[OWN:], own + s * move[:OWN])[2]) for s in (1, -1)]
        # Of the gradient's largest value, by Cauchy and Schwarz. How bright a facet is carries no gradient, and the
        # mirror image's brightness changes with its path more than with a pose.
        share = 0.06 if k == len(steps) - 1 else 0.02
        little = share * math.sqrt(hessian[k, k] * 2 * cost)
        assert gradient[k] == pytest.approx((costs[0] - costs[1]) / (2 * step), rel=0.05, abs=little), k


IMAGE = np.zeros(NOMINAL.shape, np.float32)
SUNKEN = sj.objects.target()
SUNKEN = SUNKEN.with_vertices(SUNKEN.vertices - jnp.array([0.0, 0.0, 0.1]))


@pytest.mark.parametrize(
    ("frames", "options", "what"),
    [
        ([], {}, r"frames: expected at least one frame"),
        ([IMAGE, IMAGE[:-1]], {}, r"frames\[1\]: expected shape \(512, 96\)"),
        ([IMAGE + np.nan], {}, r"frames\[0\]: holds NaN"),
        ([IMAGE, IMAGE], {}, r"frames: expected different frames"),
        ([IMAGE, IMAGE + 1], {"masks": [None]}, r"masks: expected one for each of the 2 frames"),
        ([IMAGE, IMAGE + 1], {"poses": sj.Pose(x=[1.0], y=0.0, yaw=0.0)}, r"poses: expected one for each"),
        ([IMAGE], {"mesh": SUNKEN}, r"mesh: expected a mesh above the floor, .* 0.1 m below"),
        ([IMAGE], {"mesh": SUNKEN, "poses": sj.Pose(x=[2.3])}, r"mesh: expected a mesh above the floor"),
        ([IMAGE], {"free": ("tilt", "wind")}, r"free: expected names"),
        ([IMAGE], {"prior": {"roll": 0.1}}, r"prior: 'roll' is not among"),
    ],
)
def test_bad_input_is_one_clear_error(frames, options, what) -> None:
    with pytest.raises(sj.SonarjaxError, match=what):
        sj.calibrate(frames, **{"mesh": sj.objects.target(), "sonar": NOMINAL, "segmenter": "none", **options})


def test_a_pose_may_say_how_the_mesh_lies() -> None:
    check_floor(SUNKEN, sj.Pose(x=[2.3], z=[0.1]))
    check_floor(SUNKEN, sj.Pose(x=[2.3, 2.4], roll=[0.1, 0.2]))
    with pytest.raises(sj.SonarjaxError, match="mesh: expected a mesh above the floor"):
        check_floor(SUNKEN, sj.Pose(x=[2.3, 2.4], roll=[0.0, 0.2]))


def test_a_mesh_may_hang_above_the_floor() -> None:
    """As a pipe on supports that its mesh leaves out."""
    check_floor(SUNKEN.with_vertices(SUNKEN.vertices + jnp.array([0.0, 0.0, 0.124])), None)


def test_a_poorly_known_height_is_first_searched_for(monkeypatch) -> None:
    """Stand-ins for the search: two frames match best at 0.7 m, the third better the higher, but never likely."""
    tried = []

    def search(mesh, sonar, config, *, engine):
        if float(sonar.height) < 0.55:
            raise sj.SonarjaxError("sonar: no part of the floor is inside its aperture")
        tried.append(float(sonar.height))
        return SimpleNamespace(height=float(sonar.height))

    def locate(banks, seen, mask):
        shown = seen[0, 0] > 0
        return SimpleNamespace(score=0.9 - abs(banks.height - 0.7) if shown else 0.2 + 0.2 * banks.height)

    monkeypatch.setattr(detect, "TargetSearch", search)
    monkeypatch.setattr(detect, "locate", locate)
    sonar = NOMINAL.replace(height=0.9)
    images = [np.full(sonar.shape, value, np.float32) for value in (1.0, 1.0, 0.0)]
    frames = [Prepared(image, None, image) for image in images]
    job = Job(frames, sj.objects.brick(), sonar, ("tilt", "height"), np.array([0.05, 0.3]), PLAIN, lambda text: None)
    np.testing.assert_allclose(_first_guess(job, sj.SearchConfig()), [0.0, -0.2], atol=1e-6)
    assert (min(tried), max(tried)) == pytest.approx((0.6, 1.4))
    known = job._replace(std=np.array([0.05, 0.05]))
    np.testing.assert_array_equal(_first_guess(known, sj.SearchConfig()), [0.0, 0.0])
