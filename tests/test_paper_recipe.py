"""The paper's own recipe in experiments: its training goes on, its cost is told, and frames stand in Table 1's tank."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import sonarjax as sj
from experiments import reproduce_paper, train_paper
from experiments.common import frames, segmenters
from experiments.common.runs import Job
from sonarjax.data.tank_views import TRANSLATION_M
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment.training.batches import Batches
from sonarjax.sensor import SensorModel
from tests.segment.training_runs import plain_pairs, tiny_recipe


@pytest.mark.slow
def test_an_interrupted_training_goes_on_to_the_same_weights(tmp_path, monkeypatch):
    pairs = plain_pairs(tmp_path / "pairs")
    monkeypatch.setattr(train_paper, "find_recipe", lambda name: tiny_recipe(pairs, name=name))
    whole = train_paper.run(train_paper.Settings(into=str(tmp_path / "whole.safetensors")), Job(tmp_path / "a", 3))
    assert [epoch["epoch"] for epoch in whole["epochs"]] == [1, 2, 3] and whole["images"] == 3 * 32
    best, last, known = whole["rows"]
    assert 0 < known["psnr_db"] != last["psnr_db"] and set(known) <= {"when", *last}
    assert best["iou_mean"] == max(epoch["iou_mean"] for epoch in whole["epochs"]) and last["epoch"] == 3

    batch, asked = Batches.batch, []

    def cut(self, step):
        asked.append(step)
        if step == 6 and 6 not in asked[:-1]:
            raise KeyboardInterrupt
        return batch(self, step)

    monkeypatch.setattr(Batches, "batch", cut)
    settings = train_paper.Settings(into=str(tmp_path / "cut.safetensors"))
    with pytest.raises(KeyboardInterrupt):
        train_paper.run(settings, Job(tmp_path / "b", 3))
    before = len(asked)
    again = train_paper.run(settings, Job(tmp_path / "b", 3))
    assert asked[before] >= 4  # epoch 1, and the checkpoint after it, were done
    assert again["epochs"] == whole["epochs"]
    arrays, about = read_safetensors(tmp_path / "cut.safetensors")
    wanted, _ = read_safetensors(tmp_path / "whole.safetensors")
    assert all(np.array_equal(arrays[name], wanted[name]) for name in wanted) and set(arrays) == set(wanted)
    assert about["cost"]["width"] == 2 and about["cost"]["hours"] > 0


def test_the_full_width_is_projected_by_the_square(tmp_path, monkeypatch):
    path = tmp_path / "paper-cpu.safetensors"
    monkeypatch.setitem(segmenters.BASELINES, "paper-cpu", path)
    monkeypatch.setitem(segmenters.BASELINES, "paper", tmp_path / "none.safetensors")
    assert reproduce_paper.in_training() == []
    cost = {"hours": 0.5, "images_per_s": 70.0, "width": 16, "device": "2 cores"}
    write_safetensors(path, {"one": np.zeros(1, np.float32)}, {"cost": cost})
    measured, projected = reproduce_paper.in_training()
    assert measured["ours"] == 0.5 and projected["ours"] == 8.0 and projected["paper"] == 1.2
    assert "projected" in projected["note"] and "measured" in measured["note"]
    wide = tmp_path / "paper.safetensors"
    monkeypatch.setitem(segmenters.BASELINES, "paper", wide)
    write_safetensors(wide, {}, {"cost": {"hours": 0.1, "images_per_s": 560.0, "width": 64, "device": "a GPU"}})
    _, of_its_own = reproduce_paper.in_training()
    assert of_its_own["ours"] == 0.1 and "measured on a GPU" in of_its_own["note"]


def test_the_shipped_files_say_what_their_training_cost():
    for path in (segmenters.BASELINES["paper-cpu"],):
        about = read_safetensors(path)[1]
        assert about["cost"]["width"] == about["recipe"]["networks"]["width"] == 16
        assert about["step"] * about["recipe"]["batch"] == about["recipe"]["passes"] * about["recipe"]["pairs"]


@pytest.mark.slow
def test_frames_in_the_tank_stand_where_table_1_says(monkeypatch):
    seen = []

    def scene(meshes, poses, sonar, model, *, key):
        seen.append((poses, sonar))
        return np.zeros((sonar.n_ranges, sonar.n_beams), np.float32), None

    monkeypatch.setattr(frames, "observe_scene", scene)
    made = frames.paper_frames(0, step_deg=90, tilts_deg=(20.0,), tank=True)
    assert len(made) == len(seen) == 16
    ahead, aside = (np.array([float(getattr(pose, name)) for (pose, _), _ in seen]) for name in ("x", "y"))
    ahead -= frames.GROUND_RANGE_M[20.0]
    for moved in (ahead, aside):
        steps = np.round(moved / TRANSLATION_M)
        np.testing.assert_allclose(moved, steps * TRANSLATION_M, atol=1e-5)
        assert set(steps) == {-1.0, 0.0, 1.0}
    for (pose, walls), sonar in seen:
        far = float(walls.x) + frames.TANK_M[0] / 2
        assert float(pose.x) < far <= frames.TANK_M[0] + 1e-5 and float(sonar.floor.x) == pytest.approx(float(walls.x))


def tank_frame(n_ranges=512):
    """Image and map of the target in the tank, and the sonar."""
    sonar = frames.sonar_for(20.0).replace(n_ranges=n_ranges)
    pose, model = sj.Pose(frames.GROUND_RANGE_M[20.0], 0.0, 0.3), SensorModel.nominal(0.0)
    keys = {"place_key": jax.random.key(2), "key": jax.random.key(1)}
    return *frames.observed_in_tank(sj.objects.target(), pose, sonar, model, **keys), sonar


def test_the_walls_of_the_tank_are_seen_but_not_in_the_map(monkeypatch):
    seen = []
    monkeypatch.setattr(frames, "observe_scene", lambda meshes, *rest, key: (seen.extend(meshes), None))
    _, clean, sonar = tank_frame(128)
    assert [mesh.n_faces for mesh in seen] == [sj.objects.target().n_faces, sj.objects.tank().n_faces]
    assert clean.shape == sonar.shape
    assert 0 < float((clean > 0.75).mean()) < 0.1  # the object alone


@pytest.mark.slow
def test_a_frame_in_the_tank_is_as_large_as_its_map():
    image, clean, sonar = tank_frame()
    assert image.shape == clean.shape == (sonar.n_ranges, sonar.n_beams)
    assert 0 < float((clean > 0.75).mean()) < 0.1
