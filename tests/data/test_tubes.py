"""Tubes are closed bodies of the kinds that they are said to be."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from sonarjax.data.shapes import RING_SIDES, RINGS, TUBE, shape_mesh
from sonarjax.data.tubes import draw_tube

DRAWS = 64


@pytest.fixture(scope="module")
def tubes() -> np.ndarray:
    """Vertices (draw, vertex, 3) of random tubes."""
    return np.asarray(jax.jit(jax.vmap(lambda key: draw_tube(key=key)))(jax.random.split(jax.random.key(3), DRAWS)))


@pytest.fixture(scope="module")
def faces() -> np.ndarray:
    """Triangles (face, 3) of a tube."""
    mesh = shape_mesh(jnp.int32(TUBE), jnp.zeros((RINGS * RING_SIDES + 2, 3)), jnp.zeros((8, 3)))
    return np.asarray(mesh.faces)[: 2 * RINGS * RING_SIDES]


def test_every_tube_encloses_a_volume_and_stands_on_the_floor(tubes: np.ndarray, faces: np.ndarray) -> None:
    for vertices in tubes:
        body = trimesh.Trimesh(vertices, faces, process=False)
        assert body.is_watertight and body.is_winding_consistent
        assert body.volume > 1e-6  # outwards
        assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-5)
        assert 0.02 < np.ptp(vertices, axis=0).max() < 0.9


def test_some_are_bent_and_some_are_straight(tubes: np.ndarray) -> None:
    """The middles of a straight tube's rings lie on a line, those of a torus on a circle that closes."""
    middles = tubes[:, :-2].reshape(DRAWS, RINGS, RING_SIDES, 3).mean(2)
    length = np.linalg.norm(np.diff(middles, axis=1), axis=2).sum(1)
    direct = np.linalg.norm(middles[:, -1] - middles[:, 0], axis=1)
    closed, straight = direct < 0.05 * length, direct > 0.9 * length
    assert closed.sum() >= 3 and straight.sum() >= 20
    assert (~closed & ~straight).any()
