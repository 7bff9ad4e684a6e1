"""The true class of every pixel: DESIGN's definition, counted on rays."""

from __future__ import annotations

import numpy as np

from experiments.judge.device import Device
from experiments.judge.echoes import bare_floor, gathered, path_echo
from experiments.judge.raycast import OBJECT, Hits
from experiments.judge.view import SAMPLES, SUB_BEAMS

BACKGROUND, HIGHLIGHT, SHADOW = 0, 1, 2
"""The classes."""
UNSEEN = 0.25
"""A mean echo below so much of the surrounding floor's cannot be seen [1]: −6 dB, the standard deviation of speckle."""


def labels(hits: Hits, device: Device) -> np.ndarray:
    """Classes (range, beam), uint8.

    h: share of a pixel's sub-beams where first hits of the object lie in its range cell (a hit fills the cell: no
    footprint is shorter than a bin); s: share of the pixel's floor that the object hides. The largest of h, s (1 − h)
    and (1 − h)(1 − s) names the class. What lies outside the flat part of the vertical aperture is neither.
    """
    covered, dark = _covered(hits, device), _hidden(hits)
    classes = np.stack([(1 - covered) * (1 - dark), covered, dark * (1 - covered)])
    return classes.argmax(axis=0).astype(np.uint8)


def _covered(hits: Hits, device: Device) -> np.ndarray:
    """h (range, beam), 0 where the face is too dim to be seen."""
    view = hits.view
    paths = hits.direct()
    lit = np.abs(paths.elevation_in) <= view.aperture / 2
    count = gathered(view, paths.column[lit], paths.length[lit], np.ones(lit.sum()))
    power = gathered(view, paths.column, paths.length, path_echo(paths, view, device))
    there = _pixels(hits, _bins(count).max(axis=1) > 0)
    echo = _pixels(hits, _bins(power).sum(axis=1))
    floor = _pixels(hits, SAMPLES * bare_floor(hits, device, first=SAMPLES // 2, step=SAMPLES))
    return np.where(echo >= UNSEEN * there * floor, there, 0)


def _hidden(hits: Hits) -> np.ndarray:
    """s (range, beam)."""
    rows = slice(0, hits.view.n_ranges * SAMPLES)
    hidden = (hits.kind[rows] == OBJECT) & (np.abs(hits.elevation[rows]) <= hits.view.aperture / 2)
    return _pixels(hits, _bins(hidden).mean(axis=1))


def _bins(samples: np.ndarray) -> np.ndarray:
    """Range samples (sample, sub) as (range, sample of the bin, sub)."""
    return samples.reshape(-1, SAMPLES, samples.shape[1])


def _pixels(hits: Hits, values: np.ndarray) -> np.ndarray:
    """Mean over each beam's sub-beams: (range, sub) to (range, beam)."""
    inside = values[:, hits.view.inner]
    return inside.reshape(len(inside), -1, SUB_BEAMS).mean(axis=2)
