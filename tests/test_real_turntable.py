"""What the experiment on real frames computes itself: errors modulo half a turn, and how much they differ by chance."""

from __future__ import annotations

import json

import numpy as np
import pytest

from experiments.common.launch import combined, mean_and_spread
from experiments.real_turntable import Settings, by_recognize, compared, errors_deg, load, summary

ONE = Settings(searches=("recognize",))


def per_frame(**errors):
    return {f"{segmenter}, recognize, refined": {"error_deg": error} for segmenter, error in errors.items()}


def test_errors_are_taken_modulo_half_a_turn_after_the_circular_median():
    truth = np.radians([10.0, 50.0, 179.0, 90.0, 120.0])
    errors = np.array([0.5, 0.0, 2.0, -1.0, -0.2])
    half_turns = np.pi * np.array([0, 1, 0, 1, 0])
    found, offset = errors_deg(truth + np.radians(errors - 30.0) + half_turns, truth)
    np.testing.assert_allclose(found, errors, atol=1e-9)
    assert offset == pytest.approx(-30.0)


def test_a_difference_in_all_frames_is_certain_and_chance_is_not(rng):
    pix2pix = rng.normal(size=110)
    worse, as_good = pix2pix + np.sign(pix2pix), rng.normal(size=110)
    rows = {row["other"]: row for row in compared(per_frame(pix2pix=pix2pix, none=worse, otsu=as_good), ONE, seed=0)}
    for name in ("p50", "p90"):
        np.testing.assert_allclose(rows["none"][name], -1.0, atol=1e-9)
        gap, low, high = rows["otsu"][name]
        assert low < min(gap, 0) and max(gap, 0) < high


def test_the_summary_sets_each_row_beside_pix2pix_for_one_seed_and_for_several(rng):
    errors = {name: rng.normal(size=110) for name in ("pix2pix", "none", "otsu")}
    rows = [
        {"segmenter": name, "search": "recognize", "yaw": yaw, "median_deg": 1.25, "p90_deg": 3.5}
        for name in errors
        for yaw in ("bin", "refined")
    ]
    found = [{"rows": rows, "compared": compared(per_frame(**errors), ONE, seed)} for seed in (0, 1)]
    reports = json.loads(json.dumps(found))  # as they are kept
    lines = summary(reports[0]).splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == ["| pix2pix", "| none", "| otsu"]
    assert all("1.250 | 3.500" in line for line in lines)
    assert lines[0].endswith("| – | – |") and " to +" in lines[1]
    assert " ± " in summary(combined(reports, mean_and_spread))


@pytest.mark.slow
def test_the_real_pipe_is_found_on_its_platform(real_data):
    settings = Settings(frames=8, data=str(real_data / "pipe"), refine=False)
    data = load(settings)
    found = by_recognize(data, settings, "none")
    away = [np.hypot(pose.x - settings.platform_x, pose.y - settings.platform_y) for pose in found.poses]
    assert np.median(away) < 0.1
    assert np.median(np.abs(errors_deg(np.array(found.yaws["bin"]), data.truth)[0])) < 6
