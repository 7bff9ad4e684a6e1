"""Banks that take little memory, for catalogues of many targets.

Templates are stored as bytes, and their spectra are computed anew for each frame. Templates are padded to a few common
shapes, which share compiled code. A bank of 36 templates takes a few hundred kilobytes instead of ten megabytes, but
matching takes twice as long.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from sonarjax.match.masked import NEAR_CONSTANT
from sonarjax.match.ncc import MatchPositions, best_position, per_template
from sonarjax.match.spectra import ROUNDING, correlate, frame_spectrum, over_chunks, pack, unit_templates

ROWS, COLUMNS = 128, 32
"""Templates are padded to multiples of this many range bins and beams, so that banks of one size share compiled
code.
"""


class CompactBank(NamedTuple):
    """Templates with 256 grey levels; the rounding error is 1/510 at most."""

    levels: UInt8[np.ndarray, "yaw h w"]
    """Grey values 0 to 1 stored as 0 to 255."""

    @classmethod
    def of(cls, templates: Float[np.ndarray, "yaw h w"]) -> CompactBank:
        """Make a bank of templates (yaw, h, w) with values from 0 to 1."""
        return cls(np.round(255 * np.clip(templates, 0, 1)).astype(np.uint8))

    @property
    def templates(self) -> Float[np.ndarray, "yaw h w"]:
        """The templates (yaw, h, w), float32 from 0 to 1."""
        return self.levels.astype(np.float32) / 255


def match_compact(image: Float[np.ndarray, "range beam"], bank: CompactBank) -> MatchPositions:
    """Match a compact bank with `image` (range, beam), as `match_positions` does.

    Returns:
        The best score (yaw,) of each template (eq. 4), and the corner of its best window.
    """
    centred = centred_on_host(image)
    height, width = bank.levels.shape[1:]
    more = (0, 0), (0, min(-height % ROWS, image.shape[0] - height)), (0, min(-width % COLUMNS, image.shape[1] - width))
    return _match(centred.astype(np.float32), window_scale(centred, (height, width)), np.pad(bank.levels, more),
                  np.int32(height), np.int32(width))  # fmt: skip


def centred_on_host(image: np.ndarray) -> np.ndarray:
    """`image` minus its mean, as `spectra.centred_frame`, but in float64 for sums over windows."""
    mean = image.mean(dtype=np.float64)
    constant = np.ptp(image) <= ROUNDING * abs(mean)
    return np.zeros(image.shape) if constant else image.astype(np.float64) - mean


def window_scale(centred: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """1/√energy of the window at each corner (range, beam); 0 where it is nearly constant or extends beyond the frame.

    Energy is that of the deviations from the window's own mean.

    Args:
        centred: The frame (range, beam) minus its mean.
        window: Shape of the window.
    """
    sums = [np.pad(np.cumsum(np.cumsum(v, 0), 1), ((1, 0), (1, 0))) for v in (centred, centred**2)]
    (h, w), scale = window, np.zeros_like(centred)
    total, squares = (s[h:, w:] - s[:-h, w:] - s[h:, :-w] + s[:-h, :-w] for s in sums)
    energy = squares - total**2 / (h * w)  # a difference of large numbers, hence float64
    enough = energy > NEAR_CONSTANT * sums[1][-1, -1]
    scale[: energy.shape[0], : energy.shape[1]] = np.where(enough, 1 / np.sqrt(np.where(enough, energy, 1)), 0)
    return scale.astype(np.float32)


@jax.jit
def _match(image: Array, scale: Array, levels: Array, height: Array, width: Array) -> MatchPositions:
    rows, columns = jnp.arange(levels.shape[1]), jnp.arange(levels.shape[2])
    inside = ((rows < height)[:, None] & (columns < width)[None, :]).astype(jnp.float32)
    templates = levels.astype(jnp.float32) / 255
    unit = unit_templates(templates, jnp.broadcast_to(inside, templates.shape))
    shape = image.shape[0], image.shape[1]
    frame = frame_spectrum(image)
    corners = jnp.arange(shape[0]) <= shape[0] - height, jnp.arange(shape[1]) <= shape[1] - width
    fits = corners[0][:, None] & corners[1]

    def best(planes: Array) -> MatchPositions:
        return best_position(jnp.where(fits, correlate(frame, planes, shape) * scale, -jnp.inf))

    found = over_chunks(best, pack(unit, shape))
    return per_template(found, len(levels))
