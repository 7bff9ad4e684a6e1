"""A whole frame through a generator that was trained on patches: tiles first, then a closer look at each object.

Tiles have the size of the frames that training pairs are cut from, so a pixel means there what it meant in training. A
closer look is a crop around what the tiles show, the main kind of training crop (see `data.crops.CROP_SHARES`); it is
taken as it is and mirrored, and the mean of both answers counts.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from skimage.measure import label as connected_parts
from skimage.measure import regionprops
from skimage.morphology import closing

from sonarjax.data import PATCH, Box, PairSettings, cut_box, paste_patch
from sonarjax.data.crops import LEAST
from sonarjax.engine import PLAIN, Engine
from sonarjax.segment.weights import GeneratorWeights, segment_patch

TILE = (PairSettings.n_ranges, PairSettings.n_beams)
"""Largest extent of a tile (range, beam) [pixels]."""
CLOSER = 3
"""Objects that are looked at closely, at most."""
LEAST_SHARE = 0.2
"""Least evidence of an object that is looked at closely, relative to that of the clearest."""
MARGIN, MARGIN_OF_FRAME = 0.15, 0.015
"""Margin on each side of a closer look, in extents of the object plus extents of the frame: a quarter of the largest
that a training crop has (see `data.crops`)."""


def segment_frame(
    weights: GeneratorWeights,
    image: Float[np.ndarray, "range beam"],
    mask: Bool[np.ndarray, "range beam"] | None = None,
    *,
    closer: bool = True,
    tile: tuple[int, int] = TILE,
    engine: Engine = PLAIN,
) -> Float[np.ndarray, "range beam"]:
    """Semantic grey (range, beam) of a frame (range, beam) in [0, 1]: shadow 0, background 0.5, highlight 1.

    Pixels outside `mask` are background. The network sees the median of what was measured there: floor, mostly. Dark
    pixels would make a highlight of the floor beside them. `closer` False stops after the tiles, which are at most
    `tile` (range, beam) large.
    """
    seen = jnp.asarray(image if mask is None else np.where(mask, image, _middle(image[mask])), jnp.float32)
    grey = _through_tiles(weights, seen, tile, engine)
    if mask is not None:
        grey = np.where(mask, grey, np.float32(0.5))
    for box in _objects(grey) if closer else []:
        looked = _through_box(weights, seen, Box(*map(float, box)), engine)
        inside = pixels_inside(box)
        grey[inside] = looked[inside]
    return grey if mask is None else np.where(mask, grey, np.float32(0.5))


def _middle(values: Float[np.ndarray, " pixel"]) -> float:
    return float(np.median(values)) if values.size else 0.5


def _tiles(shape: tuple[int, ...], tile: tuple[int, int]) -> list[Box]:
    """Boxes that cover a frame, neighbours half over one another."""
    starts = []
    for size, most in zip(shape, tile, strict=True):
        count = max(-(-2 * (size - most) // most), 0) + 1
        starts.append(np.linspace(0.0, max(size - most, 0), count, dtype=np.float32))
    tops, lefts = (edges.ravel() for edges in np.meshgrid(*starts, indexing="ij"))
    rows, columns = (np.full(tops.shape, min(size, most), np.float32) for size, most in zip(shape, tile, strict=True))
    return [Box(*map(float, box)) for box in zip(tops, lefts, rows, columns, strict=True)]


def _through_tiles(
    weights: GeneratorWeights, image: Float[Array, "range beam"], tile: tuple[int, int], engine: Engine
) -> Float[np.ndarray, "range beam"]:
    """The maps of all tiles, blended."""
    # The network is asked for one patch at a time, here as in a closer look: it is compiled once.
    sums = jnp.zeros((2, *image.shape))
    for box in _tiles(image.shape, tile):
        sums = _blend(sums, segment_patch(weights, _cut(image, box)[None], engine=engine)[0], box)
    total, shares = np.asarray(sums)
    return total / shares


def _through_box(
    weights: GeneratorWeights, image: Float[Array, "range beam"], box: Box, engine: Engine
) -> Float[np.ndarray, "range beam"]:
    """The map of a closer look."""
    patch = _cut(image, box)
    as_it_is, mirrored = (segment_patch(weights, seen[None], engine=engine)[0] for seen in (patch, patch[:, ::-1]))
    return np.asarray(_paste((as_it_is + mirrored[:, ::-1]) / 2, box, (image.shape[0], image.shape[1])))


_cut = jax.jit(cut_box)
_paste = jax.jit(paste_patch, static_argnames="shape")


@jax.jit
def _blend(
    sums: Float[Array, "2 range beam"], patch: Float[Array, "patch_range patch_beam"], box: Box
) -> Float[Array, "2 range beam"]:
    """Weighted sum of maps and sum of weights with one more tile's: it counts most in its middle."""
    ramps = [np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / n for n in PATCH]
    shape = sums.shape[1], sums.shape[2]
    share = paste_patch(jnp.asarray(ramps[0][:, None] * ramps[1], jnp.float32), box, shape, 0.0)
    return sums + jnp.stack([share * paste_patch(patch, box, shape), share])


def _objects(grey: Float[np.ndarray, "range beam"]) -> list[Box]:
    """Boxes around what is highlight or shadow, the clearest object last."""
    evidence = np.abs(grey - 0.5)
    parts = connected_parts(closing(evidence > 0.25, np.ones((9, 3), bool)))
    found = sorted(regionprops(parts, evidence), key=lambda part: part.image_intensity.sum())[-CLOSER:]
    return [
        box_around(part.bbox, grey.shape)
        for part in found
        if part.image_intensity.sum() >= LEAST_SHARE * found[-1].image_intensity.sum()
    ]


def box_around(bounds: tuple[int, ...], shape: tuple[int, ...]) -> Box:
    """A box around pixels (top, left, bottom, right) with the margins of a closer look, inside a frame of `shape`."""
    starts, sizes = [], []
    for axis, (size, least) in enumerate(zip(shape, LEAST, strict=True)):
        low, high = bounds[axis], bounds[axis + 2]
        margin = max(MARGIN * (high - low) + MARGIN_OF_FRAME * size, (least - (high - low)) / 2)
        first, last = max(low - margin, 0.0), min(high + margin, float(size))
        starts.append(first)
        sizes.append(last - first)
    return Box(starts[0], starts[1], sizes[0], sizes[1])


def pixels_inside(box: Box) -> tuple[slice, slice]:
    """Rows and columns of the pixels that lie wholly inside a box."""
    edges = ((box.top, box.top + box.rows), (box.left, box.left + box.columns))
    rows, columns = (slice(math.ceil(low), math.floor(high)) for low, high in edges)
    return rows, columns
