"""`sonarjax recognize` with the real recognizer, on the frame that `sonarjax render` wrote."""

import json

import numpy as np
import pytest

FIELDS = {
    "frame", "identified", "score", "score_bank", "score_refined", "threshold", "yaw_bin_deg", "yaw_deg", "yaw_std_deg",
    "x_m", "y_m", "scores_by_yaw", "hypotheses", "segmenter", "seconds", "schema", "converged", "target", "runner_up",
    "margin", "yaw_set", "agree",
}  # fmt: skip


@pytest.fixture
def recognize(command, place, tmp_path):
    """`recognize(frame, *options)` gives exit code and records; no segmenter, the frame is semantic already."""

    def run(*arguments):
        out = tmp_path / "r.jsonl"
        target = ["--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", out, "--segmenter", "none"]
        code, _, _ = command("recognize", *arguments, *target)
        return code, [json.loads(line) for line in out.read_text().splitlines()]

    return run


def test_a_rendered_frame_is_recognized_with_every_field(recognize, rendered):
    code, (record,) = recognize(rendered)
    assert code == 0, record
    assert set(record) == FIELDS
    assert (record["frame"], record["segmenter"], record["schema"]) == (str(rendered), "none", 2)
    assert all(set(found) == {"yaw_deg", "score", "yaw_std_deg", "converged"} for found in record["hypotheses"])
    assert (record["target"], record["runner_up"], record["margin"]) == ("brick", None, None)
    assert set(record["yaw_set"]) == {"modes", "within_68", "within_95"}
    assert sum(mode["weight"] for mode in record["yaw_set"]["modes"]) == pytest.approx(1.0)
    for name, share in (("within_68", 0.68), ("within_95", 0.95)):
        held = record["yaw_set"][name]
        assert share <= sum(one["weight"] for one in held) <= share + 0.05
        assert all(0 <= one["low_deg"] < one["high_deg"] for one in held)
    assert record["identified"] == (record["score"] >= record["threshold"])
    assert 0 <= record["yaw_deg"] < 360
    # The brick looks the same after half a turn; 24 coarse beams do not tell more than this.
    error = (record["yaw_deg"] - 30 + 90) % 180 - 90
    assert abs(error) < 10
    assert record["x_m"] == pytest.approx(2.2, abs=0.05)
    assert record["y_m"] == pytest.approx(0.15, abs=0.05)


def test_without_refinement_yaw_is_the_bin(recognize, rendered, tmp_path):
    np.save(tmp_path / "wide.npy", np.full((64, 25), 0.5, np.float32))
    code, (record, wide) = recognize(rendered, tmp_path / "wide.npy", "--no-refine", "--threshold", "0.99")
    assert code == 1
    assert record["yaw_deg"] == record["yaw_bin_deg"]
    assert record["yaw_std_deg"] is None
    assert record["yaw_set"] is None
    assert record["threshold"] == 0.99
    assert wide["frame"].endswith("wide.npy")
    assert "error" in wide


def test_an_object_larger_than_the_view_is_refused_at_once(complaint, place, tmp_path):
    """9 cm drawn in millimetres: as metres it passes for an object of 90 m."""
    part, out = tmp_path / "part.stl", tmp_path / "r.jsonl"
    part.write_text(
        (place / "brick.stl").read_text().replace("0.19", "90").replace("0.045", "20").replace("0.057", "9")
    )
    files = ["--sonar", place / "sonar.toml", "--out", out]
    said = complaint(2, "recognize", place / "a.npz", "--target", part, *files)
    assert f"{part}: the mesh is " in said and "--unit-m 0.001" in said and "range ends at 4 m" in said
    files[-1] = tmp_path / "f.npz"
    said = complaint(2, "render", part, "--x", 2, "--y", 0, "--yaw-deg", 0, *files)
    assert f"{part}: the mesh is " in said and "--unit-m 0.001" in said
    assert not out.exists()


@pytest.mark.parametrize(
    "changes",
    [
        {"range_min_m = 1.5": "range_min_m = 0.2", "range_max_m = 4.0": "range_max_m = 0.5"},  # ends above the floor
        {"tilt_deg = 20.0": "tilt_deg = -30.0"},  # looks up
        {
            "tilt_deg = 20.0": "tilt_deg = 7.0",
            "height_m = 0.9": "height_m = 100.0",
            "range_max_m = 4.0": "range_max_m = 1000.0",
        },
    ],
)
def test_a_sonar_that_sees_no_floor_or_too_much_is_refused_at_once(complaint, place, rendered, tmp_path, changes):
    sonar, out = tmp_path / "blind.toml", tmp_path / "r.jsonl"
    text = (place / "sonar.toml").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    sonar.write_text(text)
    files = ["--target", place / "brick.stl", "--sonar", sonar, "--out", out]
    said = complaint(2, "recognize", rendered, *files)
    assert "floor" in said and str(sonar) in said
    assert not out.exists()
