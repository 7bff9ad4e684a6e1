"""A mesh is moved to stand at its origin, and one that does not stand there is noticed."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.scene.objects import box
from sonarjax.scene.standing import check_above_floor, check_over_origin, why_not_standing


def test_standing_is_the_same_body_elsewhere() -> None:
    far = sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (5.0, -2.0, 0.7)))
    near = sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (0.0, 0.0, 0.1)))
    moved = far.standing()
    np.testing.assert_allclose(moved.vertices, near.vertices, atol=1e-6)
    assert (float(moved.radius), float(moved.top)) == (float(near.radius), float(near.top))
    np.testing.assert_allclose(moved.standing().vertices, moved.vertices, atol=1e-7)


def test_what_stands_is_measured_under_jit_too() -> None:
    mesh = sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (1.0, 0.0, 0.7)))

    def measured() -> tuple[jax.Array, jax.Array]:
        standing = mesh.standing()
        return standing.top, standing.radius

    assert [float(v) for v in jax.jit(measured)()] == pytest.approx([float(v) for v in measured()])
    assert float(measured()[0]) == pytest.approx(0.2)


def test_a_mesh_of_padding_stands_too() -> None:
    """Padding repeats a vertex, so it does not change where the mesh is."""
    cone = sj.Mesh.from_arrays(
        [[1, 1, 3], [2, 1, 3], [1, 2, 3], [1, 1, 4]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    )
    assert len(cone.vertices) > 4
    np.testing.assert_allclose(np.min(cone.standing().vertices, axis=0), [-0.5, -0.5, 0.0])


def raised(lowest: float) -> sj.Mesh:
    return sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (0.0, 0.0, lowest + 0.1)))


@pytest.mark.parametrize("lowest", [-0.004, 0.0, 0.004])
def test_what_nearly_stands_stands(lowest) -> None:
    assert why_not_standing(raised(lowest)) is None
    check_above_floor(raised(lowest), "pipe")


def test_what_hangs_is_noted_and_what_goes_through_the_floor_refused() -> None:
    assert why_not_standing(raised(0.25)) == "but its lowest point is 0.25 m above that"
    check_above_floor(raised(0.25), "pipe")
    with pytest.raises(sj.SonarjaxError, match=r"pipe: expected a mesh above .* 0.1 m below that: .* or --stand on"):
        check_above_floor(raised(-0.1), "pipe")


@pytest.mark.parametrize(("middle", "good"), [(0.154, True), (-0.14, True), (0.16, False), (-3.0, False)])
def test_the_origin_is_within_the_outline(middle, good) -> None:
    mesh = sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (middle, 0.0, 0.1)))
    if good:
        check_over_origin(mesh, "pipe")
    else:
        with pytest.raises(sj.SonarjaxError, match=f"pipe: expected a mesh around its origin, .* x {middle:.3g} m"):
            check_over_origin(mesh, "pipe")


def test_a_stack_of_meshes_does_not_stand() -> None:
    mesh = sj.Mesh.from_arrays(*box((0.3, 0.1, 0.2), (0.0, 0.0, 0.1)))
    with pytest.raises(sj.SonarjaxError, match="expected one mesh, got a batch"):
        sj.stack_meshes([mesh, mesh]).standing()
