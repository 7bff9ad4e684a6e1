"""A frame's residuals and their derivatives: its part of the normal equations of a calibration."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.calibrate.look import Look
from sonarjax.calibrate.parameters import changed_mesh, changed_sonar, resting
from sonarjax.calibrate.picture import Sampling, fitted, measured_mean, object_layers, picture, placed
from sonarjax.exact import full_precision
from sonarjax.records import record
from sonarjax.refine.template import POSE, with_slopes
from sonarjax.render import WindowSize
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

OWN = POSE + 1
"""How many numbers a frame has of its own: yaw [rad], x, y [m] and the energy left after a bounce on the floor [1]."""
HUBER = 2.0
"""Number of standard deviations beyond which a residual counts linearly."""
LOOK_GROUPS = (
    ("gain", "skirt", "slope", "pulse", "rim", "streak"), ("widening", "leak"),
    ("noise", "exponent", "log_share", "noise_slope", "dark", "white"),
)  # fmt: skip
"""The look by where it enters the picture: energies, beams, display. `floor_path` enters with the object's layers."""


@record
class Observation:
    """A frame in the form in which it is compared."""

    image: Float[Array | np.ndarray, "range beam"]
    """The frame, on any grey scale; 0 where nothing was measured."""
    mask: Float[Array | np.ndarray, "range beam"]
    """1 where a pixel was measured, else 0."""
    start: Pose
    """The pose from which its search starts."""
    column: Any
    """First beam of the window in which the object is rendered."""


class Blocks(NamedTuple):
    """A frame's part of the normal equations: its own numbers first, then those of the sonar and of the look."""

    hessian: Float[Array, "number number"]
    """Jᵀ·W·J."""
    gradient: Float[Array, "number"]
    """Jᵀ·W·residual."""
    cost: Float[Array, ""]
    """Half of the robust sum of squares."""
    square: Float[Array, "row"]
    """Mean square of the residuals of each row [grey²], over measured pixels; 0 if there are none."""


@partial(jax.jit, static_argnames=("free", "size"))
@full_precision
def linearise(
    seen: Observation, mesh: Mesh, sonar: Sonar, shared: Array, own: Array, sampling: Sampling, std: Array,
    reference: Array, *, free: tuple[str, ...], size: WindowSize,
) -> tuple[Array, ...]:  # fmt: skip
    """The fields of a frame's `Blocks` at `shared` (free + look,) and `own` (4,).

    `std` (row,) are the standard deviations of the residuals [grey]; `reference` [m] is that of `picture`.
    """
    change, look = shared[: len(free)], Look(*shared[len(free) :])
    share = sampling(seen.mask)
    weight = share / std[:, None] ** 2
    image = measured_mean(sampling, seen.image, seen.mask)

    def layers_at(step: Array, change: Array, path: Array) -> Array:
        grown, changed = changed_mesh(mesh, free, change), changed_sonar(sonar, free, change)
        start = seen.start if grown is mesh else resting(seen.start, mesh, grown)
        return object_layers(grown, changed, start, step, path, seen.column, size)

    def residual(layers: Array, change: Array, look: Look, bounce: Array) -> Array:
        drawn = picture(changed_sonar(sonar, free, change), look, layers, bounce, reference)
        return fitted(measured_mean(sampling, drawn, seen.mask), image, weight) - image

    found, jacobian = _residual_slopes(layers_at, residual, sonar.n_beams, seen.column, change, look, own)
    scaled = jnp.abs(found) / std[:, None]
    robust = jnp.where(scaled > HUBER, HUBER / jnp.maximum(scaled, 1e-6), 1.0)
    loss = jnp.where(scaled > HUBER, HUBER * (scaled - HUBER / 2), scaled**2 / 2)
    weighted = jacobian * (robust * weight)
    hessian = jnp.einsum("irb,jrb->ij", weighted, jacobian)
    # A plain tuple, because `CpuEngine` stores compiled code in files and does not know the type `Blocks`.
    square = (robust * share * found**2).sum(axis=1) / jnp.maximum(share.sum(axis=1), 1e-6)
    return hessian, jnp.einsum("irb,rb->i", weighted, found), (share * loss).sum(), square


def _residual_slopes(
    layers_at: Callable[..., Array], residual: Callable[..., Array], n_beams: int, column: Any, change: Array,
    look: Look, own: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """The residuals (row, column), and their derivatives (number, row, column) in the order of `Blocks`.

    Numbers that enter the picture at the same place are derived together, so that nothing is derived in vain: a display
    law changes neither the echoes nor what the beams mix.
    """
    step, bounce, count = own[:POSE], own[POSE], len(change)
    by_step, by_change, by_path = jnp.split(jnp.eye(POSE + count + 1), (POSE, POSE + count), axis=1)
    at, along = (step, change, look.floor_path), (by_step, by_change, by_path[:, 0])
    layers, slopes = (placed(v, column, n_beams) for v in with_slopes(layers_at, at, along))
    found, by_geometry = with_slopes(
        lambda *moved: residual(*moved, look, bounce), (layers, change), (slopes, by_change)
    )
    _, by_bounce = with_slopes(lambda left: residual(layers, change, look, left), (bounce,), (jnp.ones(1),))
    by_look = {"floor_path": by_geometry[-1]}
    for names in LOOK_GROUPS:

        def with_look(values: Array, names: tuple[str, ...] = names) -> Array:
            return residual(layers, change, look._replace(**dict(zip(names, values, strict=True))), bounce)

        values = jnp.stack([getattr(look, name) for name in names])
        by_look |= zip(names, with_slopes(with_look, (values,), (jnp.eye(len(names)),))[1], strict=True)
    ordered = jnp.stack([by_look[name] for name in Look._fields])
    return found, jnp.concatenate([by_geometry[:POSE], by_bounce, by_geometry[POSE:-1], ordered])
