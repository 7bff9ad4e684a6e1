"""Meshes of fixed topology whose vertices are computed under jit: boxes, cylinders, balls and tubes in one `Mesh`.

A `Mesh` states on the host how many triangles a slice may cross; here that is a bound for all shapes. Triangles that a
shape does not need have no area, and the renderer never sees them.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sonarjax.exact import full_precision
from sonarjax.scene import Mesh
from sonarjax.scene.objects import box, cylinder_arrays, join

MOST_BOXES = 4
"""Most boxes in a pile: the bricks of Fig. 4."""
SIDES = 16
"""Number of sides of a cylinder."""
RINGS, RING_SIDES = 9, 8
"""Number of rings of a tube, and of sides of each ring."""
N_VERTICES, N_FACES, N_CREASES = RINGS * RING_SIDES + 2, 2 * RINGS * RING_SIDES, 4 * MOST_BOXES
"""Numbers of vertices, triangles and sharp vertices of every shape; the tube needs the most of the first two."""
BALL_VERTICES, CYLINDER_VERTICES = 42, 2 * SIDES + 2
WALL_FACES = 6
BOXES, CYLINDER, BALL, TUBE = range(4)
"""The kinds of shape, as `shape_mesh` numbers them."""

# Front faces that one slice crosses: 2 quads × 2 triangles of each upright box, 3 × 2 of a leaning one; 9 sides × 2 of
# a cylinder, or fewer sides and as many triangles of a cap instead; fewer of a ball. A slice along a tube crosses its
# near and its far wall in each segment, and for a few tubes more, some of which are then lost. Tank walls: two quads.
CROSSINGS = 32
"""Room for the triangles of a `shape_mesh` that a slice crosses and that face the sonar."""
_CORNERS = box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))[0].astype(np.float32)


def _icosphere() -> tuple[np.ndarray, np.ndarray]:
    """A ball of 80 triangles and radius 1: an icosahedron with every edge halved."""
    golden = (1 + math.sqrt(5)) / 2
    ring = [(s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    corners = np.array([p for s, t in ring for p in ((0, s, t), (s, t, 0), (t, 0, s))], float)
    corners /= np.linalg.norm(corners[0])
    near = np.linalg.norm(corners[:, None] - corners, axis=-1) < 1.1  # the edge is 1.05 radii long
    triples = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]
    ]
    middles = {
        pair: 12 + n for n, pair in enumerate(sorted({p for i, j, k in triples for p in ((i, j), (j, k), (i, k))}))
    }
    points = np.concatenate([corners, [(corners[i] + corners[j]) / 2 for i, j in middles]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = []
    for i, j, k in triples:
        a, b, c = middles[i, j], middles[j, k], middles[i, k]
        faces += [(i, a, c), (j, b, a), (k, c, b), (a, b, c)]
    outward = [f if np.linalg.det(points[list(f)]) > 0 else f[::-1] for f in faces]
    return points, np.array(outward)


_BALL = _icosphere()
_CYLINDER = cylinder_arrays(1.0, 1.0, SIDES)
_PILE = join(*[box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))] * MOST_BOXES)


def _tube_faces() -> np.ndarray:
    """Rings joined by quads, and a fan over each end. They face outwards if the path goes up and the sides run
    to port.
    """
    faces = []
    for ring in range(RINGS - 1):
        for side in range(RING_SIDES):
            beside = (side + 1) % RING_SIDES
            a, b, c, d = (k * RING_SIDES + s for k in (ring, ring + 1) for s in (side, beside))
            faces += [(a, b, d), (a, d, c)]
    first, last = RINGS * RING_SIDES, RINGS * RING_SIDES + 1
    for side in range(RING_SIDES):
        beside = (side + 1) % RING_SIDES
        top = (RINGS - 1) * RING_SIDES
        faces += [(first, beside, side), (last, top + side, top + beside)]
    return np.array(faces)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]), values.dtype)])


_FACES = np.stack([_padded(faces, N_FACES) for faces in (_PILE[1], _CYLINDER[1], _BALL[1], _tube_faces())]).astype(
    np.int32
)
_ROUND = np.stack([_padded(points, N_VERTICES) for points, _ in (_CYLINDER, _BALL)]).astype(np.float32)
# Boxes: the upper four corners, which lie above the lower four unless it leans. Cylinders: every second rim vertex.
_TOPS = [8 * number + corner for number in range(MOST_BOXES) for corner in range(4, 8)]
_OUTLINE = [*range(RING_SIDES), *range((RINGS - 1) * RING_SIDES, RINGS * RING_SIDES)]  # both ends of a tube
_CREASES = np.stack([_TOPS, np.arange(0, 2 * SIDES, 2 * SIDES // N_CREASES), [0] * N_CREASES, _OUTLINE]).astype(
    np.int32
)


@full_precision
def box_vertices(
    size: Float[Array, "box 3"], rotation: Float[Array, "box 3 3"], center: Float[Array, "box 3"]
) -> Float[Array, "box 8 3"]:
    """Corners (box, 8, 3) [m] of boxes: their sizes (box, 3) [m], rotations (box, 3, 3) and centres (box, 3) [m]."""
    return jnp.einsum("bij,bcj->bci", rotation, _CORNERS * size[:, None]) + center[:, None]


def pile_vertices(corners: Float[Array, "box 8 3"]) -> Float[Array, "vertex 3"]:
    """Vertices (vertex, 3) [m], for `shape_mesh`, of a pile of `MOST_BOXES` boxes with corners (box, 8, 3) [m]."""
    return jnp.pad(corners.reshape(-1, 3), ((0, N_VERTICES - 8 * MOST_BOXES), (0, 0)))


def round_vertices(
    kind: Int[Array, ""], radius: Float[Array, ""], length: Float[Array, ""]
) -> Float[Array, "vertex 3"]:
    """Vertices (vertex, 3) [m] of a cylinder along z from 0 to `length` [m], or a ball around 0, with `radius` [m]."""
    ball = kind == BALL
    scale = jnp.stack([radius, radius, jnp.where(ball, radius, length)])
    return jnp.asarray(_ROUND)[jnp.where(ball, 1, 0)] * scale


def tube_vertices(
    path: Float[Array, "ring 3"], across: Float[Array, "ring 3"], up: Float[Array, "ring 3"],
    radii: Float[Array, "ring side"],
) -> Float[Array, "vertex 3"]:  # fmt: skip
    """Vertices (vertex, 3) [m] of a tube of rings along a `path` (ring, 3) [m], each with `radii` (ring, side) [m].

    A ring lies in the plane of the unit vectors `across` and `up` (ring, 3), whose cross product points along the path.
    """
    angle = 2 * math.pi * np.arange(RING_SIDES) / RING_SIDES
    direction = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * up[:, None]
    rings = path[:, None] + radii[..., None] * direction
    return jnp.concatenate([rings.reshape(-1, 3), path[:1], path[-1:]])


def shape_mesh(kind: Int[Array, ""], vertices: Float[Array, "vertex 3"], walls: Float[Array, "wall 3"]) -> Mesh:
    """One surface from a shape of `kind` with vertices (vertex, 3) [m], and the tank's walls (wall, 3) [m] around it.

    Walls are one-sided and face inwards, so the mesh counts as closed, and faces that look away need no test. Shapes
    must not pass through one another. A shape whose vertices all coincide is nothing.
    """
    faces = jnp.concatenate([jnp.asarray(_FACES)[kind], _WALL_FACES + N_VERTICES])
    return Mesh(
        vertices=jnp.concatenate([vertices, walls]),
        faces=faces,
        crease=jnp.concatenate([jnp.asarray(_CREASES)[kind], N_VERTICES + jnp.array(_FAR_EDGES)]),
        closed=jnp.asarray(True),
        radius=jnp.float32(1.0),
        top=jnp.float32(2.0),
        crossings=CROSSINGS,
        front=N_FACES + WALL_FACES,
        intersecting=False,
    )


def remove_walls(mesh: Mesh) -> Mesh:
    """The mesh of `shape_mesh` with its walls shrunk to a point of the shape, where they are not seen."""
    return mesh.with_vertices(mesh.vertices.at[N_VERTICES:].set(mesh.vertices[0]))


def _wall_faces() -> np.ndarray:
    """Far, port and starboard wall of `box`, turned inside out."""
    _, faces = box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    normals = np.cross(_CORNERS[faces[:, 1]] - _CORNERS[faces[:, 0]], _CORNERS[faces[:, 2]] - _CORNERS[faces[:, 0]])
    kept = (normals[:, 0] > 0.5) | (np.abs(normals[:, 1]) > 0.5)
    return faces[kept][:, ::-1].astype(np.int32)


_WALL_FACES = _wall_faces()
_FAR_EDGES = (2, 3)  # of the tank: one corner of each upright edge behind the object


def wall_vertices(size: Float[Array, "3"], center: Float[Array, "2"], yaw: Float[Array, ""]) -> Float[Array, "wall 3"]:
    """Corners (wall, 3) [m] of a tank: `size` (3,) = length, width, height [m], centre (2,) [m], `yaw` [rad]."""
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    corners = _CORNERS * size
    x, y = corners[:, 0], corners[:, 1]
    return jnp.stack([c * x - s * y + center[0], s * x + c * y + center[1], corners[:, 2] + size[2] / 2], axis=1)
