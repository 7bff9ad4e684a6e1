"""What refinement fits to an image: a template rendered at a pose, and its derivatives by all that is fitted.

The `semantic` template is the one that the paper matches. The `echo` is the frame as a device would store it: each
facet as bright as eq. 2 makes it, and what comes by way of the floor, as bars inside the shadow.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sonarjax.refine.objective import Problem
from sonarjax.render import Window, floor_angle, render_echo, render_window, semantic_image
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel
from sonarjax.sensor.multipath import bounce_mesh, without_floor
from sonarjax.sensor.propagation import range_middles
from sonarjax.sonar import Sonar

ELEVATIONS = 64
BACKGROUND = 0.5  # of the semantic image
DEVICE = SensorModel()  # the nominal device: how bright an echo is beside floor and shadow, and how it is stored
OBJECT_GAIN = 10 ** (DEVICE.object_gain / 10)
BESIDES: dict[str, tuple[tuple[float, float], ...]] = {"semantic": (), "echo": ((0.0, 1.0),)}
"""The templates, and bounds of what each needs besides yaw, x and y: the energy that a bounce on the floor leaves."""


def labelled(share: Float[Array, "*batch"], sharpness: Float[Array, ""]) -> Float[Array, "*batch"]:
    """What a label image makes of a class's share of a pixel: all or nothing, softened to a logistic step at one half.

    Without it a beam that an object half covers pulls at the estimate although its label says nothing but 'all'; with
    it the yaw error on labels falls to half. `sharpness` 0 leaves the share as it is.
    """
    least = jax.nn.sigmoid(-sharpness / 2)
    rescaled = (jax.nn.sigmoid(sharpness * (share - 0.5)) - least) / jnp.where(sharpness > 0, 1 - 2 * least, 1.0)
    return jnp.where(sharpness > 0, rescaled, share)


def pose_at(start: Pose, step: Float[Array, "step"]) -> Pose:
    """`start` moved by `step` = (yaw [rad], x [m], y [m], ...)."""
    return Pose(start.x + step[1], start.y + step[2], start.yaw + step[0], start.z, start.roll, start.pitch)


def draw(
    problem: Problem, mesh: Mesh, sonar: Sonar, step: Float[Array, "step"], sub_beams: int, template: str
) -> Float[Array, "range beam"]:
    """The window's template at `step` from the start, as what it differs from the bare floor's grey value.

    `step` is yaw [rad], x and y [m], and for the echo the energy that a bounce on the floor leaves [1].
    """
    pose = pose_at(problem.start, step)
    if template == "echo":
        return _echo(mesh, pose, sonar, problem.window, sub_beams, step[3])
    layers = render_window(mesh, pose, sonar, problem.window, sub_beams, ELEVATIONS)
    return semantic_image(*(labelled(v, problem.sharpness) for v in (layers.highlight, layers.shadow))) - BACKGROUND


def draw_with_slope(
    problem: Problem, mesh: Mesh, sonar: Sonar, step: Float[Array, "step"], sub_beams: int, template: str
) -> tuple[Float[Array, "range beam"], Float[Array, "step range beam"]]:
    """`draw` and its derivatives by each number of `step` (forward mode)."""

    def draw_at(step: Array) -> Array:
        return draw(problem, mesh, sonar, step, sub_beams, template)

    return jax.vmap(lambda along: jax.jvp(draw_at, (step,), (along,)), out_axes=(None, 0))(jnp.eye(len(step)))


def _echo(mesh: Mesh, pose: Pose, sonar: Sonar, window: Window, sub_beams: int, bounce: Array) -> Array:
    """What a nominal device stores of the object, its bounce on the floor and its shadow (range, beam)."""
    mirrored, lift, lifted = without_floor(bounce_mesh(mesh, pose, sonar, 0.0, DEVICE.floor_path), sonar)
    direct_view = pose.to_ground(mesh.vertices), mesh.faces, jnp.zeros(()), sonar.height, sonar.elevation_aperture
    bounced_view = mirrored.vertices, mirrored.faces, lift.z, lifted.height, lifted.elevation_aperture

    def seen(view: tuple[Array, ...]) -> tuple[Array, Array]:
        vertices, faces, lift, height, aperture = view
        placed = replace(mesh, vertices=vertices, faces=faces)
        turned = sonar.replace(height=height, elevation_aperture=aperture)
        return render_echo(placed, Pose(z=lift), turned, window, sub_beams, ELEVATIONS)

    # One after the other, so that the renderer is compiled once; the mirror image's shadow is not looked at.
    views = (jnp.stack([jnp.asarray(v) for v in pair]) for pair in zip(direct_view, bounced_view, strict=True))
    (direct, bounced), (shadow, _) = jax.lax.map(seen, tuple(views))
    ranges = jax.lax.dynamic_slice(range_middles(sonar), (window.row,), window.shape[:1])
    energy = OBJECT_GAIN * (direct + bounce * bounced) / floor_angle(ranges, sonar)[:, None]
    return _stored(energy + 1 - shadow) - _stored(1.0)


def _stored(energy: Any) -> Any:
    """Grey value of `energy`, in units of the bare floor's."""
    return (energy + DEVICE.noise) ** DEVICE.exponent
