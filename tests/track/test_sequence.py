"""`track` and `Tracker`: smoothing against the joint Gaussian, frames that are lost, input that cannot be used."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.results import record_of
from sonarjax.sensor import SensorModel, observe_scene
from sonarjax.track import TrackConfig
from sonarjax.track.sequence import joined
from tests.track.measurements import STD, Reader, found, frame

PLAIN = TrackConfig(yaw_scale=1.0, tail=1e-6, misses=1e-6, floor=1e-4, place_floor=1e-5)


def off_deg(yaw, true):
    return np.abs((np.degrees(np.asarray(yaw) - true) + 180) % 360 - 180)


def joint(yaws, motion: sj.Turning) -> tuple[np.ndarray, np.ndarray]:
    """Means and standard deviations of all yaws of a turn, given all measurements: by one large linear system."""
    count = len(yaws)
    rows, values = [], []

    def add(entries: dict[int, float], value: float, std: float) -> None:
        row = np.zeros(2 * count)
        for at, entry in entries.items():
            row[at] = entry / std
        rows.append(row)
        values.append(value / std)

    add({1: 1.0}, 0.0, motion.rate_std)
    for k, yaw in enumerate(yaws):
        if not math.isnan(yaw):
            add({2 * k: 1.0}, yaw, STD)
        if k + 1 < count:
            add({2 * k + 2: 1.0, 2 * k: -1.0, 2 * k + 1: -1.0}, 0.0, motion.yaw_drift)
            add({2 * k + 3: 1.0, 2 * k + 1: -1.0}, 0.0, motion.rate_drift)
    system = np.array(rows)
    covariance = np.linalg.inv(system.T @ system)
    return (covariance @ system.T @ values)[::2], np.sqrt(np.diag(covariance)[::2])


def test_smoothing_is_the_joint_gaussian(rng):
    motion = sj.Turning(rate_std=math.radians(6.0), rate_drift=math.radians(0.6), yaw_drift=math.radians(0.8))
    yaws = 6.0 + math.radians(4.0) * np.arange(9) + STD * rng.standard_normal(9)
    yaws[[4, 5]] = math.nan  # no frame there
    tracker = sj.Tracker(Reader(), motion, config=PLAIN)
    taken = [tracker.take(None if math.isnan(yaw) else found([yaw])) for yaw in yaws]
    smooth = joined(taken, tracker, smooth=True)
    mean, std = joint(yaws, motion)
    assert off_deg(smooth.yaw, mean).max() < 0.02
    assert smooth.yaw_std == pytest.approx(std, rel=0.02)
    filtered = joined(taken, tracker)
    assert smooth.yaw[-1] == pytest.approx(filtered.yaw[-1])
    assert (smooth.yaw_std[:-1] < filtered.yaw_std[:-1] * 1.001).all()
    assert smooth.smoothed and not filtered.smoothed


def test_of_a_standing_object_all_frames_are_smoothed_to_the_last():
    tracker = sj.Tracker(Reader(), sj.Standing())
    taken = [tracker.take(found([1.0 + 0.01 * (-1) ** k])) for k in range(6)]
    smooth = joined(taken, tracker, smooth=True)
    assert off_deg(smooth.yaw, smooth.yaw[-1]).max() < 1e-2
    assert smooth.yaw_std == pytest.approx(np.full(6, smooth.yaw_std[-1]), rel=1e-2)


def test_later_frames_decide_between_the_yaws_of_earlier_ones():
    tracker = sj.Tracker(Reader(), sj.Standing())
    taken = [tracker.take(found([1.0, 1.0 + math.pi], [0.801, 0.8])) for _ in range(4)]
    taken += [tracker.take(found([1.0, 1.0 + math.pi], [0.6, 0.8])) for _ in range(3)]
    filtered, smooth = joined(taken, tracker), joined(taken, tracker, smooth=True)
    assert off_deg(filtered.yaw[0], 1.0) < 1
    assert off_deg(smooth.yaw, 1.0 + math.pi).max() < 1
    assert smooth.probability.min() > 0.99


def test_a_wrong_start_is_smoothed_away():
    tracker = sj.Tracker(Reader(), sj.Turning())
    yaws = [4.0, *(1.0 + math.radians(3.0) * np.arange(1, 15))]
    taken = [tracker.take(found([yaw])) for yaw in yaws]
    smooth = joined(taken, tracker, smooth=True)
    assert off_deg(smooth.yaw[0], 1.0) < 5
    assert off_deg(smooth.yaw[1:], yaws[1:]).max() < 2


# ---------------------------------------------------------------- `track`


def test_frames_that_fail_cost_only_themselves():
    frames = [frame(1.0), np.full((3, 4), np.nan), frame(2.5, 0.01), frame(1.0), frame(1.0)]
    found_in = sj.track(frames, Reader())
    assert off_deg(found_in.yaw, 1.0).max() < 0.1
    assert [one.error is None for one in found_in.frames] == [True, False, True, True, True]
    assert "NaN" in str(found_in.frames[1].error)
    assert found_in.frames[1].recognition is None
    assert found_in.yaw_std[4] < found_in.yaw_std[0]
    assert found_in.pose.shape == (5,)


def test_before_the_target_is_seen_nothing_is_known():
    found_in = sj.track([np.full((3, 4), np.nan), frame(1.0)], Reader())
    assert math.isnan(found_in.yaw[0]) and math.isinf(found_in.yaw_std[0])
    assert found_in.probability[0] == 0 and found_in.frames[0].modes == ()
    assert off_deg(found_in.yaw[1], 1.0) < 1e-3


def test_masks_reach_the_recognizer_and_times_stretch_the_rate():
    reader, masks = Reader(), [np.ones((3, 4), bool), None, None, None]
    times = np.array([0.0, 2.0, 4.0, 6.0])
    found_in = sj.track([frame(1.0 + 0.1 * k) for k in range(4)], reader, sj.Turning(), masks=masks, times=times)
    assert reader.masks[0] is masks[0] and reader.masks[1] is None
    assert found_in.rate[-1] == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("gap", [5.0, 5e3, 1e5])
def test_after_a_gap_yaw_and_rate_are_found_anew(gap):
    """However long the gap: a yaw that may have turned around many times is unknown, not widely spread."""
    rate, times = math.radians(5.0), np.r_[0:8, 7 + gap : 15 + gap]
    yaws = 1.0 + rate * times
    if gap > 100:  # meanwhile it has come to turn the other way
        rate *= -1
        yaws = np.where(times > 7, 2.0 + rate * (times - 7 - gap), yaws)
    for smooth in (False, True):
        found_in = sj.track([frame(y % (2 * np.pi)) for y in yaws], Reader(), sj.Turning(), times=times, smooth=smooth)
        assert off_deg(found_in.yaw[9:], yaws[9:]).max() < 1.0
        assert off_deg(found_in.yaw[8], yaws[8]) < max(1.0, 2 * np.degrees(found_in.yaw_std[8]))
        assert found_in.rate[10:] == pytest.approx(rate, abs=math.radians(0.5))
        assert found_in.yaw_std.max() < math.pi


def test_two_frames_may_be_far_apart():
    assert off_deg(sj.track([frame(1.0), frame(2.0)], Reader(), sj.Turning(), times=[0, 1e4]).yaw[1], 2.0) < 1.0


def test_a_stream_is_the_log():
    frames = [frame(1.0 + 0.05 * k) for k in range(5)]
    tracker = sj.Tracker(Reader(), sj.Turning())
    stream = [tracker(image).best.yaw for image in frames]
    assert sj.track(frames, Reader(), sj.Turning()).yaw == pytest.approx(np.array(stream))


GOOD = [frame(1.0), frame(1.0)]
POSES = sj.Pose(np.zeros(2), np.zeros(2), np.zeros(2))
BAD = {
    "no frames": (([],), {}, "frames: expected at least one"),
    "mixed shapes": (([frame(1.0), np.zeros((2, 2))],), {}, r"frames\[1\]: expected shape"),
    "never in view": (([frame(1.0, 0.1)] * 3,), {}, "frames: the target was not identified in any of 3"),
    "not finite": (([np.full((3, 4), np.inf)] * 2,), {}, "frames: none of 2 could be recognized; first error: ima"),
    "masks": ((GOOD,), {"masks": [None]}, "masks: expected one for each of 2 frames, got 1"),
    "too many poses": ((GOOD,), {"sonar_poses": sj.Pose(np.zeros(3))}, "sonar_poses: expected one for each of 2"),
    "list of poses": ((GOOD,), {"sonar_poses": [sj.Pose()]}, "sonar_poses: expected one for each of 2 frames, got 1"),
    "no finite pose": (
        (GOOD,), {"sonar_poses": replace(POSES, x=POSES.x + np.nan)}, "sonar_pose: expected finite x, y and yaw",
    ),
    "map coordinates": (
        (GOOD,), {"sonar_poses": replace(POSES, y=POSES.y + 5411932.7)}, "sonar_pose: expected x and y from -10000 to",
    ),
    "a leaning sonar": (
        (GOOD,), {"sonar_poses": replace(POSES, roll=POSES.x + 0.1)}, "sonar_pose: expected z, roll and pitch of 0",
    ),
    "times back": ((GOOD,), {"times": [1.0, 0.0]}, "times: expected 2 finite numbers that do not decrease"),
    "times in another unit": (
        ([frame(1.0)] * 3, ), {"motion": sj.Turning(), "times": [0.0, 1e5, 2e5]}, "times: frames are 100000.0 or more",
    ),
    "times not finite": ((GOOD,), {"times": [0.0, np.nan]}, "times: expected 2 finite numbers"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_used_is_one_clear_line(case):
    arguments, options, said = BAD[case]
    with pytest.raises(sj.SonarjaxError, match=said) as raised:
        sj.track(*arguments, Reader(), **options)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: sj.Tracker(Reader(["a", "b"])), "recognizer: expected one with a single target, got 2"),
        (lambda: sj.Turning(rate_std=-1.0), "rate_std: expected a number of 0 or more, got -1"),
        (lambda: sj.Standing(yaw_drift=math.nan), "yaw_drift: expected a number"),
        (lambda: sj.TrackConfig(misses=1.0), "between 0 and 1"),
        (lambda: sj.Tracker(Reader(), threshold=math.nan), "threshold: expected a number or None, got nan"),
        (lambda: sj.TrackConfig(softness=0.0), "expected positive numbers"),
        (lambda: sj.TrackConfig(components=1), "components: expected a whole number of 2 or more"),
        (lambda: sj.Tracker(Reader()).take(None, elapsed=-1.0), "elapsed: expected a time of 0 or more"),
        (lambda: sj.Tracker(Reader()).recognize(GOOD[0], elapsed=-1.0), "elapsed: expected a time of 0 or more"),
        (lambda: sj.Tracker(Reader()).expected(elapsed=math.nan), "elapsed: expected a time of 0 or more"),
    ],
)
def test_settings_that_cannot_be_used(make, said):
    with pytest.raises(sj.SonarjaxError, match=said):
        make()


def test_a_line_of_results_is_the_beliefs():
    tracker = sj.Tracker(Reader(), sj.Standing())
    tracker.take(found([1.0, 4.0], [0.8, 0.795]))
    one = found([1.02, 4.0], [0.8, 0.795])
    line = record_of(one, "a", 0.1, tracker.take(one))
    assert line["yaw_deg"] == pytest.approx(math.degrees(1.01), abs=0.02)
    assert line["frame_yaw_deg"] == pytest.approx(math.degrees(1.02))
    assert [set(h) for h in line["hypotheses"]] == [{"yaw_deg", "score", "yaw_std_deg", "converged"}] * 2
    assert sum(h["score"] for h in line["hypotheses"]) == pytest.approx(1.0, abs=0.01)
    assert (line["x_m"], line["y_m"]) == pytest.approx((2.0, 0.1), abs=1e-3)
    assert [mode["yaw_deg"] for mode in line["yaw_set"]["modes"]] == [h["yaw_deg"] for h in line["hypotheses"]]
    assert sum(mode["weight"] for mode in line["yaw_set"]["modes"]) == pytest.approx(1.0)
    assert len(line["yaw_set"]["within_95"]) == 2  # both yaws, apart
    assert set(record_of(one, "a", 0.1)) < set(line)


# ---------------------------------------------------------------- frames that are simulated


@pytest.mark.slow
def test_a_turning_object_is_followed_from_frames(monkeypatch):
    """Also through frames that show nothing; the rate is found, and expected poses are among the starts."""
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
    mesh, model = sj.objects.target(), SensorModel.nominal()
    yaws = 0.4 + math.radians(4.0) * np.arange(7)
    key = jax.random.key(3)
    images = [
        np.asarray(observe_scene(mesh, sj.Pose(2.3, 0.05, yaw), sonar, model, key=jax.random.fold_in(key, k))[0])
        for k, yaw in enumerate(yaws)
    ]
    images[4] = np.full(sonar.shape, 0.3, np.float32)
    recognizer = sj.Recognizer(mesh, sonar, segmenter="none")
    calls = []
    original = sj.Recognizer.__call__
    monkeypatch.setattr(
        sj.Recognizer, "__call__", lambda self, *a, **k: (calls.append(k.get("starts", ())), original(self, *a, **k))[1]
    )
    found_in = sj.track(images, recognizer, sj.Turning(), smooth=True)
    assert off_deg(found_in.yaw, yaws).max() < 3
    assert found_in.rate[-1] == pytest.approx(math.radians(4.0), abs=math.radians(1.0))
    assert np.hypot(found_in.x - 2.3, found_in.y - 0.05).max() < 0.02
    assert len(calls[0]) == 0 and len(calls[3]) >= 1
    assert off_deg(float(calls[3][0].yaw), yaws[3]) < 5
    # Poses to start from: at the truth one of the hypotheses is right; far out of view nothing is changed.
    alone = recognizer(images[0], threshold=0.0)
    started = recognizer(images[0], threshold=0.0, starts=[sj.Pose(2.31, 0.05, yaws[0] + 0.03)])
    assert min(off_deg(h.yaw, yaws[0]) for h in started.hypotheses) < 1
    far = recognizer(images[0], threshold=0.0, starts=[sj.Pose(30.0, 5.0, 0.0)])
    assert far.yaw == pytest.approx(alone.yaw, abs=1e-3)
    assert len(far.hypotheses) == len(alone.hypotheses)


def test_the_threshold_reaches_the_recognizer() -> None:
    class Noting(Reader):
        def __call__(self, image, mask=None, *, semantic=None, threshold=None, starts=()):
            self.given = threshold
            return super().__call__(image, mask)

    reader = Noting()
    sj.Tracker(reader, threshold=0.3)(frame(1.0))
    assert reader.given == 0.3
    sj.track([frame(1.0)], reader, threshold=0.2)
    assert reader.given == 0.2


def test_a_frame_is_refined_from_what_is_likely_and_well_known() -> None:
    def after(*scores: float, motion: sj.Turning | sj.Standing = sj.Standing()) -> sj.Tracker:  # noqa: B008
        tracker = sj.Tracker(Reader(), motion)
        tracker.take(found([1.0, 4.0][: len(scores)], scores))
        return tracker

    def yaws(tracker: sj.Tracker, elapsed: float = 1.0) -> list[float]:
        return sorted(float(pose.yaw) for pose in tracker._starts(np.zeros(3), elapsed))

    assert yaws(after(0.8, 0.8)) == pytest.approx([1.0, 4.0], abs=1e-3)
    assert yaws(after(0.8, 0.7)) == pytest.approx([1.0], abs=1e-3)
    turning = after(0.8, motion=sj.Turning())
    assert len(yaws(turning)) == 1 and yaws(turning, 20.0) == []
