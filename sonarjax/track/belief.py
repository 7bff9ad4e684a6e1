"""The belief over an object's pose and rate: a mixture of Gaussians with circular yaw, and its update by one frame.

Each Gaussian follows one way to explain the frames: which hypothesis of each frame was right, or none (Reid, An
Algorithm for Tracking Multiple Targets, IEEE Trans. Automatic Control 24, 1979). Within one explanation this is a
Kalman filter. Besides yaw, x, y and rate, its state holds the errors that all frames of one view share, so that a
hundred similar frames do not reduce the variance to a hundredth (Schmidt, Application of State-Space Methods to
Navigation Problems, 1966, has biases as states). Everything is pure, and works under `jax.jit`, `jax.vmap` and
`jax.lax.scan`.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.exact import check_single_precision, full_precision
from sonarjax.records import record
from sonarjax.track.motion import Motion, TrackConfig, Turning
from sonarjax.track.reduce import Mixture, reduced, signed

STATES = 7
"""Number of states of a Gaussian: yaw [rad], x, y [m], rate [rad/frame], and the shared errors of yaw, x, y."""
YAW, X, Y, RATE = range(4)
SHARED = slice(4, 7)
UNKNOWN_YAW = math.pi**2 / 3
"""Variance of a yaw of which nothing is known [rad²]."""


@record
class Belief:
    """What is known after a frame, in the common frame. The first component means 'anywhere' and has no Gaussian."""

    log_weight: Float[Array, "*batch component"]
    """Logarithm of each component's probability; -inf for an unused place."""
    mean: Float[Array, "*batch component 7"]
    """Means: yaw [rad], x, y [m], rate [rad/frame], and the errors of yaw, x, y that all frames of a view share."""
    covariance: Float[Array, "*batch component 7 7"]
    """Covariances of these numbers."""
    parent: Int[Array, "*batch component"]
    """Number of the component of the previous belief that each one continues."""
    gain: Float[Array, "*batch component"]
    """Log-likelihood that this frame added to each component, up to a constant of the frame."""
    sonar: Float[Array, "*batch 3"]
    """Pose of the sonar: x, y [m] and yaw [rad]."""
    elapsed: Float[Array, "*batch"]
    """Time since the previous frame [frames]."""
    fading: Float[Array, "*batch"]
    """Factor that this frame put on the earlier log-weights [1]; 1 if the frame said nothing."""


@record
class Measurement:
    """What a recognizer found in one frame, in the sonar's frame. Unused places for hypotheses have weight -inf."""

    log_weight: Float[Array, "*batch hypothesis"]
    """Logarithm of the probability that this is the right hypothesis."""
    log_miss: Float[Array, "*batch"]
    """Logarithm of the probability that no hypothesis is right."""
    pose: Float[Array, "*batch hypothesis 3"]
    """Yaw [rad], x and y [m]."""
    std: Float[Array, "*batch hypothesis 3"]
    """Standard deviations of the errors that differ from frame to frame, in the same units."""
    sonar: Float[Array, "*batch 3"]
    """Pose of the sonar in the common frame: x, y [m] and yaw [rad]."""
    elapsed: Float[Array, "*batch"]
    """Time since the previous frame [frames]."""


@record
class Numbers:
    """Motion and config as traced numbers, so that all motions share compiled code."""

    rate_std: Float[Array, "*batch"]
    """As in `Turning` [rad/frame]; 0 for an object at rest."""
    rate_drift: Float[Array, "*batch"]
    """As in `Turning` [rad/frame]."""
    yaw_drift: Float[Array, "*batch"]
    """As in both motions [rad]."""
    place_drift: Float[Array, "*batch"]
    """As in both motions [m]."""
    floor: Float[Array, "*batch"]
    """As in `TrackConfig` [rad]."""
    place_floor: Float[Array, "*batch"]
    """As in `TrackConfig` [m]."""
    aspect: Float[Array, "*batch"]
    """As in `TrackConfig` [rad]."""
    fading: Float[Array, "*batch"]
    """Factor on a log-weight for each frame [1]."""
    merge: Float[Array, "*batch"]
    """As in `TrackConfig` [1]."""
    alias: Float[Array, "*batch"]
    """As in `TrackConfig` [1]."""
    log_volume: Float[Array, "*batch"]
    """Logarithm of 2π times the area of floor over which wrong hypotheses lie [rad m²]."""


def numbers_of(motion: Motion, config: TrackConfig) -> Numbers:
    """Collect the numbers of a motion and a config; evidence fades by exp(-1 / memory) with each frame.

    Args:
        motion: How the object may move between frames.
        config: How frames are weighted.

    Returns:
        The numbers, without batch axes.
    """
    rates = (motion.rate_std, motion.rate_drift) if isinstance(motion, Turning) else (0.0, 0.0)
    values = (
        *rates, motion.yaw_drift, motion.place_drift, config.floor, config.place_floor, config.aspect,
        math.exp(-1 / config.memory), config.merge, config.alias, math.log(2 * math.pi * config.area),
    )  # fmt: skip
    return Numbers(*(jnp.float32(v) for v in values))


def nothing_known(config: TrackConfig) -> Belief:
    """Make the belief before the first frame: the object may be anywhere.

    Args:
        config: Its `components` is the number of Gaussians.

    Returns:
        The belief (component,), in which only the component 'anywhere' has a weight.
    """
    count = config.components
    weight = np.full(count, -np.inf, np.float32)
    weight[0] = 0.0
    covariance = np.broadcast_to(np.eye(STATES, dtype=np.float32), (count, STATES, STATES))
    return Belief(
        log_weight=jnp.asarray(weight),
        mean=jnp.zeros((count, STATES)),
        covariance=jnp.asarray(covariance),
        parent=jnp.zeros(count, jnp.int32),
        gain=jnp.zeros(count),
        sonar=jnp.zeros(3),
        elapsed=jnp.zeros(()),
        fading=jnp.ones(()),
    )


def step(belief: Belief, measurement: Measurement, numbers: Numbers) -> Belief:
    """Update a belief by one more frame.

    It is predicted over the time since the previous frame, to the sonar's present pose; then the measurement is
    applied. The yaw of every component stays in [0, 2π). If all hypotheses of `measurement` have weight -inf, the
    belief is only predicted.

    Args:
        belief: The belief after the previous frame (component,).
        measurement: What was found in this frame (hypothesis,).
        numbers: The numbers of motion and config, from `numbers_of`.

    Returns:
        The belief after this frame (component,).

    Raises:
        SonarjaxError: JAX is in its 64-bit mode.
    """
    check_single_precision()
    expected = predicted(belief, measurement.sonar, measurement.elapsed, numbers)
    mean, covariance = expected.mean, expected.covariance
    fading = jnp.where(jnp.isfinite(measurement.log_weight).any(), numbers.fading, 1.0)
    before = fading * belief.log_weight
    before = before - jax.scipy.special.logsumexp(before)
    many, count = len(before), measurement.log_weight.shape[0]
    fits = jax.vmap(
        lambda m, p: jax.vmap(lambda h, s: _kalman(m, p, h, s, measurement.sonar))(measurement.pose, measurement.std)
    )
    likelihood, new_mean, new_covariance = fits(mean, covariance)
    # Wrong hypotheses lie anywhere. All likelihoods are relative to their density, 1 / (2π area).
    real = slice(1, None)  # all components but 'anywhere'
    density = likelihood + numbers.log_volume
    hit = before[:, None] + measurement.log_weight + density
    missed = before + measurement.log_miss + _alike(density[real], before[real], measurement, numbers)
    born = before[0] + measurement.log_weight
    start_mean, start_covariance = jax.vmap(lambda h, s: _first(h, s, measurement.sonar, numbers))(
        measurement.pose, measurement.std
    )
    numbers_of_parents = jnp.arange(many)
    parts = [
        Mixture(
            hit[real].reshape(-1),
            new_mean[real].reshape(-1, STATES),
            new_covariance[real].reshape(-1, STATES, STATES),
            jnp.repeat(numbers_of_parents[real], count),
        ),
        Mixture(missed[real], mean[real], covariance[real], numbers_of_parents[real]),
        Mixture(born, start_mean, start_covariance, jnp.zeros(count, numbers_of_parents.dtype)),
    ]
    candidates = jax.tree.map(lambda *v: jnp.concatenate(v), *parts)
    kept = reduced(candidates, many - 1, numbers.merge)
    anywhere = Mixture(missed[:1], belief.mean[:1], belief.covariance[:1], numbers_of_parents[:1])
    joined = jax.tree.map(lambda *v: jnp.concatenate(v), anywhere, kept)
    gain = joined.log_weight - before[joined.parent]
    return Belief(
        log_weight=joined.log_weight - jax.scipy.special.logsumexp(joined.log_weight),
        mean=joined.mean.at[:, YAW].set(joined.mean[:, YAW] % (2 * jnp.pi)),
        covariance=joined.covariance,
        parent=joined.parent.astype(jnp.int32),
        gain=jnp.where(jnp.isfinite(gain), gain, -jnp.inf),
        sonar=measurement.sonar,
        elapsed=measurement.elapsed,
        fading=fading,
    )


def _alike(density: Array, log_weight: Array, measurement: Measurement, numbers: Numbers) -> Array:
    """Log-likelihood of a frame's hypotheses if none is right, relative to their lying anywhere.

    Some wrong hypotheses lie where earlier wrong ones did: at other yaws at which the object looks much the same. If
    all were assumed to lie anywhere, two such hypotheses in a row would outweigh any belief.
    """
    known = jnp.where(jnp.isfinite(log_weight)[:, None], density, -jnp.inf)
    nearest = known.max(axis=0) + measurement.log_weight
    total = jax.scipy.special.logsumexp(measurement.log_weight)
    some = jnp.isfinite(total)
    again = jnp.where(some, jax.scipy.special.logsumexp(nearest) - jnp.where(some, total, 0.0), 0.0)
    return jnp.logaddexp(jnp.log1p(-numbers.alias), jnp.log(numbers.alias) + again)


@record
class Prediction:
    """A belief at the time of the next frame, before that frame is used, and how its states follow from the earlier."""

    mean: Float[Array, "*batch component 7"]
    """Means, as in `Belief`."""
    covariance: Float[Array, "*batch component 7 7"]
    """Their covariances."""
    cross: Float[Array, "*batch component 7 7"]
    """Covariances of the earlier states (first axis) with the predicted ones."""
    transition: Float[Array, "*batch component 7 7"]
    """Matrix by which the predicted mean follows from the earlier one."""
    noise: Float[Array, "*batch component 7 7"]
    """Covariance that the time since the earlier frame adds, before that of yaw is limited."""


@full_precision
def predicted(belief: Belief, sonar: Float[Array, "3"], elapsed: Float[Array, ""], numbers: Numbers) -> Prediction:
    """Predict a belief (component,) for a sonar at `sonar` (x, y [m], yaw [rad]), `elapsed` [frames] later."""

    def one(mean: Array, covariance: Array) -> tuple[Array, ...]:
        old, new = (jnp.arctan2(mean[Y] - s[1], mean[X] - s[0]) for s in (belief.sonar, sonar))
        changed = mean[RATE] * elapsed - signed(new - old)
        # Uncertainty about the rate adds to the change of aspect.
        aspect = jnp.sqrt(changed**2 + covariance[RATE, RATE] * elapsed**2)
        alike = jnp.exp(-aspect / numbers.aspect)
        transition = jnp.eye(STATES).at[YAW, RATE].set(elapsed).at[4, 4].set(alike)
        anew = (1 - alike**2) * numbers.floor**2
        noise = _drift(elapsed, numbers).at[4, 4].set(anew)
        cross = covariance @ transition.T
        spread, kept = with_limited_yaw(transition @ cross + noise)
        return transition @ mean, spread, cross.at[:, YAW].mul(kept), transition, noise

    return Prediction(*jax.vmap(one)(belief.mean, belief.covariance))


def _drift(elapsed: Array, numbers: Numbers) -> Float[Array, "7 7"]:
    """Covariance that the motion adds in `elapsed` [frames], without that of the shared errors.

    The rate is a random walk from frame to frame, and each of its steps turns yaw in all later frames. So a gap of n
    frames adds as much as n frames that say nothing: sums of 1 to n - 1, and of their squares. Within one frame the
    rate has no later frame to act on.
    """
    stds = numbers.yaw_drift, numbers.place_drift, numbers.place_drift, numbers.rate_drift
    own = jnp.diag(jnp.stack([*(v**2 * elapsed for v in stds), *jnp.zeros(3)]))
    frames = jnp.maximum(elapsed, 1.0)
    walk = numbers.rate_drift**2 * frames * (frames - 1)
    turned = own.at[YAW, YAW].add(walk * (2 * frames - 1) / 6)
    return turned.at[YAW, RATE].set(walk / 2).at[RATE, YAW].set(walk / 2)


def with_limited_yaw(covariance: Float[Array, "7 7"]) -> tuple[Float[Array, "7 7"], Float[Array, ""]]:
    """Limit the variance of yaw to that of a yaw of which nothing is known, π²/3.

    A yaw that may have turned several times around is as good as unknown, and says next to nothing about the rate. Its
    covariances with the other states therefore fall by the same factor as its variance.

    Args:
        covariance: Covariance of the states (7, 7).

    Returns:
        The covariance (7, 7), still positive, and the factor [1]; 1 if the standard deviation of yaw is at most π/√3.
    """
    kept = jnp.minimum(1.0, UNKNOWN_YAW / jnp.maximum(covariance[YAW, YAW], UNKNOWN_YAW))
    variance = kept * covariance[YAW, YAW]
    return covariance.at[YAW].mul(kept).at[:, YAW].mul(kept).at[YAW, YAW].set(variance), kept


def _observation(sonar: Float[Array, "3"]) -> Float[Array, "3 7"]:
    """Matrix from a state to what a hypothesis (yaw, x, y), rotated into the common frame, observes: pose and
    shared errors.
    """
    turn = jnp.eye(3).at[1:, 1:].set(_rotation(sonar[2]))
    return jnp.zeros((3, STATES)).at[:, :3].set(jnp.eye(3)).at[:, SHARED].set(turn)


def _rotation(angle: Array) -> Float[Array, "2 2"]:
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


@full_precision
def to_common(pose: Float[Array, "3"], sonar: Float[Array, "3"]) -> Float[Array, "3"]:
    """Transform a pose (yaw [rad], x, y [m]) from the frame of a sonar, which is at `sonar` (x, y, yaw), to the common
    frame.
    """
    place = sonar[:2] + _rotation(sonar[2]) @ pose[1:]
    return jnp.concatenate([(pose[:1] + sonar[2]), place])


@full_precision
def _kalman(mean: Array, covariance: Array, pose: Array, std: Array, sonar: Array) -> tuple[Array, Array, Array]:
    """Log-likelihood of a hypothesis, and the mean and covariance that it updates."""
    seen = _observation(sonar)
    gap = to_common(pose, sonar) - seen @ mean
    gap = gap.at[YAW].set(signed(gap[YAW]))
    noise = jnp.diag(std**2)  # the same for x and y, so rotating it into the common frame changes nothing
    spread = seen @ covariance @ seen.T + noise
    gain = jnp.linalg.solve(spread, seen @ covariance).T
    rest = jnp.eye(STATES) - gain @ seen
    new = rest @ covariance @ rest.T + gain @ noise @ gain.T  # Joseph's form stays positive in float32
    fit = gap @ jnp.linalg.solve(spread, gap)
    likelihood = -0.5 * (fit + jnp.linalg.slogdet(2 * jnp.pi * spread)[1])
    return likelihood, mean + gain @ gap, (new + new.T) / 2


def _first(pose: Array, std: Array, sonar: Array, numbers: Numbers) -> tuple[Array, Array]:
    """Mean and covariance of an object about which nothing was known, given the right hypothesis."""
    shared = jnp.stack([numbers.floor, numbers.place_floor, numbers.place_floor]) ** 2
    turn = _observation(sonar)[:, SHARED]
    across = -turn * shared
    rate = jnp.zeros((STATES, STATES)).at[RATE, RATE].set(numbers.rate_std**2)
    covariance = rate.at[:3, :3].set(jnp.diag(std**2 + shared)).at[:3, SHARED].set(across)
    covariance = covariance.at[SHARED, :3].set(across.T).at[SHARED, SHARED].set(jnp.diag(shared))
    return jnp.zeros(STATES).at[:3].set(to_common(pose, sonar)), covariance


@jax.jit
def run_filter(belief: Belief, measurements: Measurement, numbers: Numbers) -> Belief:
    """Update a belief by a sequence of frames, one step for each.

    Args:
        belief: The belief before the first frame (component,).
        measurements: What was found in each frame (frame, hypothesis).
        numbers: The numbers of motion and config, from `numbers_of`.

    Returns:
        The beliefs after each frame (frame, component).

    Raises:
        SonarjaxError: JAX is in its 64-bit mode.
    """

    def one(before: Belief, measurement: Measurement) -> tuple[Belief, Belief]:
        after = step(before, measurement, numbers)
        return after, after

    return jax.lax.scan(one, belief, measurements)[1]


next_belief = jax.jit(step)
"""`step`, compiled."""
