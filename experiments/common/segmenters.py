"""The segmenters that experiments compare, by name: those of the package, and two networks of the paper.

The 'discriminative model' is the U-Net trained by cross-entropy alone (docs/training.md says on what); `paper-cpu` is
the paper's own recipe, and `paper` the same at the paper's width. `train_paper` makes them. Their weights lie in the
folder above: a baseline is for checking results, not for users. Those of `paper` are too large for the repository.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np

import sonarjax as sj
from experiments.common.engine import engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.tiled import segment

TILES, TRUTH = "pix2pix-tiles", "truth"
Name = Literal[
    "truth",
    "pix2pix",
    "pix2pix-tiles",
    "paper-cpu",
    "paper",
    "discriminative",
    "none",
    "otsu",
    "otsu1",
    "otsu3",
    "median-otsu",
]
BASELINES = {
    name: Path(__file__).resolve().parents[1] / f"{name}.safetensors"
    for name in ("paper-cpu", "paper", "discriminative")
}
"""Weights of the networks that are not the package's, by name."""
OWN_THRESHOLDS = {TRUTH: 0.947, TILES: 0.825, "discriminative": 0.851}
"""Least score of an identified target, from validation frames of experiments/fit_threshold.py."""
NAMES: tuple[Name, ...] = get_args(Name)
"""All that are compared: `truth` is the true map, `pix2pix-tiles` the network without its closer looks."""


def available() -> tuple[Name, ...]:
    """The names whose weights are there."""
    return tuple(name for name in NAMES if name not in BASELINES or BASELINES[name].exists())


class HasMap(Protocol):
    """A simulated frame."""

    @property
    def image(self) -> np.ndarray:
        """Grey frame (range, beam) in [0, 1]."""

    @property
    def clean(self) -> np.ndarray:
        """Semantic image (range, beam) without noise."""


def map_of(name: str, frame: HasMap) -> np.ndarray:
    """The semantic map (range, beam) that a segmenter makes of a frame.

    Raises SonarjaxError for a name or file that is not there.
    """
    if name == TRUTH:
        return frame.clean
    if name == TILES:
        weights = loaded("pix2pix").weights
        assert weights is not None
        return np.asarray(engine().run(segment, frame.image, weights, closer=0))
    return np.asarray(loaded(name).semantic(frame.image, engine=engine()), np.float32)


def threshold_of(name: str) -> float:
    """Least score of an identified target, fixed on validation frames. Raises SonarjaxError where there is none."""
    known = OWN_THRESHOLDS[name] if name in OWN_THRESHOLDS else loaded(name).threshold
    if known is None:
        raise SonarjaxError(f"{name}: no threshold yet; experiments/fit_threshold.py --segmenters {name} finds one")
    return known


@cache
def loaded(name: str) -> sj.Segmenter:
    """A segmenter of the package or a baseline, read once. Raises SonarjaxError for one that is not there."""
    return sj.load_segmenter(BASELINES.get(name, name))
