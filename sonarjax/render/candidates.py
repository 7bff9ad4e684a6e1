"""Which triangles each slice may see: a cheap selection before any visibility test."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

SHARED_LIMIT = 24  # up to this many triangles that face the sonar, all slices share one list of them
DENSE_LIMIT = 256  # up to this many triangles, every (slice, triangle) pair is tested


def front_faces(
    vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"], closed: Bool[Array, ""]
) -> Bool[Array, "face"]:
    """Which triangles (face,) can be seen from the sonar head: those that face it; all of them if the surface is open.

    Vertices (vertex, 3) [m] are in the sonar frame. Padding (zero-area) triangles are never seen.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    facing = (jnp.cross(b - a, c - a) * a).sum(-1)
    real = (faces[:, 0] != faces[:, 1]) & ((a[:, 0] > 0) | (b[:, 0] > 0) | (c[:, 0] > 0))
    return real & ((facing < 0) | (~closed & (facing > 0)))


def candidates(
    vertices: Float[Array, "vertex 3"],
    faces: Int[Array, "face 3"],
    seen: Bool[Array, "face"],
    azimuth: Float[Array, "slab"],
    crossings: int,
    front: int,
) -> tuple[Int[Array, "slab_or_1 candidate"], Int[Array, ""]]:
    """List the triangles that the half-plane of each slab may cut.

    Args:
        vertices: Vertices (vertex, 3) [m] in the sonar frame.
        faces: Vertex numbers (face, 3) of the triangles.
        seen: Which triangles (face,) to consider.
        azimuth: Azimuth (slab,) [rad] of each half-plane.
        crossings: Most triangles that a slice has room for.
        front: Most triangles that face the sonar. Where this is small, one list (1, front) serves every slab.

    Returns:
        Triangle ids (slab, candidate), filled up with -1, and the number of triangles for which the fullest slice had
        no room.
    """
    if front <= max(SHARED_LIMIT, crossings):
        return _compacted(seen[None], front), _excess(seen[None], front)
    if len(faces) <= DENSE_LIMIT:
        wanted = seen & _cut(vertices, faces, azimuth)
        return _compacted(wanted, crossings), _excess(wanted, crossings)
    return _sparse(vertices, faces, seen, azimuth, crossings)


def _cut(vertices: Array, faces: Array, azimuth: Array) -> Bool[Array, "slab face"]:
    c, s = jnp.cos(azimuth)[:, None], jnp.sin(azimuth)[:, None]
    port = c * vertices[:, 1] - s * vertices[:, 0] > 0  # (slab, vertex)
    first, second, third = (port[:, faces[:, k]] for k in range(3))
    return (first != second) | (second != third)


def _excess(wanted: Bool[Array, "slab face"], limit: int) -> Int[Array, ""]:
    """How many triangles too many the fullest slice has; 0 where all have room."""
    return jnp.maximum(wanted.sum(axis=1).max() - limit, 0).astype(jnp.int32)


def _compacted(wanted: Bool[Array, "slab face"], limit: int) -> Int[Array, "slab candidate"]:
    """Numbers of the wanted faces in ascending order, filled up with -1."""
    rank = jnp.cumsum(wanted, axis=1) - 1
    slot = wanted[:, None, :] & (rank[:, None, :] == jnp.arange(limit)[:, None])  # (slab, candidate, face)
    return (slot * jnp.arange(1, wanted.shape[1] + 1)).sum(-1) - 1


def _sparse(vertices: Array, faces: Array, seen: Array, azimuth: Array, limit: int) -> tuple[Array, Array]:
    """As `candidates`, from a list of (slice, triangle) pairs.

    A triangle is cut by consecutive slices. Most small triangles are cut by none, and these take no space in the list.
    """
    ahead = jnp.searchsorted(azimuth, jnp.arctan2(vertices[:, 1], vertices[:, 0])).astype(jnp.int32)
    a, b, c = (ahead[faces[:, k]] for k in range(3))
    first, last = jnp.minimum(jnp.minimum(a, b), c), jnp.maximum(jnp.maximum(a, b), c)
    count = jnp.where(seen, last - first, 0)
    pairs = len(azimuth) * limit // 2
    ends = jnp.cumsum(count)
    owner = jnp.searchsorted(ends, jnp.arange(pairs), side="right").astype(jnp.int32)
    owner = jnp.minimum(owner, len(faces) - 1)
    slab = first[owner] + jnp.arange(pairs, dtype=jnp.int32) - (ends - count)[owner]
    slab = jnp.where(jnp.arange(pairs) < ends[-1], slab, len(azimuth))
    slab, owner = _by_slab(slab, owner, len(azimuth))
    rank = jnp.arange(pairs) - jnp.searchsorted(slab, slab, side="left")
    table = jnp.full((len(azimuth), limit), -1, jnp.int32)
    crowded = jnp.where(slab < len(azimuth), rank + 1 - limit, 0).max()
    left_over = -(-2 * (ends[-1] - pairs) // max(len(azimuth), 1))  # pairs that the list lacks, as room in each slice
    overflow = jnp.maximum(jnp.maximum(crowded, left_over), 0).astype(jnp.int32)
    return table.at[slab, rank].set(owner, mode="drop"), overflow


def _by_slab(slab: Int[Array, "pair"], owner: Int[Array, "pair"], slabs: int) -> tuple[Array, Array]:
    """Both in ascending order of slab, where pairs of one slab keep theirs."""
    pairs = len(slab)
    if (slabs + 1) * pairs > jnp.iinfo(jnp.int32).max:
        slab, owner = jax.lax.sort((slab, owner), num_keys=1)
        return slab, owner
    key = jnp.sort(slab * pairs + jnp.arange(pairs, dtype=jnp.int32))  # one sort of plain numbers: several times faster
    return key // pairs, owner[key % pairs]
