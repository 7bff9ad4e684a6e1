"""What faces send back, against Lambert's law by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.data import materials
from sonarjax.data.materials import draw_reflectivity
from sonarjax.scene import Pose, objects


@pytest.fixture
def lambert(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every object diffuse, with an exponent of 2 and equal faces."""
    monkeypatch.setattr(materials, "LAMBERT", (2.0, 2.0))
    monkeypatch.setattr(materials, "GLOSSY_SHARE", 0.0)
    monkeypatch.setattr(materials, "FACE_DB", (0.0, 0.0))


def test_a_diffuse_face_sends_back_the_square_of_the_cosine(lambert: None) -> None:
    mesh = objects.brick(0.2, 0.2, 0.1)
    placed = mesh.with_vertices(Pose(x=2.0).to_ground(mesh.vertices))
    sent = np.asarray(draw_reflectivity(placed, jnp.float32(0.9), mesh.n_faces, key=jax.random.key(0)))
    corners = np.asarray(placed.vertices)[np.asarray(placed.faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sight = corners.mean(1) - [0, 0, 0.9]
    real = np.linalg.norm(normals, axis=1) > 0
    cosine = (
        (normals * sight).sum(1)[real] / np.linalg.norm(normals[real], axis=1) / np.linalg.norm(sight[real], axis=1)
    )
    assert sent[real] == pytest.approx(np.maximum(np.abs(cosine), 1e-3) ** 2, rel=1e-3)
    assert np.ptp(np.abs(cosine)) > 0.5


def test_walls_send_back_one_and_draws_differ() -> None:
    mesh = objects.brick()
    placed = mesh.with_vertices(Pose(x=2.0).to_ground(mesh.vertices))
    draws = [np.asarray(draw_reflectivity(placed, jnp.float32(0.9), 6, key=jax.random.key(k))) for k in range(8)]
    assert all((one[6:] == 1).all() and (one[:6] > 0).all() for one in draws)
    assert len({one[0] for one in draws}) == 8
