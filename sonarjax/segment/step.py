"""One step of training as pure jitted functions of a `GanState`: pix2pix, or cross-entropy with the same U-Net.

A step is two compiled functions, which XLA compiles faster than one. The first computes the gradients: the generated
maps, the discriminator's update and the generator's gradient. The second updates the generator. Every mean runs over
the complete batch, so a batch that is sharded over devices gives the same step as on one device.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, UInt8

from sonarjax.records import record, static
from sonarjax.segment.discriminator import Discriminator
from sonarjax.segment.generator import Generator, Head, to_grey
from sonarjax.segment.initial import draw_variables
from sonarjax.segment.inputs import Inputs
from sonarjax.segment.layers import Backend
from sonarjax.segment.loss import (
    Normaliser,
    adversarial_loss,
    cross_entropy,
    discriminator_loss,
    distance_loss,
    labels_of,
)

Losses = dict[str, Float[Array, ""]]


@dataclass(frozen=True)
class GanConfig:
    """The networks and how they are trained. Hashable, so that it can be a static argument under `jax.jit`."""

    width: int = 64
    """Channels of the generator's first layer."""
    discriminator_width: int = 64
    """Channels of the discriminator's first layer."""
    multipliers: tuple[int, ...] = (1, 2, 4, 8, 8, 8, 8)
    """Channels of the generator's seven layers on the way down, as multiples of `width`."""
    head: Head = "tanh"
    """The generator's output: `tanh` for grey, or `classes` for the logits of three classes."""
    skips: bool = True
    """Whether the generator has skip connections."""
    inputs: Inputs = "grey"
    """What the generator is given of an image: the `grey` itself, or `ranks`, which no display law changes."""
    dtype: Literal["float32", "bfloat16"] = "float32"
    """Type of the maps: `float32`, or `bfloat16` for GPUs."""
    backend: Backend = "auto"
    """How the layers are computed, see `layers`."""
    learning_rate: float = 2e-4
    """Adam's step size."""
    decay_steps: int = 0
    """Steps over which the step size falls to 0 along half a cosine; 0 keeps it constant."""
    beta1: float = 0.5
    """Adam's decay of the mean gradient."""
    beta2: float = 0.999
    """Adam's decay of the mean square."""
    distance: float = 100.0
    """λ of eq. 3. The paper gives no number. The affine N halves differences, so 100 acts as 50 does in pix2pix."""
    normaliser: Normaliser = "affine"
    """N of eq. 3."""
    saturating: bool = False
    """If true, the generator minimises E[log(1 − D)] as printed in eq. 3, otherwise −E[log D]."""
    adversarial: float = 1.0
    """Weight of the adversarial loss in the generator's loss."""
    cross_entropy: float = 0.0
    """Weight of cross-entropy in the generator's loss, in addition to eq. 3; needs the head `classes`.

    With the head `tanh` cross-entropy would be 0 for any map, so `Recipe.checked` refuses it.
    """
    class_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Weights of background, highlight and shadow in cross-entropy."""
    ema_decay: float = 0.999
    """Decay of the averaged generator, which is the one used for inference; the first steps average over fewer."""

    def generator(self) -> Generator:
        """The generator's module."""
        return Generator(
            self.width, self.head, self.skips, self.multipliers, jnp.dtype(self.dtype), self.backend, self.inputs
        )

    def discriminator(self) -> Discriminator:
        """The discriminator's module."""
        return Discriminator(self.discriminator_width, jnp.dtype(self.dtype), self.backend)

    def optimiser(self) -> optax.GradientTransformation:
        """Adam, the same for both networks."""
        rate: float | optax.Schedule = self.learning_rate
        if self.decay_steps:
            rate = optax.cosine_decay_schedule(self.learning_rate, self.decay_steps)
        return optax.adam(rate, self.beta1, self.beta2)


@record
class GanState:
    """Everything that training carries from one step to the next; a pytree with static `config`."""

    step: Any
    """Number of steps done ()."""
    generator: Any
    """Parameters of the generator."""
    batch_stats: Any
    """Running statistics of the generator."""
    discriminator: Any
    """Parameters of the discriminator."""
    generator_optimiser: Any
    """Adam's state for the generator."""
    discriminator_optimiser: Any
    """Adam's state for the discriminator."""
    ema: Any
    """Exponential moving average of `generator`."""
    ema_stats: Any
    """The same average of `batch_stats`: the statistics that belong to `ema`, less noisy than the latest."""
    config: GanConfig = static()
    """How the networks are trained."""

    def weights(self) -> dict[str, Any]:
        """Variables of the averaged generator, as `Generator.apply` takes them for inference."""
        return {"params": self.ema, "batch_stats": self.ema_stats}


@partial(jax.jit, static_argnames="config")
def create_state(config: GanConfig, *, key: Array) -> GanState:
    """New networks, drawn from `key`, and their optimisers."""
    first, second = jax.random.split(key)
    image = jnp.zeros((1, 128, 128, 1))
    variables = draw_variables(config.generator(), image, key=first)
    discriminator = draw_variables(config.discriminator(), image, image, key=second)["params"]
    adam = config.optimiser()
    return GanState(
        step=jnp.zeros((), jnp.int32),
        generator=variables["params"],
        batch_stats=variables["batch_stats"],
        discriminator=discriminator,
        generator_optimiser=adam.init(variables["params"]),
        discriminator_optimiser=adam.init(discriminator),
        ema=jax.tree.map(jnp.copy, variables["params"]),
        ema_stats=jax.tree.map(jnp.copy, variables["batch_stats"]),
        config=config,
    )


def with_generator(state: GanState, variables: Any) -> GanState:
    """The state before the first step, with a generator that was trained before, which the average begins with too.

    Args:
        state: A new state.
        variables: The generator's variables, as `GanState.weights` returns them.

    Returns:
        The state; it shares no memory with `variables`, since a step donates its state.
    """
    (params, stats), (ema, ema_stats) = (
        (jax.tree.map(jnp.copy, variables["params"]), jax.tree.map(jnp.copy, variables["batch_stats"]))
        for _ in range(2)
    )
    return replace(state, generator=params, batch_stats=stats, ema=ema, ema_stats=ema_stats)


@record
class Gradients:
    """The result of the first half of a step, before the generator is updated; a pytree."""

    gradient: Any
    """Gradient of the generator's loss by its parameters."""
    batch_stats: Any
    """The generator's updated running statistics."""
    discriminator: Any
    """The updated parameters of the discriminator."""
    discriminator_optimiser: Any
    """The updated state of its optimiser."""
    losses: Losses
    """Losses by name."""


def train_step(
    state: GanState,
    x: Float[Array, "batch height width 1"],
    y: Float[Array, "batch height width 1"],
    *,
    key: Array,
) -> tuple[GanState, Losses]:
    """One training step of both networks.

    Args:
        state: The state before the step; it is donated.
        x: Images (batch, height, width, 1) in [−1, 1].
        y: Their semantic maps (batch, height, width, 1) in [−1, 1].
        key: Draws the dropout.

    Returns:
        The state after the step, and the losses by name, as in `pix2pix_gradients`.
    """
    gradients = pix2pix_gradients(state, x, y, key=key)
    return update(state, gradients), gradients.losses


def discriminative_step(
    state: GanState,
    x: Float[Array, "batch height width 1"],
    labels: UInt8[Array, "batch height width"],
    *,
    key: Array,
) -> tuple[GanState, Losses]:
    """One training step of the paper's 'discriminative model': the U-Net alone, on class-weighted cross-entropy.

    Args:
        state: The state before the step, with the head `classes`; it is donated.
        x: Images (batch, height, width, 1) in [−1, 1].
        labels: Their labels (batch, height, width).
        key: Draws the dropout.

    Returns:
        The state after the step, and the loss `cross_entropy`.
    """
    gradients = discriminative_gradients(state, x, labels, key=key)
    return update(state, gradients), gradients.losses


@jax.jit
def pix2pix_gradients(
    state: GanState,
    x: Float[Array, "batch height width 1"],
    y: Float[Array, "batch height width 1"],
    *,
    key: Array,
) -> Gradients:
    """The gradients of pix2pix. Arguments as in `train_step`, images and maps (batch, height, width, 1).

    The generator runs once, with dropout drawn from `key`, and both networks use its maps: first the discriminator is
    updated, then the generator's gradient is taken against the updated one. The losses are `distance`, `discriminator`
    and `adversarial` unless the adversarial loss has no weight, in which case the discriminator stays as it is, and
    `cross_entropy` if it has a weight.
    """
    config = state.config
    generate = partial(_generate, config, state.batch_stats, x, key)
    output, pull_back, batch_stats = jax.vjp(generate, state.generator, has_aux=True)
    made, grey_pull_back = jax.vjp(to_grey, output)
    discriminate = partial(_discriminate, config, x)

    def loss_of_discriminator(params: Any) -> Array:
        return discriminator_loss(discriminate(y, params), discriminate(made, params))

    lost: Losses = {}
    discriminator, discriminator_optimiser = state.discriminator, state.discriminator_optimiser
    if config.adversarial:
        lost["discriminator"], to_lower = jax.value_and_grad(loss_of_discriminator)(discriminator)
        discriminator, discriminator_optimiser = _adam(config, to_lower, discriminator_optimiser, discriminator)

    def answer(grey: Array) -> tuple[Array, Losses]:
        parts = {"distance": distance_loss(x, y, grey, config.normaliser)}
        total = config.distance * parts["distance"]
        if config.adversarial:
            parts["adversarial"] = adversarial_loss(discriminate(grey, discriminator), config.saturating)
            total = total + config.adversarial * parts["adversarial"]
        return total, parts

    cotangent, losses = jax.grad(answer, has_aux=True)(made)
    (at_output,) = grey_pull_back(cotangent)
    if config.cross_entropy:
        entropy, more = jax.value_and_grad(cross_entropy)(output, labels_of(y), config.class_weights)
        at_output = at_output + config.cross_entropy * more
        losses["cross_entropy"] = entropy
    (gradient,) = pull_back(at_output)
    return Gradients(gradient, batch_stats, discriminator, discriminator_optimiser, lost | losses)


@jax.jit
def discriminative_gradients(
    state: GanState,
    x: Float[Array, "batch height width 1"],
    labels: UInt8[Array, "batch height width"],
    *,
    key: Array,
) -> Gradients:
    """The gradients of the discriminative model; the discriminator stays as it is.

    Arguments as in `discriminative_step`: images (batch, height, width, 1) and labels (batch, height, width). The loss
    is `cross_entropy`.
    """
    config = state.config

    def loss(params: Any) -> tuple[Array, Any]:
        output, batch_stats = _generate(config, state.batch_stats, x, key, params)
        return cross_entropy(output, labels, config.class_weights), batch_stats

    (lost, batch_stats), gradient = jax.value_and_grad(loss, has_aux=True)(state.generator)
    return Gradients(gradient, batch_stats, state.discriminator, state.discriminator_optimiser, {"cross_entropy": lost})


def update(state: GanState, gradients: Gradients) -> GanState:
    """The state after a step: takes over the updated discriminator, and updates the generator by Adam. `state`
    is donated.
    """
    updated = replace(
        state, discriminator=gradients.discriminator, discriminator_optimiser=gradients.discriminator_optimiser
    )
    return _update_generator(updated, gradients.gradient, gradients.batch_stats)


def _generate(config: GanConfig, batch_stats: Any, x: Array, key: Array, params: Any) -> tuple[Array, Any]:
    output, changed = config.generator().apply(
        {"params": params, "batch_stats": batch_stats}, x, train=True, rngs={"dropout": key}, mutable="batch_stats"
    )
    return output, changed["batch_stats"]


def _discriminate(config: GanConfig, x: Array, y: Array, params: Any) -> Array:
    # Running statistics are of no use: the discriminator only ever sees whole batches.
    logits, _ = config.discriminator().apply({"params": params}, x, y, mutable="batch_stats")
    return jnp.asarray(logits)


@partial(jax.jit, donate_argnums=0)
def _update_generator(state: GanState, gradient: Any, batch_stats: Any) -> GanState:
    config = state.config
    params, optimiser = _adam(config, gradient, state.generator_optimiser, state.generator)
    # After few steps, a plain mean is better than an average that still contains the initial weights.
    decay = jnp.minimum(config.ema_decay, (1 + state.step) / (10 + state.step))

    def average(old: Any, new: Any) -> Any:
        return jax.tree.map(lambda a, b: b + decay * (a - b), old, new)

    return replace(
        state,
        step=state.step + 1,
        generator=params,
        batch_stats=batch_stats,
        generator_optimiser=optimiser,
        ema=average(state.ema, params),
        ema_stats=average(state.ema_stats, batch_stats),
    )


def _adam(config: GanConfig, gradient: Any, optimiser: Any, params: Any) -> tuple[Any, Any]:
    updates, optimiser = config.optimiser().update(gradient, optimiser, params)
    return optax.apply_updates(params, updates), optimiser
