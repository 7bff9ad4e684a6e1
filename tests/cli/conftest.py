"""A target, a small sonar and frames as files, and one frame that the command itself rendered (one compilation)."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sonarjax.cli import main
from sonarjax.io import SonarjaxError
from sonarjax.match import SearchConfig
from sonarjax.recognition import Hypothesis, Recognition

SONAR = """
n_beams = 24
field_of_view_deg = 29.0
range_min_m = 1.5
range_max_m = 4.0
n_ranges = 64
elevation_aperture_deg = 14.0
tilt_deg = 20.0
height_m = 0.9
"""
SHAPE = (64, 24)


@pytest.fixture(scope="session")
def place(tmp_path_factory) -> Path:
    """A folder with `sonar.toml`, `brick.stl` (12 triangles, [m]), `brick_mm.stl` and frames `a.npz`, `b.npy`."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "sonar.toml").write_text(SONAR)
    (folder / "brick.stl").write_text(brick_stl((0.19, 0.09, 0.057)))
    (folder / "brick_mm.stl").write_text(brick_stl((190.0, 90.0, 57.0)))
    image = np.random.default_rng(0).uniform(0.2, 0.8, SHAPE).astype(np.float32)
    np.savez(folder / "a.npz", image=image, mask=np.ones(SHAPE, bool))
    np.save(folder / "b.npy", image)
    return folder


def brick_stl(size: tuple[float, float, float]) -> str:
    """A box standing on z = 0 as ASCII STL."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    lines = ["solid brick"]
    for a, b, c, d in quads:
        for triangle in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {x} {y} {z}" for x, y, z in corners[list(triangle)]]
            lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid brick", ""])


@pytest.fixture(scope="session")
def rendered(place) -> Path:
    """`rendered.npz` and `rendered.png`: the brick at x 2.2 m, 0.15 m to port, as `sonarjax render` writes it."""
    arguments = f"--sonar {place}/sonar.toml --x 2.2 --y 0.15 --yaw-deg 30".split()
    files = ["--out", str(place / "rendered.npz"), "--png", str(place / "rendered.png")]
    assert main(["render", str(place / "brick.stl"), *arguments, *files]) == 0
    return place / "rendered.npz"


@pytest.fixture
def stand_in(monkeypatch) -> SimpleNamespace:
    """Stand-ins for the slow modules behind `segment` and `recognize`: they note calls.

    `failures` (number of a call -> exception) fails in that call. Frames are recognized at the same time, in any order:
    `unmasked` is the exception for those without a mask.
    `yaw_std` [rad] is what is found; `threshold` and `rule` are the segmenter's.
    """
    state = SimpleNamespace(calls=[], failures={}, unmasked=None, yaw_std=float("nan"), threshold=0.0, rule=None)

    def note(call):
        state.calls.append(call)
        if len(state.calls) in state.failures:
            raise state.failures[len(state.calls)]

    class Recognizer(sys.modules["sonarjax.recognize"].Recognizer):  # trackers take no other
        def __init__(self, targets, sonar, *, segmenter, refine, engine):
            self.targets, self.search, self.refine = targets, SearchConfig(), None
            self.sonar, self.options = sonar, {"segmenter": segmenter.name, "refine": refine is not None}

        def __call__(self, image, mask=None, *, semantic=None, threshold=None, starts=()):
            note(self.options | {"mask": mask, "threshold": threshold})
            if mask is None and state.unmasked is not None:
                raise state.unmasked
            if image.shape != self.sonar.shape:
                raise SonarjaxError(f"image: expected the sonar's shape {self.sonar.shape}, got {image.shape}")
            return found(float(image.mean()), state.yaw_std)

    class Network:
        def __init__(self, name):
            self.name, self.threshold, self.rule = name, state.threshold, state.rule

        def labels(self, image, mask=None, engine=None):
            note(self.name)
            return (image > 0.5).astype(np.uint8)

    # By name in sys.modules: `sonarjax.recognize` and `sonarjax.segment` are the functions.
    monkeypatch.setattr(sys.modules["sonarjax.recognize"], "Recognizer", Recognizer)
    monkeypatch.setattr(sys.modules["sonarjax.segment"], "load_segmenter", Network)
    return state


def found(score: float, yaw_std: float) -> Recognition:
    """A result of that score; by default its error bar is not a number."""
    hypothesis = Hypothesis(0.5, score, yaw_std)
    return Recognition(
        identified=True, target="target", score=score, score_bank=score, score_refined=score, threshold=0.0,
        runner_up=None, margin=None, yaw_bin=0.5, yaw=0.5, yaw_std=yaw_std, x=2.2, y=0.0, converged=True,
        scores_by_yaw=np.array([score]), hypotheses=(hypothesis,), segmenter="pix2pix", semantic=np.zeros(SHAPE),
    )  # fmt: skip


@pytest.fixture
def command(capsys):
    """`command("info", path)` runs it in this process and gives exit code, stdout and stderr."""

    def run(*arguments) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def complaint(command):
    """`complaint(code, *arguments)` checks the exit code and that stderr is one clear line, which it gives back."""

    def run(expected: int, *arguments) -> str:
        code, out, err = command(*arguments)
        assert (code, out) == (expected, ""), err
        assert err.startswith("sonarjax: error: ")
        assert err.count("\n") == 1
        return err

    return run
