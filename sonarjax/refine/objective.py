"""What refinement minimises: 1 − NCC between the rendered window and the image, as least-squares residuals.

With both images blurred, freed of their mean and scaled to unit norm, the sum of squared differences is 2·(1 − NCC):
eq. 4 becomes a least-squares problem, and any grey image will do.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sonarjax.render import Window, semantic_window
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

SMALL = 1e-9


class Problem(NamedTuple):
    """One frame's refinement: everything the residuals need besides the pose."""

    image: Float[Array, "range beam"]
    """The window of the frame, any grey scale."""
    weight: Float[Array, "range beam"]
    """1 where the pixel was measured, else 0."""
    mesh: Mesh
    sonar: Sonar
    start: Pose
    """Where the search starts; its z, roll and pitch are kept."""
    row: Array
    """First row of the window in the frame."""
    column: Array
    """First column of the window in the frame."""


def moved(start: Pose, step: Float[Array, "3"], bounds: Float[Array, "3"]) -> Pose:
    """The pose `step` away from `start`: (yaw, x, y) = start + bounds·tanh(step), so that the search is bounded."""
    delta = bounds * jnp.tanh(step)
    return Pose(start.x + delta[1], start.y + delta[2], start.yaw + delta[0], start.z, start.roll, start.pitch)


def template(problem: Problem, pose: Pose, sub_beams: int) -> Float[Array, "range beam"]:
    """The semantic image of the problem's window at `pose`."""
    rows, columns = problem.image.shape
    window = Window(problem.row, problem.column, (rows, columns))
    return semantic_window(problem.mesh, pose, problem.sonar, window, sub_beams, 64)


def blur_matrix(size: int, sigma: Float[Array, ""]) -> Float[Array, "size size"]:
    """Gaussian blur along one axis as a matrix whose rows sum to 1; `sigma` in pixels."""
    distance = jnp.arange(size)[:, None] - jnp.arange(size)
    kernel = jnp.exp(-0.5 * (distance / sigma) ** 2)
    return kernel / kernel.sum(axis=1, keepdims=True)


def normalised(image: Float[Array, "range beam"], weight: Float[Array, "range beam"]) -> Float[Array, "range beam"]:
    """`image` without its weighted mean and of unit weighted norm; zero where it is constant."""
    total = jnp.maximum(weight.sum(), SMALL)
    centred = (image - (image * weight).sum() / total) * weight
    return centred / jnp.sqrt((centred**2).sum() + SMALL)


def residuals(
    step: Float[Array, "3"], problem: Problem, bounds: Float[Array, "3"], sigma: Float[Array, ""], sub_beams: int
) -> Float[Array, "pixel"]:
    """Difference (pixel,) of the blurred, normalised template and image: half their squared sum is 1 − NCC."""
    rows, columns = problem.image.shape
    along, across = blur_matrix(rows, sigma), blur_matrix(columns, sigma * BEAMS_PER_BIN)
    drawn = template(problem, moved(problem.start, step, bounds), sub_beams)

    def view(image: Array) -> Array:
        filled = image * problem.weight
        return normalised(along @ filled @ across.T, problem.weight)

    return (view(drawn - 0.5) - view(problem.image)).reshape(-1)


BEAMS_PER_BIN = 0.4  # a beam is about 2.5 bins wide at the ranges of §4.1: the blur is round on the floor


def crop_score(
    image: Float[Array, "range beam"],
    drawn: Float[Array, "range beam"],
    weight: Float[Array, "range beam"],
    margin: tuple[int, int],
) -> Float[Array, ""]:
    """NCC (eq. 4) of a rendered template and the image over the template's own box and a `margin` (bins, beams)."""
    touched = jnp.abs(drawn - 0.5) > 0.01
    box = _extent(touched.any(axis=1), margin[0])[:, None] & _extent(touched.any(axis=0), margin[1])
    inside = weight * box
    return (normalised(image, inside) * normalised(drawn, inside)).sum()


def _extent(touched: Bool[Array, "size"], margin: int) -> Bool[Array, "size"]:
    index = jnp.arange(len(touched))
    first = jnp.where(touched, index, len(touched)).min() - margin
    last = jnp.where(touched, index, -1).max() + margin
    return (index >= first) & (index <= last)
