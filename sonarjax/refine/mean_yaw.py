"""The mean yaw: the mean over all poses near the best fit, each weighted by its likelihood.

In a noisy frame the NCC is rough near its maximum, and the yaw of the highest score is often that of a chance peak. The
mean over the poses that fit nearly as well is closer to the truth: it is the estimate with the least squared error if
the weights are right (the posterior mean, e.g. Kay, Fundamentals of Statistical Signal Processing I, §10).

If the noise of `n` independent pixels is normal and its size unknown, the likelihood of a template whose correlation
with the frame is r, maximised over brightness, contrast and noise, is (1 − r²)^(−n/2).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sonarjax.engine import Engine
from sonarjax.exact import full_precision
from sonarjax.refine.config import RefineConfig
from sonarjax.refine.free import BOUNCES
from sonarjax.refine.objective import ROW_STRIDE, SMALL, box_around, levelled, make_blur, normalised
from sonarjax.refine.template import Drawn, Subject, draw, nominal_law
from sonarjax.render import RenderQuality, Window, WindowSize
from sonarjax.render.region import MARGIN_BEAMS, MARGIN_BINS
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

INDEPENDENT = 300.0
"""How many pixels count as independent. It is far below the number of pixels, because neighbours share speckle and what
the template lacks. Chosen on validation frames; experiments/fit_mean_yaw.py measures it on others."""
TURNS = np.radians(np.linspace(-3.2, 3.2, 5)).astype(np.float32)
"""Yaws from the best fit at which the object is rendered [rad]."""
SHIFTS = np.stack([np.linspace(-1.0, 1.0, 5), np.linspace(-0.8, 0.8, 5)], axis=-1).astype(np.float32)
"""Shifts (shift, 2) of each of these templates along range [range bins] and along azimuth [beams]; each of the first is
combined with each of the second."""


def mean_yaw(
    image: np.ndarray, mask: np.ndarray | None, mesh: Mesh, sonar: Sonar, pose: Pose, drawn: Drawn,
    config: RefineConfig, size: WindowSize, engine: Engine,
) -> float:  # fmt: skip
    """Compute the mean yaw over the poses near a refined one.

    Args:
        image: The frame (range, beam).
        mask: True where a pixel was measured (range, beam); None means everywhere.
        mesh: The object.
        sonar: The sonar.
        pose: The refined pose [m, rad].
        drawn: The templates there.
        config: How it was refined.
        size: Size of the window in which it was refined.
        engine: Runs the compiled functions.

    Returns:
        The yaw [rad]. It is the refined one if nothing can be compared.
    """
    return float(pose.yaw) + mean_turn(scores_near(image, mask, mesh, sonar, pose, drawn, config, size, engine))


def mean_turn(scores: Float[np.ndarray, "turn bin beam"], independent: float = INDEPENDENT) -> float:
    """The mean of `TURNS` [rad], weighted by the likelihoods of the `scores` [NCC] and summed over the shifts.

    `independent` is the number n of independent pixels; with 0 the mean is that of the turns, which is 0.
    """
    log = -independent / 2 * np.log(np.maximum(1 - np.maximum(scores, 0.0) ** 2, SMALL))
    weights = np.exp(log - log.max()).sum(axis=(1, 2))
    return float((weights * TURNS).sum() / weights.sum())


def scores_near(
    image: np.ndarray, mask: np.ndarray | None, mesh: Mesh, sonar: Sonar, pose: Pose, drawn: Drawn,
    config: RefineConfig, size: WindowSize, engine: Engine,
) -> Float[np.ndarray, "turn bin beam"]:  # fmt: skip
    """NCC of the frame and the template at all `TURNS` and `SHIFTS` from a refined pose; arguments as `mean_yaw`.

    All are over the same pixels: the box of the refined template with the bank's margin.
    """
    weights = np.ones(image.shape, np.float32) if mask is None else mask.astype(np.float32)
    known = image if mask is None else levelled(image, weights, np)
    seen, measured = (drawn.part(v) for v in (np.asarray(known, np.float32), weights))

    def turned(turn: Any) -> np.ndarray:
        numbers, static = _how(config, size)
        return np.asarray(
            engine.run(shifted_scores, seen, measured, mesh, sonar, pose, drawn, turn, *numbers, **static)
        )

    return np.stack(engine.map(turned, TURNS))


def prepare_mean_yaw(mesh: Mesh, sonar: Sonar, config: RefineConfig, size: WindowSize, engine: Engine) -> None:
    """Let an engine compile what `mean_yaw` runs, before there is a frame.

    Args:
        mesh: The object.
        sonar: The sonar.
        config: How poses will be refined on the frame.
        size: Size of the window in which they will be refined.
        engine: Compiles, and later runs the compiled functions.
    """
    dark = np.zeros(size.shape, np.float32)
    template, first, bounces = jax.device_put((dark, np.int32(0), np.zeros(len(BOUNCES), np.float32)))
    drawn = Drawn(template, template, first, first, first, nominal_law(), bounces)
    numbers, static = _how(config, size)
    engine.prepare(shifted_scores, dark, dark, mesh, sonar, Pose(), drawn, TURNS[0], *numbers, **static)


def _how(config: RefineConfig, size: WindowSize) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Blur and sharpness of a config, and what decides the compiled code."""
    return (np.float32(config.blurs[-1]), np.float32(config.sharpness)), {"size": size, "quality": config.quality}


@partial(jax.jit, static_argnames=("size", "quality"))
@full_precision
def shifted_scores(
    image: Array, measured: Array, mesh: Mesh, sonar: Sonar, pose: Pose, drawn: Drawn, turn: Array, sigma: Array,
    sharpness: Array, *, size: WindowSize, quality: RenderQuality,
) -> Float[Array, "bin beam"]:  # fmt: skip
    """NCC of the image, a window of the frame, with the template turned by `turn` [rad] from `pose`, at all shifts.

    Both are blurred by `sigma` [range bins], as while the pose was refined.
    """
    window = Window(drawn.row, drawn.column, size.shape, size.object_columns)
    subject = Subject(mesh, sonar, pose, window, sharpness, drawn.views, drawn.law, quality)
    template = draw(subject, jnp.concatenate([jnp.stack([turn, 0.0, 0.0]), drawn.bounces]))
    weight = measured * box_around(drawn.template, (MARGIN_BINS, MARGIN_BEAMS))
    rows = weight[::ROW_STRIDE]
    seen = normalised(make_blur(size.shape, sigma)(image * weight), rows)
    blurs = jax.vmap(lambda shift: make_blur(size.shape, sigma, shift))(jnp.asarray(SHIFTS))
    moved = jnp.einsum("krx,xb,lcb->klrc", blurs.along, template * weight, blurs.across)
    return jax.vmap(jax.vmap(lambda one: (normalised(one, rows) * seen).sum()))(moved)
