"""The distance between surfaces that `experiments.shape_from_frames` prints, against balls' closed form."""

from __future__ import annotations

import pytest
import trimesh

import sonarjax as sj
from experiments.common.shapes import chamfer


@pytest.mark.parametrize("more_mm", [0.0, 5.0])
def test_distance_of_balls_one_inside_the_other(more_mm: float) -> None:
    """In two tessellations, so that no point of one is a point of the other."""
    balls = [
        trimesh.creation.icosphere(5, 0.2), trimesh.creation.uv_sphere(0.2 + more_mm / 1e3, count=[120, 120])
    ]  # fmt: skip
    first, second = (sj.Mesh.from_arrays(ball.vertices, ball.faces) for ball in balls)
    assert 1e3 * chamfer(first, second) == pytest.approx(more_mm, abs=0.6)
