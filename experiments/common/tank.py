"""Real frames of a water tank with hand-drawn outlines: how much of what lies there a segmenter calls highlight."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from skimage.measure import label
from tqdm import tqdm

import sonarjax as sj
from experiments.common.engine import engine
from experiments.common.fans import sector_of
from experiments.common.segmenters import loaded
from sonarjax.io import fan_to_polar, polar_to_fan, read_frames

OPENING = math.radians(30.0)
"""Opening of the fan [rad]: that of the device, which the frames' straight sides agree with."""
BEAMS = 128
"""Beams of the device, an ARIS 3000."""
HIGHLIGHT = 0.75
"""Least semantic grey that counts as highlight."""
WALL = 11
"""Class of the tank's wall, which is ignored; 1 to 10 are objects."""
HIT = 0.2
"""Share of an outline that must be highlight for its object to be hit [1]."""


def tank_metrics(folder: Path, segmenter: str) -> dict[str, float]:
    """IoU, precision and recall of highlight against the outlines, pooled over all frames, and share of objects hit.

    Frames are segmented in polar form, as the device measured them, and scored in the picture's own pixels. `folder`
    has images/ and masks/ of the same names. Raises SonarjaxError when it has none.
    """
    names = sorted(path.name for path in (folder / "images").glob("*.png"))
    if not names:
        raise sj.SonarjaxError(f"{folder}: expected frames in images/")
    true = false = missed = hit = objects = 0
    for name in tqdm(names, desc=f"tank, {segmenter}", unit="frame", leave=False, disable=None):
        picture = np.asarray(read_frames(folder / "images" / name)[0].image, np.float32)
        outlines = np.rint(255 * read_frames(folder / "masks" / name)[0].image).astype(int)
        found, seen = _highlight(picture, segmenter)
        counted = seen & (outlines != WALL)
        inside = (outlines > 0) & (outlines != WALL)
        true += int((found & inside & counted).sum())
        false += int((found & ~inside & counted).sum())
        missed += int((~found & inside & counted).sum())
        for kind in range(1, WALL):
            parts = label(outlines == kind, connectivity=2)
            for part in range(1, parts.max() + 1):
                objects += 1
                hit += bool(found[parts == part].mean() >= HIT)
    return {
        "iou": true / max(true + false + missed, 1),
        "precision": true / max(true + false, 1),
        "recall": true / max(true + missed, 1),
        "hit": hit / max(objects, 1),
        "objects": objects,
    }


def _highlight(picture: np.ndarray, segmenter: str) -> tuple[np.ndarray, np.ndarray]:
    """Where a fan picture (row, column) is highlight, and which pixels its sector covers."""
    geometry = sector_of(picture, OPENING)
    polar, mask = fan_to_polar(picture, geometry, (geometry.polar_shape()[0], BEAMS))
    semantic = loaded(segmenter).semantic(polar, mask, engine())
    axes = geometry.azimuth(BEAMS), geometry.range_edges(len(polar))
    back, seen = polar_to_fan(semantic, *axes, geometry, (picture.shape[0], picture.shape[1]), mask, order=1)
    return (back > HIGHLIGHT) & seen, seen
