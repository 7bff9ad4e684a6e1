"""How good semantic maps are on a crop around the object: intersection over union and PSNR (§4.3)."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.frames import TestFrame
from sonarjax.data import Box, cut_box
from sonarjax.data.crops import MARGIN, MARGIN_OF_FRAME
from sonarjax.segment.classical import from_grey
from sonarjax.segment.metrics import confusion, iou, psnr


def crop_of(clean: np.ndarray, margins: float = 1.0) -> Box:
    """The crop of a frame whose true map is `clean` (range, beam): object and shadow with margins on each side.

    `margins` is in units of the mean margin of training's crops: 0.3 of the object and 0.03 of the frame.
    """
    spans = []
    for axis, size in enumerate(clean.shape):
        touched = np.flatnonzero((np.abs(clean - 0.5) > 0.25).any(axis=1 - axis))
        margin = margins * (np.mean(MARGIN) * (touched[-1] + 1 - touched[0]) + np.mean(MARGIN_OF_FRAME) * size)
        first, last = max(touched[0] - margin, 0.0), min(touched[-1] + 1 + margin, size)
        spans.append((jnp.float32(first), jnp.float32(last - first)))
    (top, rows), (left, columns) = spans
    return Box(top, left, rows, columns)


def map_metrics(maps: Sequence[np.ndarray], frames: Sequence[TestFrame]) -> dict[str, float]:
    """Metrics of semantic maps (range, beam) of frames, on 128 × 128 crops.

    IoU over all pixels of all crops, of highlight, of shadow and their mean; PSNR against the true map [dB], mean over
    frames, of the raw crop and of the map, and what is gained; the gain again on crops of twice the margins.
    """
    crops = [_compare(made, f.image, f.clean, crop_of(f.clean)) for made, f in zip(maps, frames, strict=True)]
    wide = [_compare(made, f.image, f.clean, crop_of(f.clean, 2.0)) for made, f in zip(maps, frames, strict=True)]
    shares = np.asarray(iou(sum(counts for counts, _, _ in crops)))
    raw, made = (float(np.mean([crop[k] for crop in crops])) for k in (1, 2))
    return {
        "iou": float(shares[1:].mean()),
        "iou_highlight": float(shares[1]),
        "iou_shadow": float(shares[2]),
        "psnr_raw": raw,
        "psnr": made,
        "psnr_gain": made - raw,
        "psnr_gain_wide": float(np.mean([after - before for _, before, after in wide])),
    }


@jax.jit
def _compare(semantic: jax.Array, image: jax.Array, clean: jax.Array, box: Box) -> tuple[jax.Array, ...]:
    """Pixels (truth, predicted) of the labels on the crop, and its PSNR before and after segmentation."""
    made, raw, true = (cut_box(layer, box) for layer in (semantic, image, clean))
    return confusion(from_grey(made), from_grey(true)), psnr(raw, true), psnr(made, true)
