"""Vectors, against NumPy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render.vector import Vector, normal_of, take_points, unit


def test_products_differences_and_quotients_are_numpys(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 7, 3)).astype(np.float32)
    one, other = (take_points(jnp.asarray(v), jnp.arange(7)) for v in (a, b))
    stacked = {"difference": one - other, "product": one.cross(other), "quotient": one / other.x}
    expected = {"difference": a - b, "product": np.cross(a, b), "quotient": a / b[:, :1]}
    for name, vector in stacked.items():
        np.testing.assert_allclose(np.stack([vector.x, vector.y, vector.z], -1), expected[name], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(one.dot(other), (a * b).sum(-1), atol=1e-5)


def test_a_turned_vector_has_its_length_and_its_bearing() -> None:
    along, port = Vector(jnp.array(3.0), jnp.array(4.0), jnp.array(1.0)).turned(jnp.arctan2(4.0, 3.0))
    assert (float(along), float(port)) == pytest.approx((5.0, 0.0), abs=1e-6)


def test_a_triangle_seen_from_above_faces_up() -> None:
    corners = take_points(jnp.array([[0.0, 0, 0], [2.0, 0, 0], [0.0, 3, 0]]), jnp.arange(3))
    first, second, third = (Vector(corners.x[k], corners.y[k], corners.z[k]) for k in range(3))
    up = normal_of((first, second, third))
    assert (float(up.x), float(up.y), float(up.z)) == (0.0, 0.0, 6.0)
    assert float(unit(up).z) == pytest.approx(1.0)
    assert float(unit(Vector(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))).z) == 0.0
