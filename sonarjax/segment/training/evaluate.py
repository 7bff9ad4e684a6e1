"""What a generator makes of the validation pairs, and how good that is."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from sonarjax.segment.generator import to_grey
from sonarjax.segment.metrics import confusion, iou, psnr
from sonarjax.segment.step import GanConfig
from sonarjax.segment.training.batches import Stored

AT_ONCE = 16
GREY = np.array([0.5, 1.0, 0.0], np.float32)


@partial(jax.jit, static_argnames="config")
def predict(
    config: GanConfig, weights: Any, image: Float[Array, "pair 128 128"]
) -> tuple[Float[Array, "pair 128 128"], UInt8[Array, "pair 128 128"]]:
    """Grey semantic maps in [0, 1] and labels, both (pair, 128, 128), of images (pair, 128, 128) in [0, 1].

    `weights` are the generator's variables. Labels are the largest class, or the grey cut at 1/4 and 3/4.
    """
    output = jnp.asarray(config.generator().apply(weights, 2 * image[..., None] - 1))
    grey = (to_grey(output)[..., 0] + 1) / 2
    if config.head == "classes":
        return grey, jnp.argmax(output, axis=-1).astype(jnp.uint8)
    return grey, jnp.where(grey > 0.75, 1, jnp.where(grey < 0.25, 2, 0)).astype(jnp.uint8)


def predict_all(config: GanConfig, weights: Any, pairs: Stored) -> tuple[np.ndarray, np.ndarray]:
    """`predict` for any number of pairs, a few at a time: grey and labels (pair, 128, 128)."""
    count = len(pairs.image)
    rows = np.minimum(np.arange(-(-count // AT_ONCE) * AT_ONCE), count - 1).reshape(-1, AT_ONCE)
    parts = [predict(config, weights, jnp.asarray(pairs.image[r] / np.float32(255))) for r in rows]
    return tuple(np.concatenate([np.asarray(p[k]) for p in parts])[:count] for k in range(2))  # type: ignore[return-value]


def score(grey: np.ndarray, labels: np.ndarray, pairs: Stored) -> dict[str, float]:
    """Metrics of predicted `grey` and `labels` (pair, 128, 128) by name.

    `iou_*` over all pixels of all pairs; `psnr_db`, `psnr_raw_db` and `psnr_gain_db` are means over pairs, of the grey
    map and of the raw image against the true semantic map.
    """
    shares = np.asarray(iou(confusion(jnp.asarray(labels), jnp.asarray(pairs.labels))), float)
    truth = jnp.asarray(GREY[pairs.labels])
    made = float(psnr(jnp.asarray(grey), truth).mean())
    raw = float(psnr(jnp.asarray(pairs.image / np.float32(255)), truth).mean())
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
    """A picture (row, column) of the first pairs: image above the predicted map above the true one."""
    columns = min(columns, len(grey))
    layers = (pairs.image, np.rint(255 * grey), np.rint(255 * GREY[pairs.labels]))
    rows = [np.concatenate(list(layer[:columns]), axis=1).astype(np.uint8) for layer in layers]
    return np.concatenate(rows, axis=0)
