"""The layers against loops written out, against each other and against PyTorch, in value and gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.segment import products, winograd
from sonarjax.segment.layers import down, down_two, patch, up, up_two

BACKENDS = ("convolution", "product")
# n, h, w, in, out: for the direct scheme, and for tiles (even tiles both ways, thick enough, enough of them).
SLOW = pytest.mark.slow
SHAPES = ((2, 8, 8, 3, 5), (1, 2, 2, 4, 2), (3, 2, 6, 2, 1), (4, 16, 8, 8, 9), (9, 4, 12, 9, 8))


def looped(name: str, x: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The layer as loops over the kernel's places, straight from its definition."""
    n, h, w, _ = x.shape
    if name == "up":
        out = np.zeros((n, 2 * h + 2, 2 * w + 2, kernel.shape[-2]))
        for a, b in np.ndindex(4, 4):
            out[:, a : a + 2 * h : 2, b : b + 2 * w : 2] += x @ kernel[a, b].T
        return out[:, 1:-1, 1:-1]
    stride = 2 if name == "down" else 1
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    rows, columns = (h // 2, w // 2) if name == "down" else (h - 1, w - 1)
    return sum(
        padded[:, a : a + stride * rows : stride, b : b + stride * columns : stride] @ kernel[a, b]
        for a, b in np.ndindex(4, 4)
    )


@pytest.fixture(autouse=True)
def _full_precision() -> Iterator[None]:
    """A network may round its products on a GPU; here they are compared digit by digit."""
    with jax.default_matmul_precision("highest"):
        yield


FUNCTIONS: dict[str, Callable[..., jax.Array]] = {"down": down, "up": up, "patch": patch}


def problem(name: str, shape: tuple[int, ...], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    n, h, w, channels, features = shape
    ends = (features, channels) if name == "up" else (channels, features)
    return rng.normal(size=(n, h, w, channels)), rng.normal(size=(4, 4, *ends)) / np.sqrt(16 * channels)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("shape", [*SHAPES[:2], *(pytest.param(shape, marks=SLOW) for shape in SHAPES[2:])], ids=str)
def test_layer_is_its_definition(name: str, backend: str, shape: tuple[int, ...], rng: np.random.Generator) -> None:
    x, kernel = problem(name, shape, rng)
    layer = jax.jit(FUNCTIONS[name], static_argnums=2)
    found = layer(jnp.asarray(x, jnp.float32), jnp.asarray(kernel, jnp.float32), backend)
    np.testing.assert_allclose(found, looped(name, x, kernel), atol=1e-5)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("shape", [SHAPES[3], *(pytest.param(shape, marks=SLOW) for shape in SHAPES[1:3])], ids=str)
def test_backends_have_one_gradient(name: str, shape: tuple[int, ...], rng: np.random.Generator) -> None:
    x, kernel = (jnp.asarray(v, jnp.float32) for v in problem(name, shape, rng))
    cotangent = jnp.asarray(rng.normal(size=looped(name, x, kernel).shape), jnp.float32)
    gradients = []
    for backend in BACKENDS:
        layer = partial(FUNCTIONS[name], backend=backend)
        gradients.append(jax.jit(lambda g, f=layer: jax.vjp(f, x, kernel)[1](g))(cotangent))
    for one, other in zip(*gradients, strict=True):
        assert float(jnp.abs(one).max()) > 0.1
        np.testing.assert_allclose(one, other, atol=1e-5 * float(jnp.abs(one).max()) + 1e-6)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_product_is_pytorchs_layer(name: str, rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch")
    x, kernel = (v.astype(np.float32) for v in problem(name, (4, 12, 8, 9, 8), rng))
    there = [torch.tensor(v, requires_grad=True) for v in (x, kernel)]
    a, b = there[0].permute(0, 3, 1, 2), there[1]
    if name == "up":
        y = torch.nn.functional.conv_transpose2d(a, b.permute(3, 2, 0, 1), stride=2, padding=1)
    else:
        y = torch.nn.functional.conv2d(a, b.permute(3, 2, 0, 1), stride=2 if name == "down" else 1, padding=1)
    y = y.permute(0, 2, 3, 1)
    cotangent = rng.normal(size=y.shape).astype(np.float32)
    y.backward(torch.tensor(cotangent))
    layer = partial(FUNCTIONS[name], backend="product")
    ours = jax.jit(layer)(x, kernel)
    slopes = jax.jit(lambda g: jax.vjp(layer, jnp.asarray(x), jnp.asarray(kernel))[1](g))(cotangent)
    np.testing.assert_allclose(ours, y.detach().numpy(), atol=1e-5)
    for found, wanted in zip(slopes, there, strict=True):
        np.testing.assert_allclose(found, wanted.grad.numpy(), atol=1e-5 * float(wanted.grad.abs().max()) + 1e-6)


def test_both_schemes_are_met() -> None:
    assert [products.scheme(n, h // 2, w // 2, c) is winograd for n, h, w, c, _ in SHAPES] == [False] * 3 + [True] * 2
    assert [products.scheme(n, h, w, f) is winograd for n, h, w, _, f in SHAPES] == [False] * 3 + [True] * 2


@pytest.mark.parametrize("size", [1, 2, 3])
def test_two_by_two_is_four_by_four_with_nothing_around(size: int, rng: np.random.Generator) -> None:
    x, kernel = (jnp.asarray(v, jnp.float32) for v in (rng.normal(size=(3, 2, 2, 5)), rng.normal(size=(2, 2, 5, 4))))
    padded = jnp.pad(kernel, ((1, 1), (1, 1), (0, 0), (0, 0)))
    np.testing.assert_allclose(down_two(x, kernel), down(x, padded, "convolution"), atol=1e-5)
    y = jnp.asarray(rng.normal(size=(3, size, size, 4)), jnp.float32)
    np.testing.assert_allclose(up_two(y, kernel), up(y, padded, "convolution"), atol=1e-5)


def test_half_precision_is_kept() -> None:
    x, kernel = jnp.ones((1, 4, 4, 2), jnp.bfloat16), jnp.ones((4, 4, 2, 2), jnp.bfloat16)
    for layer in FUNCTIONS.values():
        assert {layer(x, kernel, backend).dtype for backend in BACKENDS} == {jnp.dtype(jnp.bfloat16)}
