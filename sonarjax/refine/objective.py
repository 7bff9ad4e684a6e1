"""What refinement minimises: 1 − NCC between the rendered window and the image, as least-squares residuals.

With both images blurred, freed of their mean and scaled to unit norm, the sum of squared differences is 2·(1 − NCC):
eq. 4 becomes a least-squares problem, and any grey image will do. What is rendered is the semantic image that the
paper matches, or the echo itself as a device would store it, whose facets are not all equally bright.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sonarjax.render import Window, floor_angle, render_echo, render_window, semantic_image
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel
from sonarjax.sensor.multipath import bounce_mesh, without_floor
from sonarjax.sonar import Sonar

SMALL = 1e-9
ELEVATIONS = 64
BEAMS_PER_BIN = 0.4  # a beam is about 2.5 bins wide at the ranges of §4.1: the blur is round on the floor
ROW_STRIDE = 2  # every second row of a blurred image holds all of it
Template = Literal["semantic", "echo"]
"""What is fitted to the image: the semantic image, or the echo as a device would store it."""
BACKGROUND = 0.5  # of the semantic image
NOMINAL = SensorModel.nominal()  # how bright an echo is beside floor and shadow, and how it is stored
OBJECT_GAIN = 10 ** (NOMINAL.object_gain / 10)


class Problem(NamedTuple):
    """One frame's refinement: everything the residuals need besides the pose."""

    image: Float[Array, "range beam"]
    """The window of the frame, any grey scale."""
    weight: Float[Array, "range beam"]
    """1 where the pixel was measured, else 0."""
    start: Pose
    """Where the search starts; its z, roll and pitch are kept."""
    window: Window
    """Which part of the frame that is."""
    sharpness: Float[Array, ""]
    """How sharply the template is labelled: see `labelled`."""


class Blur(NamedTuple):
    """A Gaussian blur as two matrices, whose rows sum to 1."""

    along: Float[Array, "row range"]
    across: Float[Array, "beam beam"]

    def __call__(self, image: Float[Array, "*batch range beam"]) -> Float[Array, "*batch row beam"]:
        """The blurred image, every ROW_STRIDE-th row of it."""
        return self.along @ image @ self.across.T


def make_blur(shape: tuple[int, int], sigma: Float[Array, ""] | float) -> Blur:
    """The blur of a window of `shape` (range, beam) by `sigma` [range bins], round on the floor."""
    rows, columns = shape

    def kernel(at: Array, size: int, sigma: Array) -> Array:
        weights = jnp.exp(-0.5 * ((at[:, None] - jnp.arange(size)) / sigma) ** 2)
        return weights / weights.sum(axis=1, keepdims=True)

    sigma = jnp.asarray(sigma, jnp.float32)
    along = kernel(jnp.arange(0, rows, ROW_STRIDE), rows, sigma)
    return Blur(along, kernel(jnp.arange(columns), columns, sigma * BEAMS_PER_BIN))


def pose_at(start: Pose, step: Float[Array, "step"]) -> Pose:
    """`start` moved by `step` = (yaw [rad], x [m], y [m], ...)."""
    return Pose(start.x + step[1], start.y + step[2], start.yaw + step[0], start.z, start.roll, start.pitch)


def labelled(share: Float[Array, "*batch"], sharpness: Float[Array, ""]) -> Float[Array, "*batch"]:
    """What a label image makes of a class's share of a pixel: all or nothing, softened to a logistic step at one half.

    Without it a beam that an object half covers pulls at the estimate although its label says nothing but 'all'; with
    it the yaw error on labels falls to half. `sharpness` 0 leaves the share as it is.
    """
    least = jax.nn.sigmoid(-sharpness / 2)
    rescaled = (jax.nn.sigmoid(sharpness * (share - 0.5)) - least) / jnp.where(sharpness > 0, 1 - 2 * least, 1.0)
    return jnp.where(sharpness > 0, rescaled, share)


def draw(
    problem: Problem, mesh: Mesh, sonar: Sonar, step: Float[Array, "step"], sub_beams: int, template: Template
) -> Float[Array, "range beam"]:
    """The window's template at `step` from the start, as what it differs from the bare floor's grey value.

    For the echo `step` has a fourth number, the energy that a bounce on the floor leaves.
    """
    pose, quality = pose_at(problem.start, step), (sub_beams, ELEVATIONS)
    if template == "echo":
        echo, shadow = render_echo(mesh, pose, sonar, problem.window, *quality)
        mirrored = bounce_mesh(mesh, pose, sonar, 0.0, NOMINAL.floor_path)
        bounced, _ = render_echo(*without_floor(mirrored, sonar), problem.window, *quality)
        energy = OBJECT_GAIN * (echo + step[3] * bounced) / floor_angle(_ranges(problem.window, sonar), sonar)[:, None]
        return _stored(energy + 1 - shadow) - _stored(1.0)
    layers = render_window(mesh, pose, sonar, problem.window, *quality)
    return semantic_image(*(labelled(v, problem.sharpness) for v in (layers.highlight, layers.shadow))) - BACKGROUND


def _ranges(window: Window, sonar: Sonar) -> Float[Array, "range"]:
    """Slant ranges [m] of the middles of a window's range bins."""
    return sonar.range_min + sonar.range_bin * (window.row + jnp.arange(window.shape[0]) + 0.5)


def _stored(energy: Any) -> Any:
    """Grey value of `energy`, in units of the bare floor's, at the nominal device."""
    return (energy + NOMINAL.noise) ** NOMINAL.exponent


def draw_with_slope(
    problem: Problem, mesh: Mesh, sonar: Sonar, step: Float[Array, "step"], sub_beams: int, template: Template
) -> tuple[Float[Array, "range beam"], Float[Array, "step range beam"]]:
    """`draw` and its derivatives by each number of `step` (forward mode)."""

    def draw_at(step: Array) -> Array:
        return draw(problem, mesh, sonar, step, sub_beams, template)

    return jax.vmap(lambda along: jax.jvp(draw_at, (step,), (along,)), out_axes=(None, 0))(jnp.eye(len(step)))


def normalised(image: Float[Array, "range beam"], weight: Float[Array, "range beam"]) -> Float[Array, "range beam"]:
    """`image` without its weighted mean and of unit weighted norm; zero where it is constant."""
    total = jnp.maximum(weight.sum(), SMALL)
    centred = (image - (image * weight).sum() / total) * weight
    return centred / jnp.sqrt((centred**2).sum() + SMALL)


def crop_score(
    image: Float[Array, "range beam"],
    drawn: Float[Array, "range beam"],
    weight: Float[Array, "range beam"],
    margin: tuple[int, int],
) -> Float[Array, ""]:
    """NCC (eq. 4) of a rendered template and the image over the template's own box and a `margin` (bins, beams)."""
    inside = weight * box_around(drawn, margin)
    return (normalised(image, inside) * normalised(drawn, inside)).sum()


def box_around(drawn: Float[Array, "range beam"], margin: tuple[int, int]) -> Bool[Array, "range beam"]:
    """True (range, beam) in the box of what a template of `draw` shows, with a `margin` (bins, beams) around it."""
    touched = jnp.abs(drawn) > 0.01
    return _extent(touched.any(axis=1), margin[0])[:, None] & _extent(touched.any(axis=0), margin[1])


def _extent(touched: Bool[Array, "size"], margin: int) -> Bool[Array, "size"]:
    index = jnp.arange(len(touched))
    first = jnp.where(touched, index, len(touched)).min() - margin
    last = jnp.where(touched, index, -1).max() + margin
    return (index >= first) & (index <= last)
