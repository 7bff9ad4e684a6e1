"""The segmenters that experiments compare, by name: those of the package, and the paper's 'discriminative model'.

The discriminative model is the same U-Net trained on the same pairs by cross-entropy alone (`train_discriminative`).
Its weights lie beside this file: a baseline is needed where results are checked, not where the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from sonarjax.recognize import THRESHOLDS
from sonarjax.segment import SEGMENTERS, semantic_map
from sonarjax.segment.weights import load_generator
from sonarjax.segment.whole import segment_frame

DISCRIMINATIVE = "discriminative"
DISCRIMINATIVE_WEIGHTS = Path(__file__).with_name("discriminative.safetensors")
DISCRIMINATIVE_THRESHOLD = 0.5
"""Least score of an identified target, from validation frames of experiments/fit_threshold.py."""
NAMES = ("pix2pix", DISCRIMINATIVE, *(name for name in SEGMENTERS if name != "pix2pix"))
"""All segmenters that are compared."""


def map_maker(name: str) -> Callable[[np.ndarray, np.ndarray | None], np.ndarray]:
    """The function from a grey frame and mask (both (range, beam)) to the map that is matched, as `semantic_map` does.

    Raises SonarjaxError for a name or file that is not there.
    """
    if name != DISCRIMINATIVE:
        return lambda image, mask=None: semantic_map(image, name, mask)
    weights = _discriminative()
    return lambda image, mask=None: segment_frame(weights, image, mask)


def threshold_of(name: str) -> float:
    """Least score of an identified target, fixed on validation frames."""
    return DISCRIMINATIVE_THRESHOLD if name == DISCRIMINATIVE else THRESHOLDS[name]


@cache
def _discriminative():
    return load_generator(DISCRIMINATIVE_WEIGHTS)
