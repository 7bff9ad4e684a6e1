"""What refinement fits to an image: a template rendered at a pose, and its derivatives by all fitted numbers.

The `semantic` template is the one that the paper matches. The `echo` is the frame as a device would store it: each
facet as bright as eq. 2 makes it, and the echoes by way of the floor. Both come from one rendered view of the object.
The echo needs two more views, of its mirror image in the floor: sound that bounces on both ways appears to come from
there, as bars inside the shadow; sound that bounces on one way only arrives between, from where walls meet the floor.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.exact import full_precision
from sonarjax.records import record, static
from sonarjax.refine.free import ON_FLOOR, pose_at
from sonarjax.render import RenderQuality, Window, semantic_image
from sonarjax.render.frame import BACKGROUND
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import EchoLaw, SensorModel, render_paths, stored_echo
from sonarjax.sensor.echoes import FLOOR_PATHS
from sonarjax.sonar import Sonar

Template = Literal["semantic", "echo", "either"]
EITHER = 0
VIEWS: dict[str, int] = {"semantic": 1, "echo": 1 + len(FLOOR_PATHS), "either": EITHER}
"""Number of views of the object that each template needs; EITHER until a search has chosen."""
BOUNCE_BOUNDS: dict[str, tuple[float, float]] = {"semantic": (0.0, 0.0), "echo": (0.0, 1.0), "either": (0.0, 1.0)}
"""Bounds of each energy left after bouncing on the floor [1], which is fitted together with yaw, x and y."""
POSE = len(ON_FLOOR)
"""How many numbers of the usual step move the object: yaw, x and y. The bounces' energies follow them."""
GAINS_DB, NOISES, EXPONENTS = (2.0, 8.0, 14.0), (0.03, 0.2), (0.06, 0.25, 0.5)
"""Gains [dB], noises and exponents of the echo law, tried in all combinations."""


def echo_laws() -> EchoLaw:
    """The laws (law,) that are tried on a frame; the first is that of the nominal device.

    They span the devices that the package draws (`sensor.model`).
    """
    device = SensorModel()
    tried = [(device.object_gain, device.noise, device.exponent), *itertools.product(GAINS_DB, NOISES, EXPONENTS)]
    gain, noise, exponent = (np.asarray(v, np.float32) for v in zip(*tried, strict=True))
    return EchoLaw(*(jnp.asarray(v) for v in (10 ** (gain / 10), noise, exponent)))


def nominal_law() -> EchoLaw:
    """The law of the nominal device: the first of those that are tried."""
    return jax.tree.map(lambda v: jnp.asarray(v[0]), echo_laws())


@record
class Subject:
    """What is rendered: everything on which a template depends, besides the fitted step."""

    mesh: Mesh
    """The object."""
    sonar: Sonar
    """The sonar that looks at it."""
    start: Pose
    """Where the search starts; numbers that are not `free` stay there."""
    window: Window
    """Which part of the frame is rendered."""
    sharpness: Float[Array, ""]
    """How sharply pixels of a semantic template are assigned to one class, see `labelled`."""
    views: Int[Array, ""]
    """1 for the semantic template, 3 for the echo, see `VIEWS`."""
    law: EchoLaw
    """How the echo is stored."""
    quality: RenderQuality = static()
    """How finely it is rendered."""
    free: tuple[str, ...] = static(default=ON_FLOOR)
    """The numbers of the pose that a step changes, in the order of `free.NUMBERS`."""


@record
class Drawn:
    """The templates at the solutions, each in its own window of the frame."""

    template: Float[Array, "*batch row column"]
    """The fitted template, as its difference from the bare floor."""
    labels: Float[Array, "*batch row column"]
    """The semantic template, minus the background's 0.5."""
    row: Int[Array, "*batch"]
    """First range bin of the window."""
    column: Int[Array, "*batch"]
    """First beam of the window."""
    views: Int[Array, "*batch"]
    """Which template was fitted, see `VIEWS`."""
    law: EchoLaw
    """How the echo is stored in it."""
    bounces: Float[Array, "*batch bounce"]
    """Energies left of the echoes by way of the floor in it [1]."""

    def part(self, image: np.ndarray) -> np.ndarray:
        """Cut the window out of an image.

        Args:
            image: An image (range, beam) of the complete frame. The record must hold a single template.

        Returns:
            The window (row, column) of it.
        """
        rows, columns = self.template.shape
        top, left = int(self.row), int(self.column)
        return image[top : top + rows, left : left + columns]


def labelled(share: Float[Array, "*batch"], sharpness: Float[Array, ""]) -> Float[Array, "*batch"]:
    """Turn a class's share of a pixel into what a label image shows: all or nothing, softened to a logistic step at one
    half.

    Without this, a beam that is half covered pulls at the estimate, although its label only says 'all'. With it the yaw
    error on labels is halved. `sharpness` 0 leaves the share unchanged.
    """
    least = jax.nn.sigmoid(-sharpness / 2)
    rescaled = (jax.nn.sigmoid(sharpness * (share - 0.5)) - least) / jnp.where(sharpness > 0, 1 - 2 * least, 1.0)
    return jnp.where(sharpness > 0, rescaled, share)


def draw(subject: Subject, step: Float[Array, "step"], reverse: bool = False) -> Float[Array, "range beam"]:
    """The window's template at `step` from the start, as its difference from the grey of the bare floor.

    `step` holds the free numbers of the pose [rad, m] and, for the echo, the energies left of the bounces on the floor
    [1]. Forward-mode differentiation always works. With `reverse`, reverse mode works too, at the cost of always
    rendering all views.
    """
    count = len(subject.free)
    return paint(subject, render_layers(subject, step[:count], reverse), step[count:])


def with_slopes(function: Callable[..., Array], at: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    """A function's value at the arguments `at`, and its forward-mode derivatives (tangent, ...) along `tangents`.

    `tangents` has an array (tangent, ...) for each argument. The value is computed once for all of them.
    """
    return jax.vmap(lambda *along: jax.jvp(function, at, along), out_axes=(None, 0))(*tangents)


def layers_with_slope(
    subject: Subject, step: Float[Array, "step"]
) -> tuple[Float[Array, "view layer range beam"], Float[Array, "pose view layer range beam"]]:
    """`render_layers`, and its forward-mode derivatives by each free number of the pose."""
    count = len(subject.free)
    return with_slopes(partial(render_layers, subject), (step[:count],), (jnp.eye(count),))


def paint_with_slope(
    subject: Subject, layers: Array, slopes: Array, bounces: Float[Array, "bounce"]
) -> tuple[Float[Array, "range beam"], Float[Array, "step range beam"]]:
    """`paint`, and its derivatives by each number of a step: the pose's, from the `slopes` of the layers, and
    the bounces'.
    """
    by_bounces = jnp.concatenate([jnp.zeros((len(slopes), len(bounces))), jnp.eye(len(bounces))])
    slopes = jnp.concatenate([slopes, jnp.zeros((len(bounces), *layers.shape))])

    return with_slopes(partial(paint, subject), (layers, bounces), (slopes, by_bounces))


def render_layers(
    subject: Subject, step: Float[Array, "pose"], reverse: bool = False, floor_paths: Sequence[Any] = FLOOR_PATHS
) -> Float[Array, "view layer range beam"]:
    """Echo, highlight and shadow of the object at `step` (pose,) [rad, m], and of its mirror images in the floor.

    There is one mirror image for each of `floor_paths` [1], which are as in `sensor.SensorModel`. They are left dark if
    the template takes only one view. `reverse` is as in `draw`.
    """
    pose = pose_at(subject.start, step, subject.free)
    where = subject.sonar, subject.window, subject.quality
    return render_paths(subject.mesh, pose, *where, subject.views, floor_paths, reverse)


@full_precision
def paint(
    subject: Subject, layers: Float[Array, "view layer range beam"], bounces: Float[Array, "bounce"]
) -> Float[Array, "range beam"]:
    """The template from the layers of `render_layers`, given the energies (bounce,) that `bounces` leave [1]."""
    echo, highlight, shadow = layers[0]
    bounced = jnp.einsum("v,vrb->rb", bounces, layers[1:, 0])
    grey = semantic_image(*(labelled(v, subject.sharpness) for v in (highlight, shadow))) - BACKGROUND
    stored = stored_echo(echo + bounced, shadow, subject.sonar, subject.window, subject.law)
    return jnp.where(subject.views > 1, stored, grey)


def semantic_template(layers: Float[Array, "view layer range beam"]) -> Float[Array, "range beam"]:
    """The semantic map from the layers of `render_layers`, minus the background's 0.5; not sharpened."""
    _, highlight, shadow = layers[0]
    return semantic_image(highlight, shadow) - BACKGROUND
