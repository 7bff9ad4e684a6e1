"""The picture that a sonar would store of an object on a lit floor. Calibration fits it to frames.

Unlike a template it includes the brightness of the floor: the vertical pattern, whose edges show how the sonar is
tilted, the slope of the gain, and the noise. A device stores a blend of a logarithm and a power of energy, between
black and white. An offset and a factor are free in each frame.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.calibrate.look import LEAST_EXPONENT, Look
from sonarjax.exact import full_precision
from sonarjax.refine.objective import BEAMS_PER_BIN
from sonarjax.refine.template import VIEWS, Subject, nominal_law, render_layers
from sonarjax.render import RenderQuality, Window, WindowSize, floor_angle
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel
from sonarjax.sensor.beams import beam_mixing, streaks
from sonarjax.sensor.propagation import elevation_gain, floor_elevation, pulse_blur, range_middles
from sonarjax.sonar import Sonar

LEAK_BEAMS = 10.0
"""Number of beams over which the leak into other beams falls to 1/e."""
OWN_BEAMS = 2
"""Beams within this distance do not count as leaking: the beam pattern describes what they hear."""
CORNER = 1.5
"""Sharpness of the corners at black and white [1]; the speckle of one look rounds them about as much."""
BEAM_WAYS = float(SensorModel().beam_ways)


def object_layers(
    mesh: Mesh, sonar: Sonar, start: Pose, step: Float[Array, "pose"], floor_path: Any, column: Int[Array, ""],
    size: WindowSize,
) -> Float[Array, "view layer range beam"]:  # fmt: skip
    """Echo, highlight and shadow of the object and of its mirror image in the floor, as `render_layers` gives them.

    The window has all ranges, and the beams from `column` on. `step` is yaw [rad], x and y [m] relative to `start`.
    `floor_path` [1] is that of `sensor.SensorModel`.
    """
    window = Window(0, column, size.shape, size.object_columns)
    quality = RenderQuality(sub_beams=1)
    subject = Subject(mesh, sonar, start, window, jnp.float32(0), jnp.int32(VIEWS["echo"]), nominal_law(), quality)
    return render_layers(subject, step, floor_paths=(floor_path,))


def placed(layers: Float[Array, "*batch column"], column: Int[Array, ""], n_beams: int) -> Float[Array, "*batch beam"]:
    """`object_layers`, or their derivatives, over all beams; `column` is the first beam of their window.

    Not a part of `picture`, because JAX turns a batch of such updates into a scatter, which is slow on a CPU.
    """
    empty = jnp.zeros((*layers.shape[:-1], n_beams))
    return jax.lax.dynamic_update_slice(empty, layers, (*[0] * (layers.ndim - 1), column))


def picture(
    sonar: Sonar,
    look: Look,
    layers: Float[Array, "view layer range beam"],
    bounce: Float[Array, ""],
    reference: Any,
) -> Float[Array, "range beam"]:
    """The picture that is stored (range, beam), up to an offset and a factor: the object's `layers` over the lit floor.

    `layers` are those of `placed`; `bounce` is the share of energy left after a bounce on the floor [1]. At the range
    `reference` [m] the slopes are 1.
    """
    energy = _received(sonar, look, layers, bounce, reference)
    return stored(clipped(energy, jnp.exp(look.dark), jnp.exp(look.white)), look)


def stored(energy: Float[Array, "*batch"], look: Look) -> Float[Array, "*batch"]:
    """What a device stores of `energy` (*batch) between black and white, up to an offset and a factor.

    Blends a logarithm and a power, as `sensor.compress` does. Both are 0, and have slope 1, at the floor's energy.
    """
    power = jnp.exp(look.exponent) + LEAST_EXPONENT
    return look.log_share * jnp.log(energy) + (1 - look.log_share) * (energy**power - 1) / power


@full_precision
def _received(
    sonar: Sonar, look: Look, layers: Float[Array, "view layer range beam"], bounce: Float[Array, ""], reference: Any
) -> Float[Array, "range beam"]:  # fmt: skip
    """Energy relative to the floor's: object, shadow and bounce, after pulse, glints, beams and noise."""
    ranges = range_middles(sonar)
    far = (ranges / reference)[:, None]
    (echo, share, shadow), (bounced, *_) = layers
    bare = floor_angle(ranges, sonar)[:, None]
    lit = elevation_gain(floor_elevation(sonar), sonar.elevation_aperture, look.skirt)
    gain = jnp.exp(look.gain)
    # Physically the energies of object and floor add up, each with its own backscatter. The simulator's
    # `received_energy` instead gives both one mixed backscatter, by the object's share of the pixel, and the floor's
    # vertical pattern. The difference amounts to a tenth of a pixel at the rim, so `rim` is fitted to the frames.
    apart = gain * echo / bare + (1 - shadow) * lit
    mixed = (echo / bare + 1 - shadow) * lit * (share * gain + 1 - share)
    # With a `rim` above 1 the unlit part of an object would have a negative energy.
    energy = jnp.maximum(apart + look.rim * (mixed - apart), 0.0) + gain * bounce * bounced / bare
    energy = pulse_blur(energy * far**look.slope, look.pulse)
    energy = streaks(energy, share, jnp.exp(look.streak))
    mixing = beam_mixing(sonar, jnp.maximum(look.widening, 0.3), BEAM_WAYS)
    energy = energy @ (leaking(sonar.n_beams, jnp.exp(look.leak)) @ mixing).T
    return energy + jnp.exp(look.noise) * far**look.noise_slope


def leaking(n_beams: int, level: Any) -> Float[Array, "beam source"]:
    """Matrix (beam, source) of the leaks between beams, `level` in total; rows sum to one.

    This is a smooth version of `crosstalk_mixing`, for which it need not be known which beams fire together.
    """
    apart = np.abs(np.arange(n_beams)[:, None] - np.arange(n_beams))
    weight = np.where(apart > OWN_BEAMS, np.exp(-apart / LEAK_BEAMS), 0.0)
    share = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    mixed = np.eye(n_beams) + level * share
    return mixed / (1 + level * share.sum(axis=1, keepdims=True))  # with very few beams there is nothing to leak from


def clipped(energy: Float[Array, "*batch"], dark: Any, white: Any) -> Float[Array, "*batch"]:
    """`energy` (...) limited to between `dark` and `white`, with rounded corners, see `CORNER`."""
    raised = (energy**CORNER + dark**CORNER) ** (1 / CORNER)
    return (raised**-CORNER + white**-CORNER) ** (-1 / CORNER)


class Sampling(NamedTuple):
    """How picture and frame are compared: blurred, then at every few pixels."""

    along: Float[Array | np.ndarray, "row range"]
    """Blur along range; rows sum to 1."""
    across: Float[Array | np.ndarray, "column beam"]
    """Blur along azimuth; rows sum to 1."""

    @full_precision
    def __call__(self, image: Float[Array | np.ndarray, "range beam"]) -> Any:
        """The blurred image (row, column) at every few pixels of `image` (range, beam)."""
        return self.along @ image @ self.across.T


def measured_mean(
    sampling: Sampling, image: Float[Array | np.ndarray, "range beam"], mask: Float[Array | np.ndarray, "range beam"]
) -> Any:
    """The blurred image (row, column), averaged over measured pixels only; 0 where there are none nearby.

    `mask` (range, beam) is 1 where a pixel of `image` (range, beam) was measured, else 0.
    """
    return sampling(image * mask) / jnp.maximum(sampling(mask), 1e-6)


ROWS, COLUMNS = 4, 2
"""Distance between compared pixels, in range bins and in beams."""


def make_sampling(shape: tuple[int, int], blur: float) -> Sampling:
    """The sampling of frames of `shape` (range, beam) with a Gaussian blur of `blur` [range bins]."""

    def kernel(size: int, every: int, sigma: float) -> np.ndarray:
        at = np.arange(every // 2, size, every)
        weights = np.exp(-0.5 * ((at[:, None] - np.arange(size)) / sigma) ** 2)
        return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)

    return Sampling(kernel(shape[0], ROWS, blur), kernel(shape[1], COLUMNS, max(BEAMS_PER_BIN * blur, 0.8)))


UNEVEN_STD = 0.02
"""Standard deviation of the prior of each slow change of brightness over a frame [of the grey scale]."""


@full_precision
def fitted(
    drawn: Float[Array, "row column"], seen: Float[Array, "row column"], weight: Float[Array, "row column"]
) -> Float[Array, "row column"]:
    """Fit the picture to a frame by an offset, a factor and slow changes of brightness, by least squares.

    All are (row, column); `weight` is that of a squared difference. The result is linear in these few numbers, so they
    need no iterations of their own, and the derivative passes through them (variable projection, Golub and Pereyra,
    SIAM J. Numer. Anal. 10, 1973).
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
