"""The paper's objects (Fig. 4 and 6) and tank (Table 1), built from boxes and cylinders as plain arrays."""

from __future__ import annotations

import math

import numpy as np

from sonarjax.scene.mesh import Mesh

BRICK_M = (0.190, 0.090, 0.057)
"""Length, width and height of a common clay brick [m]."""
TANK_M = (3.0, 1.35, 1.7)
"""Length, width and height of the tank of Table 1 [m]."""

Arrays = tuple[np.ndarray, np.ndarray]


def box(size: tuple[float, float, float], center: tuple[float, float, float], yaw: float = 0.0) -> Arrays:
    """Return a box whose triangles face outwards.

    Args:
        size: Length, width and height [m].
        center: Centre [m].
        yaw: Rotation about the vertical [rad].

    Returns:
        Vertices (8, 3) [m] and triangles (12, 3).

    >>> vertices, faces = box((0.4, 0.2, 0.1), (0.0, 0.0, 0.05))
    >>> vertices.min(axis=0).tolist(), len(faces)
    ([-0.2, -0.1, 0.0], 12)
    """
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
    c, s = math.cos(yaw), math.sin(yaw)
    corners = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + center
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def cylinder_arrays(radius: float, height: float, sides: int = 48) -> Arrays:
    """Return an upright cylinder on z = 0.

    Args:
        radius: Radius [m].
        height: Height [m].
        sides: Number of flat faces around it.

    Returns:
        Vertices (2 sides + 2, 3) [m] and triangles (4 sides, 3).
    """
    angle = 2 * math.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(sides)], axis=1)
    vertices = np.concatenate([ring, ring + [0, 0, height], [[0, 0, 0], [0, 0, height]]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    bottom, top = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [(i, j, j + sides), (i, j + sides, i + sides), (j, i, bottom), (i + sides, j + sides, top)]
    return vertices, np.concatenate([np.stack(corner, axis=1) for corner in faces])


def sphere_arrays(radius: float, rings: int = 24, sectors: int = 48) -> Arrays:
    """Return a ball that touches z = 0.

    Args:
        radius: Radius [m].
        rings: Number of bands from pole to pole.
        sectors: Number of parts around the vertical axis.

    Returns:
        Vertices (vertex, 3) [m] and triangles (face, 3).
    """
    polar = math.pi * np.arange(1, rings) / rings
    angle = 2 * math.pi * np.arange(sectors) / sectors
    grid = np.stack(
        [np.outer(np.sin(polar), np.cos(angle)), np.outer(np.sin(polar), np.sin(angle)),
         np.outer(np.cos(polar), np.ones(sectors))], axis=-1
    ).reshape(-1, 3)  # fmt: skip
    vertices = np.concatenate([grid, [[0, 0, 1], [0, 0, -1]]]) * radius + [0, 0, radius]
    north, south = len(grid), len(grid) + 1
    s = np.arange(sectors)
    n = (s + 1) % sectors
    faces = [np.stack([np.full(sectors, north), s, n], 1)]
    for ring in range(rings - 2):
        a, b = ring * sectors, (ring + 1) * sectors
        faces += [np.stack([a + s, b + s, b + n], 1), np.stack([a + s, b + n, a + n], 1)]
    last = (rings - 2) * sectors
    faces.append(np.stack([last + s, np.full(sectors, south), last + n], 1))
    return vertices, np.concatenate(faces)


def join(*parts: Arrays) -> Arrays:
    """Join several surfaces into one.

    Args:
        *parts: Vertices (vertex, 3) [m] and triangles (face, 3) of each surface.

    Returns:
        Vertices (vertex, 3) [m] and triangles (face, 3) of all of them.
    """
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]),
    )


def brick(length: float = BRICK_M[0], width: float = BRICK_M[1], height: float = BRICK_M[2]) -> Mesh:
    """Return a brick that lies on the floor with its long side along x.

    Args:
        length, width, height: Sides along x, y and z [m]; those of a common clay brick by default.

    Returns:
        The mesh, with the centre of its underside at the origin.
    """
    return Mesh.from_arrays(*box((length, width, height), (0.0, 0.0, height / 2)), name="brick")


def target() -> Mesh:
    """Return the target of Fig. 6: two bricks in an L and a third across the corner. It has no symmetry in yaw.

    The bottom bricks stand 1 mm apart, so that no two faces coincide.

    Returns:
        The mesh, standing on z = 0.
    """
    height = BRICK_M[2]
    return Mesh.from_arrays(
        *join(
            box(BRICK_M, (0.0, -0.05, height / 2)),
            box(BRICK_M, (-0.05, 0.091, height / 2), math.pi / 2),
            box(BRICK_M, (-0.03, 0.0, 1.5 * height), math.radians(60)),
        ),
        name="target",
    )


def non_target() -> Mesh:
    """Return the non-target of Fig. 6: the same bricks, two side by side and one standing on its long narrow side.

    Returns:
        The mesh, standing on z = 0.
    """
    length, width, height = BRICK_M
    return Mesh.from_arrays(
        *join(
            box(BRICK_M, (0.0, 0.055, height / 2)),
            box(BRICK_M, (0.06, -0.055, height / 2), math.radians(20)),
            box((length, height, width), (-0.02, 0.05, height + width / 2), math.radians(-15)),
        ),
        name="non-target",
    )


def concrete_cylinder(radius: float = 0.075, height: float = 0.15, sides: int = 48) -> Mesh:
    """Return the concrete cylinder of Fig. 4, upright.

    Args:
        radius: Radius [m].
        height: Height [m].
        sides: Number of flat faces around it.

    Returns:
        The mesh, standing on z = 0.
    """
    return Mesh.from_arrays(*cylinder_arrays(radius, height, sides), name="concrete cylinder")


def ball(radius: float = 0.11, rings: int = 24, sectors: int = 48) -> Mesh:
    """Return the plastic ball of Fig. 4, touching the floor.

    Args:
        radius: Radius [m].
        rings: Number of bands from pole to pole.
        sectors: Number of parts around the vertical axis.

    Returns:
        The mesh, standing on z = 0.
    """
    return Mesh.from_arrays(*sphere_arrays(radius, rings, sectors), name="ball")


def tank(size: tuple[float, float, float] = TANK_M) -> Mesh:
    """Return the four walls of the tank of Table 1 around the origin.

    The surface is open: both sides of a wall reflect.

    Args:
        size: Length, width and height [m].

    Returns:
        The mesh, standing on z = 0.
    """
    vertices, faces = box(size, (0.0, 0.0, size[2] / 2))
    return Mesh.from_arrays(vertices, faces[4:], name="tank")
