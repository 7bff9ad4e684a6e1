"""What a generator makes of the validation pairs, and how good it is."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from sonarjax.segment.classical import from_grey, to_grey
from sonarjax.segment.metrics import confusion, iou, psnr
from sonarjax.segment.step import GanConfig
from sonarjax.segment.training.batches import Stored
from sonarjax.segment.weights import GeneratorWeights, segment_patch

AT_ONCE = 16


@partial(jax.jit, static_argnames="config")
def predict(config: GanConfig, weights: Any, image: Float[Array, "pair 128 128"]) -> Float[Array, "pair 128 128"]:
    """Semantic maps in [0, 1] of images in [0, 1], both (pair, 128, 128); `weights` are the generator's variables."""
    return segment_patch(GeneratorWeights(weights, config.generator()), image)


def predict_all(config: GanConfig, weights: Any, pairs: Stored) -> np.ndarray:
    """`predict` for any number of pairs, a few at a time: semantic maps (pair, 128, 128)."""
    count = len(pairs.image)
    rows = np.minimum(np.arange(-(-count // AT_ONCE) * AT_ONCE), count - 1).reshape(-1, AT_ONCE)
    weights = jax.tree.map(jnp.asarray, jax.device_get(weights))  # a mesh's placement would be compiled into the code
    parts = [predict(config, weights, jnp.asarray(pairs.image[r] / np.float32(255))) for r in rows]
    return np.concatenate([np.asarray(part) for part in parts])[:count]


def score(grey: np.ndarray, pairs: Stored) -> dict[str, float]:
    """Metrics of predicted maps `grey` (pair, 128, 128), by name.

    `iou_*` compares labels over all pixels of all pairs. `psnr_db` compares the map with the true semantic map,
    `psnr_raw_db` the raw image with it, and `psnr_gain_db` is their difference. PSNR is averaged over the pairs that
    show an object, because an empty map that is predicted correctly has no error at all; if no pair shows an object,
    over all pairs.
    """
    shares = np.asarray(iou(confusion(jnp.asarray(from_grey(grey)), jnp.asarray(pairs.labels))), float)
    shown = pairs.labels.any(axis=(1, 2))
    shown |= not shown.any()
    truth = jnp.asarray(to_grey(pairs.labels[shown]))
    made = float(psnr(jnp.asarray(grey[shown]), truth).mean())
    raw = float(psnr(jnp.asarray(pairs.image[shown] / np.float32(255)), truth).mean())
    return {
        "iou_background": float(shares[0]),
        "iou_highlight": float(shares[1]),
        "iou_shadow": float(shares[2]),
        "iou_mean": float(shares[1:].mean()),
        "psnr_db": made,
        "psnr_raw_db": raw,
        "psnr_gain_db": made - raw,
    }


def contact_sheet(grey: np.ndarray, pairs: Stored, columns: int = 8) -> UInt8[np.ndarray, "row column"]:
    """A picture (row, column) of the first pairs: the image above the predicted map above the true map."""
    columns = min(columns, len(grey))
    layers = (pairs.image, np.rint(255 * grey), np.rint(255 * to_grey(pairs.labels)))
    rows = [np.concatenate(list(layer[:columns]), axis=1).astype(np.uint8) for layer in layers]
    return np.concatenate(rows, axis=0)
