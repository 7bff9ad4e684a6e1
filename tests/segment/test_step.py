"""A training step against the same step in PyTorch (autograd and `torch.optim.Adam`); state, losses and options."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import linen as nn

from sonarjax.segment.loss import labels_of
from sonarjax.segment.step import (
    GanConfig,
    GanState,
    create_state,
    discriminative_step,
    pix2pix_gradients,
    train_step,
    update,
)

PRODUCTS = GanConfig(width=2, discriminator_width=2, multipliers=(1, 2, 2, 2, 2, 2, 2))
# The layers have their own tests; XLA compiles a step of convolutions several times faster than one of products.
CONFIG = replace(PRODUCTS, backend="convolution", width=4, learning_rate=2e-3)


def batch(rng: np.random.Generator, count: int = 2) -> tuple[jax.Array, jax.Array]:
    """Noisy images of a bright square with a shadow behind it, and their semantic maps, in [−1, 1]."""
    y = np.zeros((count, 128, 128, 1), np.float32)
    for n, (row, column) in enumerate(rng.integers(20, 60, (count, 2))):
        y[n, row : row + 16, column : column + 30] = 1
        y[n, row + 16 : row + 50, column : column + 30] = -1
    x = np.clip(0.5 * y + rng.normal(0, 0.3, y.shape), -1, 1).astype(np.float32)
    return jnp.asarray(x), jnp.asarray(y)


def without_dropout(function: Any, arguments: Any, options: Any, context: Any) -> Any:
    return arguments[0] if isinstance(context.module, nn.Dropout) else function(*arguments, **options)


def torch_step(state: GanState, x: Any, y: Any) -> tuple[Any, Any, list[float]]:
    """One step in PyTorch on ours' weights: parameters of both networks and the losses."""
    import torch
    from torch.nn import functional

    from tests.segment import torch_peer as peer

    g, d = peer.tensors(state.generator), peer.tensors(state.discriminator)
    adams = [torch.optim.Adam(jax.tree.leaves(p), 2e-4, (0.5, 0.999)) for p in (g, d)]
    image, truth = peer.maps(x), peer.maps(y)
    made = peer.generator(g, image).tanh()
    real, fake = peer.discriminator(d, image, truth), peer.discriminator(d, image, made.detach())
    updated = functional.softplus(-real).mean() + functional.softplus(fake).mean()
    updated.backward()
    adams[1].step()
    adversarial = functional.softplus(-peer.discriminator(d, image, made)).mean()
    distance = (made - truth).abs().mean() / 2
    (adversarial + 100 * distance).backward()
    adams[0].step()
    return g, d, [updated.item(), adversarial.item(), distance.item()]


@pytest.mark.slow
def test_step_is_pytorchs(rng: np.random.Generator, key: jax.Array) -> None:
    pytest.importorskip("torch")
    x, y = batch(rng)
    state = create_state(PRODUCTS, key=key)
    state = replace(
        state, **{n: jax.tree.map(lambda v: 3 * v, getattr(state, n)) for n in ("generator", "discriminator")}
    )
    before = jax.tree.map(np.array, state.generator)
    g, d, losses = torch_step(state, x, y)
    with nn.intercept_methods(without_dropout):
        # A function of its own: else the tests that follow would be given this trace of `pix2pix_gradients`.
        gradients = jax.jit(lambda *v: pix2pix_gradients.__wrapped__(*v, key=key))(state, x, y)
    moved, found = update(state, gradients), gradients.losses
    assert [float(found[n]) for n in ("discriminator", "adversarial", "distance")] == pytest.approx(losses, rel=1e-4)
    for ours, theirs in ((moved.generator, g), (moved.discriminator, d)):
        for path, value in jax.tree_util.tree_leaves_with_path(ours):
            there = theirs[path[0].key][path[1].key].detach().numpy()
            # Adam's first step has the gradient's sign alone, so one that is nil but for rounding may go either way.
            assert np.mean(np.abs(value - there) > 2e-5) < 0.01, path
    assert (
        max(np.abs(a - b).max() for a, b in zip(*map(jax.tree.leaves, (before, moved.generator)), strict=True)) > 1e-4
    )


@pytest.mark.parametrize(
    "options",
    [
        {},
        pytest.param(
            {"head": "classes", "normaliser": "per_image", "cross_entropy": 1.0, "saturating": True},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_steps_learn(options: dict[str, Any], rng: np.random.Generator, key: jax.Array) -> None:
    x, y = batch(rng)
    config = replace(CONFIG, **options)
    state = create_state(config, key=key)
    seen = []
    for n in range(12):
        state, losses = train_step(state, x, y, key=jax.random.fold_in(key, n))
        seen.append({name: float(value) for name, value in losses.items()})
    assert np.isfinite([list(v.values()) for v in seen]).all()
    assert seen[-1]["distance"] < 0.9 * seen[0]["distance"]
    assert int(state.step) == 12
    assert set(seen[0]) == {"discriminator", "adversarial", "distance"} | {"cross_entropy" for _ in options if options}


def test_without_adversarial_loss_only_the_generator_is_trained(rng: np.random.Generator, key: jax.Array) -> None:
    x, y = batch(rng)
    kept, hardly = (create_state(replace(CONFIG, adversarial=weight), key=key) for weight in (0.0, 1e-9))
    alone, both = pix2pix_gradients(kept, x, y, key=key), pix2pix_gradients(hardly, x, y, key=key)
    assert set(alone.losses) == {"distance"}
    for path, value in jax.tree.leaves_with_path(alone.gradient):
        there = dict(jax.tree.leaves_with_path(both.gradient))[path]
        np.testing.assert_allclose(value, there, rtol=1e-3, atol=1e-7, err_msg=str(path))
    assert all(
        jax.tree.leaves(jax.tree.map(lambda a, b: bool((a == b).all()), alone.discriminator, kept.discriminator))
    )
    assert not np.array_equal(both.discriminator["down1"]["kernel"], hardly.discriminator["down1"]["kernel"])


def test_step_is_a_function_of_state_batch_and_key(rng: np.random.Generator, key: jax.Array) -> None:
    x, y = batch(rng)
    one, again, other = (train_step(create_state(CONFIG, key=key), x, y, key=jax.random.key(k))[0] for k in (1, 1, 2))
    same = jax.tree.map(lambda a, b: bool((a == b).all()), one, again)
    assert all(jax.tree.leaves(same))
    moved = [s.generator_optimiser[0].mu["up9"]["kernel"] for s in (one, other)]  # a tenth of a step's gradient
    assert bool((moved[0] != moved[1]).any())


def test_average_follows_the_generator(rng: np.random.Generator, key: jax.Array) -> None:
    x, y = batch(rng)
    state = create_state(CONFIG, key=key)
    average = np.array(state.ema["up9"]["kernel"])
    for n in range(3):
        state, _ = train_step(state, x, y, key=key)
        decay = (1 + n) / (10 + n)
        average = decay * average + (1 - decay) * np.asarray(state.generator["up9"]["kernel"])
    np.testing.assert_allclose(state.ema["up9"]["kernel"], average, atol=1e-6)
    assert state.weights()["params"] is state.ema


@pytest.mark.slow
def test_cross_entropy_alone_trains_the_same_network(rng: np.random.Generator, key: jax.Array) -> None:
    x, y = batch(rng)
    state = create_state(replace(CONFIG, head="classes"), key=key)
    judge = jax.tree.map(np.array, state.discriminator)
    seen = []
    for n in range(12):
        state, losses = discriminative_step(state, x, labels_of(y).astype(jnp.uint8), key=jax.random.fold_in(key, n))
        seen.append(float(losses["cross_entropy"]))
    assert seen[0] == pytest.approx(np.log(3), rel=0.1)
    assert seen[-1] < 0.8 * seen[0]
    assert all(jax.tree.leaves(jax.tree.map(lambda a, b: bool((a == b).all()), judge, state.discriminator)))


def test_adam_is_the_configured_one() -> None:
    adam, wanted = PRODUCTS.optimiser(), optax.adam(2e-4, 0.5, 0.999)
    params = {"w": jnp.asarray([1.0, -2.0])}
    gradient = {"w": jnp.asarray([0.3, 0.1])}
    updates = [o.update(gradient, o.init(params), params)[0]["w"] for o in (adam, wanted)]
    np.testing.assert_array_equal(*updates)
