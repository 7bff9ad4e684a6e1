"""The frame that a sonar would store of an object on a lit floor: what calibration fits to frames.

Unlike a template, it has the floor's own brightness: the vertical pattern, whose edges say how the sonar is tilted, the
slope of the gain and the noise. How a device stores energy is a power of it, up to an offset and a factor that each
frame is free in; a small power stands for a logarithm.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.refine.objective import BEAMS_PER_BIN
from sonarjax.refine.template import VIEWS, Subject, nominal_law, render_layers
from sonarjax.render import RenderQuality, Window, WindowSize, floor_angle
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.pose import rotation_x, rotation_y
from sonarjax.sensor import SensorModel
from sonarjax.sensor.beams import beam_mixing
from sonarjax.sensor.propagation import elevation_gain, pulse_blur, range_middles
from sonarjax.sonar import Sonar


class Look(NamedTuple):
    """How the device shows energy, shared by all frames; each is a number."""

    gain: Any
    """Logarithm of the object's backscatter relative to the floor's [1]."""
    noise: Any
    """Logarithm of the noise relative to the floor's energy [1], at the reference range."""
    exponent: Any
    """Logarithm of the power of energy that is stored [1]."""
    skirt: Any
    """How steeply the vertical pattern falls outside the aperture [dB per degree]."""
    slope: Any
    """Power of range by which the floor brightens [1]."""
    noise_slope: Any
    """Power of range by which the noise does [1]: the time-varied gain's."""
    pulse: Any
    """Length of the pulse [range bins], 1 to 9."""
    widening: Any
    """−3 dB width of a beam, in units of the sonar's own [1]."""


_NOMINAL = SensorModel()
LOOK = Look(
    gain=math.log(10.0) * float(_NOMINAL.object_gain) / 10, noise=math.log(float(_NOMINAL.noise)), exponent=-2.0,
    skirt=float(_NOMINAL.elevation_skirt), slope=0.0, noise_slope=float(_NOMINAL.tvg_exponent),
    pulse=float(_NOMINAL.pulse_bins), widening=float(_NOMINAL.beam_widening),
)  # fmt: skip
"""Where a look starts: the nominal device's."""
LOOK_STD = Look(gain=1.0, noise=2.0, exponent=1.0, skirt=1.5, slope=1.5, noise_slope=1.5, pulse=1.0, widening=0.3)
"""Standard deviations of its prior: the range of the devices that the package draws."""
LOOK_TRUST = Look(gain=0.5, noise=0.8, exponent=0.4, skirt=2.0, slope=0.5, noise_slope=1.0, pulse=0.5, widening=0.2)
"""Largest change in one iteration."""
LEAST_EXPONENT = 0.02
"""Least power of energy [1]: as good as a logarithm."""


def object_layers(
    mesh: Mesh, sonar: Sonar, start: Pose, step: Float[Array, "pose"], column: Int[Array, ""], size: WindowSize
) -> Float[Array, "view layer range beam"]:
    """Echo, highlight and shadow of the object and of its mirror image in the floor, as `render_layers`.

    The window has all ranges and the beams from `column` on; `step` is yaw [rad], x, y [m] from `start`.
    """
    window = Window(0, column, size.shape, size.object_columns)
    quality = RenderQuality(sub_beams=1)
    subject = Subject(mesh, sonar, start, window, jnp.float32(0), jnp.int32(VIEWS["echo"]), nominal_law(), quality)
    return render_layers(subject, step)


def picture(
    sonar: Sonar,
    look: Look,
    layers: Float[Array, "view layer range column"],
    bounce: Float[Array, ""],
    column: Int[Array, ""],
    reference: Any,
) -> Float[Array, "range beam"]:
    """What is stored (range, beam), up to an offset and a factor: `layers` of the object over the lit floor.

    `bounce` is the energy that a bounce on the floor leaves [1], `reference` [m] the range at which the slopes are 1.
    """
    (echo, _, shadow), (bounced, *_) = layers
    ranges = range_middles(sonar)
    empty = jnp.zeros((len(ranges), sonar.n_beams))

    def placed(part: Array) -> Array:
        return jax.lax.dynamic_update_slice(empty, part, (0, column))

    from_object = placed(echo + bounce * bounced) / floor_angle(ranges, sonar)[:, None]
    lit = elevation_gain(floor_elevation(sonar, ranges), sonar.elevation_aperture, look.skirt)
    far = (ranges / reference)[:, None]
    # What stands above the floor is nearer to the beam axis than the floor at its range: the pattern is the floor's.
    energy = jnp.exp(look.gain) * from_object + (1 - placed(shadow)) * lit
    energy = pulse_blur(energy * far**look.slope, look.pulse)
    energy = (
        energy @ beam_mixing(sonar, jnp.maximum(look.widening, 0.3), _NOMINAL.beam_ways).T
        + jnp.exp(look.noise) * far**look.noise_slope
    )
    power = jnp.exp(look.exponent) + LEAST_EXPONENT
    return (energy**power - 1) / power


def floor_elevation(sonar: Sonar, ranges: Float[Array, "range"]) -> Float[Array, "range beam"]:
    """Elevation [rad] in the sonar frame of the floor that each pixel (range, beam) shows, with roll.

    From r·(n₃ sin φ + (n₁ cos θ + n₂ sin θ) cos φ) = −height, n the ground's upward direction in the sonar frame.
    """
    up = (rotation_y(sonar.tilt) @ rotation_x(sonar.roll))[2]
    azimuth = jnp.asarray(sonar.azimuth)
    ahead = up[0] * jnp.cos(azimuth) + up[1] * jnp.sin(azimuth)
    reach = jnp.hypot(up[2], ahead)
    down = jnp.clip(sonar.height / (ranges[:, None] * reach), 0.0, 1 - 1e-6)
    return -jnp.arcsin(down) - jnp.arctan2(ahead, up[2])


class Sampling(NamedTuple):
    """How a picture is compared with a frame: blurred, then every few pixels."""

    along: Float[Array | np.ndarray, "row range"]
    """Blur in range; its rows sum to 1."""
    across: Float[Array | np.ndarray, "column beam"]
    """Blur in azimuth."""

    def __call__(self, image: Float[Array | np.ndarray, "range beam"]) -> Any:
        """The blurred image (row, column), at every few pixels."""
        return self.along @ image @ self.across.T


ROWS, COLUMNS = 4, 2
"""Range bins and beams from one compared pixel to the next."""


def make_sampling(shape: tuple[int, int], blur: float) -> Sampling:
    """The sampling of frames of `shape` (range, beam) with a Gaussian of `blur` [range bins]."""

    def kernel(size: int, every: int, sigma: float) -> np.ndarray:
        at = np.arange(every // 2, size, every)
        weights = np.exp(-0.5 * ((at[:, None] - np.arange(size)) / sigma) ** 2)
        return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)

    return Sampling(kernel(shape[0], ROWS, blur), kernel(shape[1], COLUMNS, max(BEAMS_PER_BIN * blur, 0.8)))


UNEVEN_STD = 0.02
"""Standard deviation of each slow change of brightness over a frame [of the grey scale], as a prior."""


def fitted(
    drawn: Float[Array, "row column"], seen: Float[Array, "row column"], weight: Float[Array, "row column"]
) -> Float[Array, "row column"]:
    """The picture as it fits a frame best: offset, factor and slow changes of brightness by least squares.

    All are (row, column); `weight` is that of a squared difference. Linear in these few numbers, so they need no steps
    of their own: the derivative goes through them (variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10,
    1973).
    """
    rows, columns = drawn.shape
    down, across = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None]
    slow = [down + 0 * across, across + 0 * down, across**2 - 1 / 3 + 0 * down, down * across]
    spread = jnp.sqrt(jnp.maximum(jnp.var(drawn), 1e-6))
    basis = jnp.stack([jnp.ones_like(drawn), (drawn - drawn.mean()) / spread, *map(jnp.asarray, slow)])
    basis = basis.reshape(len(basis), -1)
    flat = weight.reshape(-1)
    ridge = np.array([1e-6, 1e-6, *[1 / UNEVEN_STD**2] * len(slow)], np.float32)
    normal = (basis * flat) @ basis.T + jnp.diag(jnp.asarray(ridge))
    return (jnp.linalg.solve(normal, (basis * flat) @ seen.reshape(-1)) @ basis).reshape(drawn.shape)
