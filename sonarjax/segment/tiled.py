"""Tiled inference: a frame of any size through a generator that was trained on crops, then a closer look at each
object.

Tiles have the size of the frames from which training pairs are cut, so a pixel covers as much of the scene as it did in
training. A closer look is a crop around an object that the tiles show, the main kind of training crop (see
`data.crops.CROP_SHARES`). The network sees it once as it is and once mirrored, and the two answers are averaged.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sonarjax.crops import LEAST, PATCH, TRAINING_FRAME, Box, cut_box, paste_patch
from sonarjax.exact import check_single_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, check_whole, image_array, is_whole, number_array, several, shown
from sonarjax.render.frame import BACKGROUND
from sonarjax.segment.objects import find_objects
from sonarjax.segment.weights import GeneratorWeights, segment_patch
from sonarjax.sonar.image import check_values

TILE = TRAINING_FRAME
"""Largest size of a tile (range, beam) [pixels]."""
CLOSER = 6
"""Most objects that get a closer look (experiments/fit_closer_looks.py)."""
MARGIN, MARGIN_OF_FRAME = 0.15, 0.015
"""Margin on each side of a closer look: `MARGIN` times the object's extent plus `MARGIN_OF_FRAME` times the frame's.
This is a quarter of the largest margin of a training crop (see `data.crops`)."""


class _Seen(NamedTuple):
    """What the looks so far have shown."""

    sums: Float[Array, "2 range beam"]
    """Weighted sum of the tiles' maps, and sum of the weights."""
    grey: Float[Array, "range beam"]
    """The semantic map, once all tiles are in."""
    boxes: Float[Array, "look 4"]
    """Place of each look: top, left, rows and columns. Closer looks get theirs after the last tile."""
    wanted: Bool[Array, "look"]
    """False for a closer look without an object."""


def segment(
    image: Any,
    weights: GeneratorWeights,
    mask: Any = None,
    *,
    closer: int = CLOSER,
    tile: tuple[int, int] = TILE,
) -> Float[Array, "range beam"]:
    """Compute the semantic map of a frame by tiled inference.

    A pure function; use `jax.vmap` for a batch of frames.

    Args:
        image: Grey frame (range, beam) in [0, 1].
        weights: The network.
        mask: True where the frame was measured (range, beam); None means everywhere. Elsewhere the map is background,
            and the network is given the median of the measured pixels, which is mostly floor. Dark pixels there would
            make the floor beside them look like highlight.
        closer: Most objects that get a closer look.
        tile: Largest size of a tile (range, beam) [pixels].

    Returns:
        Map (range, beam): shadow 0, background 0.5, highlight 1.

    Raises:
        SonarjaxError: The image is not one frame, a measured pixel is not finite or lies far outside [0, 1], the mask
            has another shape, `weights` is something else, `closer` or `tile` are no numbers of objects and pixels, or
            JAX is in its 64-bit mode.
    """
    check_single_precision()
    check_kind(weights, GeneratorWeights, "weights")
    check_frame(image, mask)
    check_whole(closer, 0, "closer")
    size = several(tile)
    if size is None or len(size) != 2 or not all(is_whole(n) and n > 0 for n in size):
        raise SonarjaxError(f"tile: expected two numbers of pixels (range, beam), got {shown(tile)}")
    image, mask = plain_frame(image, mask)
    return _segment(image, weights, mask, closer=int(closer), tile=(int(size[0]), int(size[1])))


def plain_frame(image: Any, mask: Any) -> tuple[Any, Any]:
    """A frame and its mask as arrays that JAX takes: lists, and numbers in another byte order, it does not."""
    image = image if isinstance(image, jax.Array) else np.asarray(image, np.float32)
    return image, mask if mask is None or isinstance(mask, jax.Array) else np.asarray(mask, bool)


def check_frame(image: Any, mask: Any = None) -> None:
    """Raise a SonarjaxError unless an image is one frame of numbers (range, beam), and a mask has its shape.

    Measured pixels must be finite and not far outside [0, 1], as `check_values` has it for all that takes frames. Of
    traced values only types and shapes are looked at.
    """
    if not isinstance(image, jax.Array):
        image_array(image, "image")
    if mask is not None and not isinstance(mask, jax.Array):
        number_array(mask, "mask")
    if np.ndim(image) != 2 or 0 in np.shape(image):
        raise SonarjaxError(f"image: expected one frame (range, beam), got shape {np.shape(image)}")
    if mask is not None and np.shape(mask) != np.shape(image):
        raise SonarjaxError(f"mask: expected the image's shape {np.shape(image)}, got {np.shape(mask)}")
    if not (isinstance(image, jax.core.Tracer) or isinstance(mask, jax.core.Tracer)):
        _check_measured(np.asarray(image), mask)


def _check_measured(image: np.ndarray, mask: Any) -> None:
    """Raise a SonarjaxError if the measured pixels are no grey values. There may be none: then all is background."""
    values = image.ravel() if mask is None else image[np.asarray(mask, bool)]
    if values.size:
        check_values(values.astype(np.float32, copy=False), "image")


@partial(jax.jit, static_argnames=("closer", "tile"))
def _segment(
    image: Float[Array, "range beam"], weights: GeneratorWeights, mask: Bool[Array, "range beam"] | None, *,
    closer: int, tile: tuple[int, int],
) -> Float[Array, "range beam"]:  # fmt: skip
    """`segment`, compiled."""
    image = jnp.asarray(image, jnp.float32)
    seen = image if mask is None else jnp.where(mask, image, _median(image, mask))
    tiles = _tiles(image.shape, tile)
    count = len(tiles)
    start = _Seen(
        sums=jnp.zeros((2, *image.shape)),
        grey=jnp.full(image.shape, BACKGROUND),
        boxes=jnp.concatenate([jnp.asarray(tiles), jnp.ones((closer, 4))]),
        wanted=jnp.arange(count + closer) < count,
    )

    def look(state: _Seen, k: Int[Array, ""]) -> tuple[_Seen, None]:
        box, is_tile = Box(*state.boxes[k]), k < count
        patch = cut_box(seen, box)
        pair = jnp.stack([patch, patch[:, ::-1]])
        wanted = state.wanted[k] & jnp.stack([jnp.bool_(True), ~is_tile])
        # Tiles and closer looks, mirrored or not, all go through this one call, so the network is compiled once.
        plain, mirrored = jax.lax.map(lambda job: _ask(weights, *job), (pair, wanted))
        answer = jnp.where(is_tile, plain, (plain + mirrored[:, ::-1]) / 2)
        state = jax.lax.cond(is_tile, _blend, _paste, state, answer, box, state.wanted[k])
        last = k == count - 1
        return jax.lax.cond(last, partial(_after_tiles, mask=mask, closer=closer), lambda s: s, state), None

    grey = jax.lax.scan(look, start, jnp.arange(count + closer))[0].grey
    return grey if mask is None else jnp.where(mask, grey, BACKGROUND)


def _ask(
    weights: GeneratorWeights, patch: Float[Array, "height width"], wanted: Bool[Array, ""]
) -> Float[Array, "height width"]:
    """The network's answer to a crop; if it is not wanted, nothing is computed."""
    return jax.lax.cond(wanted, lambda p: segment_patch(weights, p[None])[0], jnp.zeros_like, patch)


def _median(image: Float[Array, "range beam"], mask: Bool[Array, "range beam"]) -> Float[Array, ""]:
    """Median of the measured pixels; 0.5 if there are none."""
    return jnp.nan_to_num(jnp.nanmedian(jnp.where(mask, image, jnp.nan)), nan=BACKGROUND)


def _tiles(shape: tuple[int, ...], tile: tuple[int, int]) -> Float[np.ndarray, "tile 4"]:
    """Boxes that cover a frame, each overlapping half of its neighbour: top, left, rows and columns."""
    starts = []
    for size, most in zip(shape, tile, strict=True):
        count = max(-(-2 * (size - most) // most), 0) + 1
        starts.append(np.linspace(0.0, max(size - most, 0), count, dtype=np.float32))
    tops, lefts = (edges.ravel() for edges in np.meshgrid(*starts, indexing="ij"))
    rows, columns = (np.full(tops.shape, min(size, most), np.float32) for size, most in zip(shape, tile, strict=True))
    return np.stack([tops, lefts, rows, columns], axis=1)


def _blend(state: _Seen, answer: Float[Array, "height width"], box: Box, wanted: Any) -> _Seen:
    """Add the map of one more tile to the sums, with the greatest weight in its middle."""
    ramps = [np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / n for n in PATCH]
    shape = state.grey.shape[0], state.grey.shape[1]
    share = paste_patch(jnp.asarray(ramps[0][:, None] * ramps[1], jnp.float32), box, shape, 0.0)
    return state._replace(sums=state.sums + jnp.stack([share * paste_patch(answer, box, shape), share]))


def _after_tiles(state: _Seen, mask: Bool[Array, "range beam"] | None, closer: int) -> _Seen:
    """The map from all tiles, and the boxes of the closer looks, the clearest object last."""
    total, shares = state.sums
    grey = total / shares
    grey = grey if mask is None else jnp.where(mask, grey, BACKGROUND)
    if not closer:
        return state._replace(grey=grey)
    objects = find_objects(grey, closer)
    boxes = jax.vmap(lambda bounds: jnp.stack(box_around(bounds, grey.shape)))(objects.bounds[::-1])
    return state._replace(
        grey=grey,
        boxes=state.boxes.at[-closer:].set(boxes),
        wanted=state.wanted.at[-closer:].set(objects.found[::-1]),
    )


def _paste(state: _Seen, answer: Float[Array, "height width"], box: Box, wanted: Bool[Array, ""]) -> _Seen:
    """Replace the map by a closer look's answer, in the pixels that lie completely inside its box.

    Where the closer look is less sure than the map, their mean is used, so that an object that its box cuts off is not
    lost.
    """
    shape = state.grey.shape[0], state.grey.shape[1]
    look = paste_patch(answer, box, shape)
    surer = jnp.abs(look - BACKGROUND) >= jnp.abs(state.grey - BACKGROUND)
    joined = jnp.where(surer, look, (look + state.grey) / 2)
    return state._replace(grey=jnp.where(pixels_inside(box, shape) & wanted, joined, state.grey))


def box_around(bounds: Int[Array, "4"], shape: tuple[int, ...]) -> Box:
    """A box around pixels (top, left, bottom, right), with the margins of a closer look, inside a frame of `shape`."""
    starts, sizes = [], []
    for axis, (size, least) in enumerate(zip(shape, LEAST, strict=True)):
        low, high = bounds[axis], bounds[axis + 2]
        margin = jnp.maximum(MARGIN * (high - low) + MARGIN_OF_FRAME * size, (least - (high - low)) / 2)
        first, last = jnp.maximum(low - margin, 0.0), jnp.minimum(high + margin, float(size))
        starts.append(first)
        sizes.append(last - first)
    return Box(starts[0], starts[1], sizes[0], sizes[1])


def pixels_inside(box: Box, shape: tuple[int, int]) -> Bool[Array, "range beam"]:
    """Which pixels (range, beam) of a frame of `shape` lie completely inside a box."""
    rows, columns = (jnp.arange(n) for n in shape)
    inside_rows = (rows >= jnp.ceil(box.top)) & (rows < jnp.floor(box.top + box.rows))
    inside_columns = (columns >= jnp.ceil(box.left)) & (columns < jnp.floor(box.left + box.columns))
    return inside_rows[:, None] & inside_columns
