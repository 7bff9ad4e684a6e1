"""Generator and discriminator against the same networks in PyTorch; shapes, skips, dropout and running statistics."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen as nn

from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.discriminator import Discriminator
from sonarjax.segment.generator import Generator, to_grey
from sonarjax.segment.initial import draw_variables
from sonarjax.segment.normalise import EPSILON, MOMENTUM, batch_norm

GENERATOR = Generator(width=2)


@pytest.fixture(scope="module")
def variables() -> Any:
    """A generator with running statistics that are not those of its start, and weights large enough to matter."""
    drawn = draw_variables(GENERATOR, jnp.zeros((1, 128, 128, 1)), key=jax.random.key(3))
    rng = np.random.default_rng(4)

    def replaced(path: Any, leaf: jax.Array) -> jax.Array:
        if path[-1].key == "kernel":
            return jnp.asarray(rng.normal(size=leaf.shape) / np.sqrt(leaf[..., 0].size / 2), jnp.float32)
        low, high = {"bias": (-0.3, 0.3), "mean": (-0.5, 0.5)}.get(path[-1].key, (0.5, 2.0))
        return jnp.asarray(rng.uniform(low, high, leaf.shape), jnp.float32)

    return jax.tree_util.tree_map_with_path(replaced, drawn)


@pytest.fixture(scope="module")
def image() -> jax.Array:
    return jnp.asarray(np.random.default_rng(5).uniform(-1, 1, (2, 128, 128, 1)), jnp.float32)


def test_draw_has_the_shapes_and_spread_of_init(key: jax.Array) -> None:
    images = jnp.zeros((1, 128, 128, 1))
    for module, inputs in ((Generator(8), [images]), (Discriminator(8), [images, images])):
        drawn = draw_variables(module, *inputs, key=key)
        shapes = jax.eval_shape(module.init, key, *inputs)
        assert jax.tree.map(jnp.shape, drawn) == jax.tree.map(jnp.shape, shapes)
        assert float(jnp.std(drawn["params"]["down3"]["kernel"])) == pytest.approx(0.02, rel=0.05)
        assert float(jnp.mean(drawn["params"]["norm3"]["scale"])) == pytest.approx(1.0, abs=0.02)
        assert not drawn["params"]["down1"]["bias"].any()


@pytest.mark.slow
def test_inference_is_pytorchs(variables: Any, image: jax.Array) -> None:
    torch = pytest.importorskip("torch")
    from tests.segment import torch_peer as peer

    found = jax.jit(GENERATOR.apply)(variables, image)
    stats = jax.tree.map(lambda v: torch.tensor(np.asarray(v)), variables["batch_stats"])
    wanted = torch.tanh(peer.generator(peer.tensors(variables["params"]), peer.maps(image), stats))
    assert found.shape == (2, 128, 128, 1)
    assert float(found.std()) > 0.01
    np.testing.assert_allclose(found, peer.back(wanted), atol=1e-5)


@pytest.mark.slow
def test_training_pass_and_gradient_are_pytorchs(variables: Any, image: jax.Array) -> None:
    pytest.importorskip("torch")
    from tests.segment import torch_peer as peer

    @jax.jit
    def value(params: Any) -> Any:
        together = {"params": params, "batch_stats": variables["batch_stats"]}
        made, _ = GENERATOR.apply(together, image, train=True, mutable="batch_stats")
        return ((made - image) ** 2).mean(), made

    gradient, made = jax.jit(jax.grad(value, has_aux=True))(variables["params"])
    params = peer.tensors(variables["params"])
    wanted = peer.generator(params, peer.maps(image)).tanh()
    np.testing.assert_allclose(made, peer.back(wanted), atol=2e-5)
    ((wanted - peer.maps(image)) ** 2).mean().backward()
    for path, found in jax.tree_util.tree_leaves_with_path(gradient):
        there = params[path[0].key][path[1].key].grad.numpy()
        np.testing.assert_allclose(found, there, atol=2e-4 * np.abs(there).max() + 1e-7, err_msg=str(path))


@pytest.mark.slow
def test_discriminator_is_pytorchs(image: jax.Array, key: jax.Array) -> None:
    pytest.importorskip("torch")
    from tests.segment import torch_peer as peer

    judge = Discriminator(4)
    params = draw_variables(judge, image, image, key=key)["params"]
    params = jax.tree.map(lambda v: 3 * v, params)
    found, _ = jax.jit(partial(judge.apply, mutable="batch_stats"))({"params": params}, image, -image)
    assert found.shape == (2, 15, 15, 1)
    wanted = peer.discriminator(peer.tensors(params), peer.maps(image), peer.maps(-image))
    np.testing.assert_allclose(found, peer.back(wanted), atol=1e-5)


def test_discriminator_looks_at_patches_of_46_pixels(image: jax.Array, key: jax.Array) -> None:
    # A batch of its own normalises with it, so the reach is read off a network whose normalisation is fixed.
    class Plain(Discriminator):
        pass

    judge = Plain(2)
    params = draw_variables(judge, image, image, key=key)["params"]
    with nn.intercept_methods(lambda f, a, k, c: a[0] if isinstance(c.module, nn.BatchNorm) else f(*a, **k)):
        apply = partial(judge.apply, {"params": params}, mutable="batch_stats")
        slope = jax.jit(jax.grad(lambda x: apply(x, image)[0][0, 7, 7, 0]))(image)
    rows, columns = (np.flatnonzero(np.asarray(jnp.abs(slope[0, ..., 0]).max(axis))) for axis in (1, 0))
    assert (len(rows), len(columns)) == (46, 46)


def test_dropout_only_with_a_key_and_in_three_layers(variables: Any, image: jax.Array, key: jax.Array) -> None:
    seen = []

    def watch(function: Any, arguments: Any, options: Any, context: Any) -> Any:
        if isinstance(context.module, nn.Dropout):
            seen.append(context.module.deterministic)
        return function(*arguments, **options)

    with nn.intercept_methods(watch):
        drawn = [
            jax.eval_shape(lambda k: GENERATOR.apply(variables, image, rngs=None if k is None else {"dropout": k}), k)
            for k in (None, key)
        ]
    assert seen == [True] * 3 + [False] * 3
    assert drawn[0].shape == drawn[1].shape


def test_output_depends_on_the_key(variables: Any, image: jax.Array, key: jax.Array) -> None:
    apply = jax.jit(lambda k: GENERATOR.apply(variables, image, rngs={"dropout": k}))
    one, again, other = (apply(k) for k in (key, key, jax.random.key(9)))
    assert bool((one == again).all())
    assert float(jnp.abs(one - other).max()) > 1e-4


def test_a_whole_frame_is_segmented(variables: Any) -> None:
    frame = jax.eval_shape(lambda: GENERATOR.apply(variables, jnp.zeros((1, 512, 128, 1))))
    assert frame.shape == (1, 512, 128, 1)
    with pytest.raises(SonarjaxError, match="multiples of 128"):
        GENERATOR.apply(variables, jnp.zeros((1, 512, 96, 1)))


def test_skips_widths_and_heads_by_option(key: jax.Array) -> None:
    images = jnp.zeros((2, 128, 128, 1))

    def shapes(**options: Any) -> Any:
        made, variables = jax.eval_shape(lambda: Generator(2, **options).init_with_output(key, images))
        return made, variables["params"]

    _, params = shapes()
    assert params["up15"]["kernel"].shape == (4, 4, 1, 4)  # layer 14 and the copy of layer 1
    assert params["up9"]["kernel"].shape == (2, 2, 16, 32)
    _, params = shapes(skips=False)
    assert params["up15"]["kernel"].shape == (4, 4, 1, 2)
    made, params = shapes(head="classes", multipliers=(1, 2, 2, 2, 2, 2, 2))
    assert made.shape == (2, 128, 128, 3)
    assert params["up9"]["kernel"].shape == (2, 2, 4, 8)
    made, params = shapes(dtype=jnp.bfloat16)
    assert (made.dtype, params["up9"]["kernel"].dtype) == (jnp.float32, jnp.float32)


def test_fifteen_layers(key: jax.Array) -> None:
    params = jax.eval_shape(lambda: GENERATOR.init(key, jnp.zeros((1, 128, 128, 1))))["params"]
    assert sum("kernel" in layer for layer in params.values()) == 15


def test_grey_of_classes() -> None:
    logits = jnp.log(jnp.asarray([[0.1, 0.7, 0.2], [0.5, 0.0, 0.5]]))[None, None]
    np.testing.assert_allclose(to_grey(logits)[0, 0, :, 0], [0.5, -0.5], atol=1e-6)
    assert to_grey(jnp.full((1, 1, 1, 1), 0.3)).item() == pytest.approx(0.3)


@pytest.mark.slow
def test_running_statistics_are_pytorchs(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    norm, there = partial(batch_norm, "norm"), torch.nn.BatchNorm2d(3)
    batches = jnp.asarray(rng.normal(2.0, 3.0, (5, 4, 6, 5, 3)), jnp.float32)
    variables = norm(train=True).init(jax.random.key(0), batches[0])
    variables["params"] = {"scale": jnp.ones(3), "bias": jnp.zeros(3)}
    for batch in batches:
        _, changed = norm(train=True).apply(variables, batch, mutable="batch_stats")
        variables["batch_stats"] = changed["batch_stats"]
        there(torch.tensor(np.asarray(batch)).permute(0, 3, 1, 2))
    kept = variables["batch_stats"]
    np.testing.assert_allclose(kept["mean"], there.running_mean.numpy(), rtol=1e-5)
    # PyTorch keeps the unbiased variance of a batch, flax the batch's own; both begin at 1.
    begun, pixels = MOMENTUM ** len(batches), batches[0].size // 3
    unbiased = begun + (kept["var"] - begun) * pixels / (pixels - 1)
    np.testing.assert_allclose(unbiased, there.running_var.numpy(), rtol=1e-5)
    found = norm(train=False).apply(variables, batches[0])
    wanted = (batches[0] - kept["mean"]) / np.sqrt(kept["var"] + EPSILON)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_one_pixel_is_normalised_to_a_finite_number() -> None:
    norm = batch_norm("norm", train=True)
    params = {"scale": jnp.ones(2), "bias": jnp.full(2, 0.3)}
    value, slope = jax.value_and_grad(lambda x: norm.apply({"params": params}, x, mutable="batch_stats")[0].sum())(
        jnp.asarray([[[[5.0, -2.0]]]])
    )
    assert float(value) == pytest.approx(0.6, abs=1e-4)
    assert bool(jnp.isfinite(slope).all())
