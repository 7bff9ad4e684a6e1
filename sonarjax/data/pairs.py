"""Training pairs as a jitted function of a key (§3.1): what a sonar shows of a random object, and its labels.

A pair is an image (range, beam) of 256 values in [0, 1], and labels 0 background, 1 highlight, 2 shadow. Both are 128 ×
128 crops of one frame. The labels are those of the object alone, as in a template. Tank walls are background. So is
floor that is missing or unlit, although it looks dark (a template is 0.5 there).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jax.random import fold_in
from jaxtyping import Array, Float, UInt8

from sonarjax.crops import TRAINING_FRAME, cut_box
from sonarjax.data.crops import cut_labels, draw_box
from sonarjax.data.draws import SEEDS, key_numbers
from sonarjax.data.materials import draw_reflectivity
from sonarjax.data.objects import draw_shape
from sonarjax.data.scenes import render_scenes
from sonarjax.data.shapes import N_FACES, remove_walls, shape_mesh
from sonarjax.data.tank_views import draw_tank_view
from sonarjax.data.variations import vary, without_floor
from sonarjax.data.views import draw_view
from sonarjax.engine import PLAIN, Engine
from sonarjax.exact import full_precision
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, check_whole, is_number, is_whole, several, shown
from sonarjax.records import record
from sonarjax.render import RenderQuality
from sonarjax.scene import Pose
from sonarjax.sensor import SensorModel, observe, render_bounces

PAPER_PAIRS = 6780
"""Pairs in the paper's training set (§3.1)."""
SPLITS = {"train": 1, "validation": 2, "test": 3}
SMOOTHING = 1.5
"""Largest standard deviation of a resampled picture's blur [pixels]. No source: about that of a mean over five
pixels, for pictures much coarser than the frame; one linear interpolation between pixels has 0.4.
"""
CHUNK = 8  # pairs that one call of the compiled function makes
VMAPPED = 64  # the same on an accelerator, where they are computed at once


@dataclass(frozen=True)
class PairSettings:
    """What all pairs have in common. Hashable, so that it can be a static argument under `jax.jit`."""

    n_ranges: int = TRAINING_FRAME[0]
    """Range bins of the frame from which a pair is cut."""
    n_beams: int = TRAINING_FRAME[1]
    """Beams of that frame."""
    severity: tuple[float, float] = (0.0, 2.0)
    """Least and largest severity of the sensor model [1], drawn uniformly."""
    sub_beams: int = 1
    """Equal azimuth parts of each beam, as in `RenderQuality`."""
    elevations: int = 16
    """Elevation cells of the energy integral, as in `RenderQuality`."""
    odd: float = 0.75
    """Share of pairs [1] with an unusual device, place and material (`SensorModel.draw_wide`,
    `draw_reflectivity`). The others have a device from `SensorModel.draw`, and equal faces.
    """
    smoothed: float = 0.3
    """Share of pairs [1] whose image was resampled after it was stored, and so smoothed, as fan pictures are."""
    tank: bool = False
    """Use only views of §3.1 (`draw_tank_view`), instead of any sonar at any place (`draw_view`)."""
    varied: bool = False
    """Turn some objects into chains and frames of bars, let some hang, and make some large or pale (`vary`)."""

    def __post_init__(self) -> None:
        """Raise a SonarjaxError for settings that no pair can have."""
        for name in ("n_ranges", "n_beams", "sub_beams", "elevations"):
            check_whole(getattr(self, name), 1, name)
        for name in ("odd", "smoothed"):
            if not (is_number(getattr(self, name)) and 0 <= getattr(self, name) <= 1):
                raise SonarjaxError(f"{name}: expected a share from 0 to 1, got {shown(getattr(self, name))}")
        found = several(self.severity) or ()
        if len(found) != 2 or not all(map(is_number, found)) or not 0 <= found[0] <= found[1] < math.inf:
            raise SonarjaxError(f"severity: expected two numbers of 0 or more in order, got {shown(self.severity)}")
        object.__setattr__(self, "severity", (float(found[0]), float(found[1])))  # a list has no hash


PAPER_SETTINGS = PairSettings(odd=0.0, smoothed=0.0, tank=True)
"""The pairs of §3.1: a DIDSON in the tank of Table 1."""


@record
class Pairs:
    """Images and their labels."""

    image: Float[Array, "*pair 128 128"]
    """What a sonar shows, in [0, 1], a multiple of 1/255."""
    labels: UInt8[Array, "*pair 128 128"]
    """0 background, 1 highlight, 2 shadow."""

    def __len__(self) -> int:
        return len(self.image)


def split_key(run_seed: int, split: str) -> Array:
    """Derive the key of a split's pairs from the seed of a run. No two splits share a pair.

    Args:
        run_seed: Seed of the run.
        split: "train", "validation" or "test".

    Returns:
        A JAX key, for `make_pairs`.

    Raises:
        SonarjaxError: The split is unknown, or the seed no whole number from 0 to 2³² − 1.
    """
    if not (is_whole(run_seed) and 0 <= run_seed < SEEDS):
        raise SonarjaxError(f"run_seed: expected a whole number from 0 to {SEEDS - 1}, got {shown(run_seed)}")
    if split not in SPLITS:
        raise SonarjaxError(f"pairs: split: expected one of {', '.join(SPLITS)}, got {split!r}")
    return fold_in(jax.random.key(run_seed), SPLITS[split])


def make_pairs(
    count: int, settings: PairSettings = PairSettings(), *, key: Array, first: int = 0, engine: Engine = PLAIN
) -> Pairs:
    """Make pairs from a key. Pair i is the same whatever others are made with it.

    Args:
        count: How many.
        settings: What they have in common.
        key: Source of all random numbers.
        first: Number of the first pair.
        engine: Runs the compiled functions.

    Returns:
        Images and labels (count, 128, 128).

    Raises:
        SonarjaxError: `count` is no whole number of 1 or more, `first` none of 0 or more, a pair's number 2³² or more,
            `key` no JAX key, or `settings` something else.
    """
    check_whole(count, 1, "count")
    check_whole(first, 0, "first")
    if first + count > SEEDS:
        raise SonarjaxError(f"first: expected pairs with numbers below {SEEDS}, got up to {first + count - 1}")
    check_kind(settings, PairSettings, "settings")
    key_numbers(key)  # raises if it is no key
    check_kind(engine, Engine, "engine")
    size = CHUNK if jax.default_backend() == "cpu" else VMAPPED
    starts = list(range(first, first + count, size))

    def chunk(start: int) -> Pairs:
        return _chunk(key, jnp.uint32(start), size, settings)

    parts = [chunk(starts[0]), *engine.map(chunk, starts[1:])]  # the first alone, or each thread would compile it
    return jax.tree.map(lambda *v: jnp.concatenate(v)[:count], *parts)


def paper_pairs(run_seed: int, settings: PairSettings = PAPER_SETTINGS) -> Pairs:
    """Make the fixed set of §3.1: 6,780 training pairs.

    Args:
        run_seed: Seed of the run.
        settings: What the pairs have in common; the default is a DIDSON in the tank of Table 1.

    Returns:
        Images and labels (6780, 128, 128).
    """
    return make_pairs(PAPER_PAIRS, settings, key=split_key(run_seed, "train"))


@partial(jax.jit, static_argnames=("size", "settings"))
def _chunk(key: Array, start: Array, size: int, settings: PairSettings) -> Pairs:
    numbers = start + jnp.arange(size, dtype=jnp.uint32)
    at_once = None if jax.default_backend() == "cpu" else size
    return jax.lax.map(lambda n: draw_pair(settings, key=fold_in(key, n)), numbers, batch_size=at_once)


def draw_pair(settings: PairSettings, *, key: Array) -> Pairs:
    """Draw a single pair, without the leading axis."""
    shape_key, view_key, severity_key, model_key, noise_key, box_key, odd_key = jax.random.split(key, 7)
    shape = draw_shape(key=shape_key)
    draw = draw_tank_view if settings.tank else draw_view
    view = draw(settings.n_ranges, settings.n_beams, key=view_key)
    level: Array | float = 1.0
    if settings.varied:
        shape, variation = vary(shape, key=fold_in(shape_key, 1))
        level = variation.reflectivity
        view = view._replace(sonar=without_floor(view.sonar, variation.no_floor & ~view.has_walls))
    mesh = shape_mesh(shape.kind, view.pose.to_ground(shape.vertices), view.walls)
    low, high = settings.severity
    severity = jax.random.uniform(severity_key, minval=low, maxval=high)
    odd = jax.random.uniform(odd_key) < settings.odd
    device = SensorModel.draw(key=model_key, severity=severity)
    model = jax.tree.map(partial(jnp.where, odd), SensorModel.draw_wide(key=model_key, severity=severity), device)
    painted = draw_reflectivity(mesh, view.sonar.height, N_FACES, key=fold_in(odd_key, 1))
    painted = jnp.where(odd, painted, 1.0)
    if settings.varied:
        painted = jnp.where(jnp.arange(len(painted)) < N_FACES, level, 1.0) * painted
    mesh = replace(mesh, reflectivity=painted)
    quality = RenderQuality(settings.sub_beams, settings.elevations)
    alone, seen = render_scenes(mesh, view, quality)
    echoes = render_bounces(remove_walls(mesh), Pose(), view.sonar, model, quality=quality)
    image = observe(seen, model, key=noise_key, bounces=echoes)
    image = _resampled(image, settings.smoothed, key=fold_in(odd_key, 2))
    box = draw_box(alone.labels(), key=box_key)
    patch = jnp.round(255 * jnp.clip(cut_box(image, box), 0.0, 1.0)) / 255
    return Pairs(patch, cut_labels(alone.highlight, alone.shadow, box))


@full_precision
def _resampled(image: Array, share: float, *, key: Array) -> Array:
    """Smooth an image (range, beam), with probability `share`, as if it was converted to a fan picture and back.

    No source: a Gaussian of random width along each axis stands for whatever interpolation a viewer uses. It is the
    same all over the frame, while a real fan picture blurs neighbouring beams most at short range.
    """
    happens, width = jax.random.uniform(key, (3,))[0] < share, SMOOTHING * jax.random.uniform(key, (3,))[1:]
    for axis in (0, 1):
        place = jnp.arange(image.shape[axis])
        weights = jnp.exp(-jnp.square((place[:, None] - place) / jnp.maximum(width[axis], 0.1)) / 2)
        weights = weights / weights.sum(axis=1, keepdims=True)
        image = jnp.where(happens, jnp.moveaxis(jnp.tensordot(weights, image, (1, axis)), 0, axis), image)
    return image
