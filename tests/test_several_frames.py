"""`Recognizer.stream`: several frames at once give what they give one by one, and share what is rendered for them."""

from __future__ import annotations

import math
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import sonarjax as sj
from sonarjax import cpu
from sonarjax.io import SonarjaxError
from sonarjax.match import TargetSearch

AZIMUTH = np.radians((np.arange(24) - 11.5) * 29 / 24).astype(np.float32)
SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20), azimuth=AZIMUTH, n_ranges=96, range_min=2.0, range_max=3.0)
PLACES = (2.2, 0.05, 0.8), (2.5, 0.0, 2.0), (2.3, -0.05, 4.0), (2.6, 0.1, 5.5), (2.4, 0.0, 3.0)


@pytest.fixture(scope="module")
def mesh():
    return sj.objects.target()


@pytest.fixture(scope="module")
def frames(mesh):
    """Noisy frames (range, beam) of the target at several places."""
    rng = np.random.default_rng(0)
    clean = [np.asarray(sj.render(mesh, sj.Pose(*place), SONAR).semantic()) for place in PLACES]
    return [np.clip(one + rng.normal(0.0, 0.1, one.shape), 0.0, 1.0).astype(np.float32) for one in clean]


def test_frames_at_once_give_what_they_give_one_by_one(mesh, frames, monkeypatch, tmp_path):
    monkeypatch.setattr(cpu, "cores", lambda: 4)
    how = {"segmenter": "none", "refine": None}
    plain = sj.Recognizer(mesh, SONAR, **how)
    expected = [plain(frame, threshold=0.5) for frame in frames]
    several = sj.Recognizer(mesh, SONAR, engine=cpu.CpuEngine(tmp_path), **how)
    found = list(several.stream(iter(frames), threshold=0.5))
    assert [one.yaw for one in found] == [one.yaw for one in expected]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.scores_by_yaw, other.scores_by_yaw, atol=1e-5)
        assert one.threshold == 0.5


def test_a_bank_is_rendered_once_for_all_threads(mesh, frames, monkeypatch):
    rendered, render = Counter(), TargetSearch._render

    def counted(search, *which):
        rendered[which] += 1
        time.sleep(0.05)  # long enough for another thread to need the same bank meanwhile
        return render(search, *which)

    monkeypatch.setattr(TargetSearch, "_render", counted)
    search = TargetSearch(mesh, SONAR)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(search.find, [frames[0]] * 4))
    assert set(rendered.values()) == {1}
    assert len({float(match.scores.max()) for match in found}) == 1


def test_an_unfit_frame_ends_the_stream_when_its_turn_comes(mesh, frames, tmp_path):
    recognizer = sj.Recognizer(mesh, SONAR, segmenter="none", refine=None, engine=cpu.CpuEngine(tmp_path))
    stream = recognizer.stream([frames[0], frames[1], frames[2][:-1], frames[3]])
    assert all(next(stream).score_bank > 0 for _ in range(2))
    with pytest.raises(SonarjaxError, match="image: expected shape"):
        next(stream)
