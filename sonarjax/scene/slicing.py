"""Measure on the host, once for each mesh, what vertical slices can meet: how many triangles, and if they cross."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
from jaxtyping import Float, Int

INSIDE = 1e-4  # a crossing must lie this share inside both edge and triangle: bodies that only touch do not cross
PAIRS_AT_ONCE = 1 << 21
FINE = (
    20_000  # above this many triangles, count by bins, in fewer directions, or on a sample: exact counts take seconds
)
VERY_FINE = 10 * FINE
"""Above this many triangles the count hardly changes from one direction to the next, so still fewer are tried."""
BINS = 1 << 15


def most_crossings(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], closed: bool, views: int = 48
) -> int:
    """Most triangles that a vertical plane crosses, plus 15 %, over sampled directions; `vertices` (vertex, 3) in [m].

    For a `closed` surface only triangles that face the sonar count. Each direction is also tried with two tilts,
    because pitch and roll bring other triangles into the slice. The 15 % allow for the directions in between.
    """
    worst = 0
    overlap = deepest_overlap if len(faces) <= FINE else _overlap_by_bins
    views //= 1 + (len(faces) > FINE) + 2 * (len(faces) > VERY_FINE)
    points = vertices.astype(np.float64)
    normals = _normals(points, faces)
    for view in range(views):
        yaw = 2 * math.pi * (view + 0.5) / views
        along = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        across = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        aside = points @ across
        corners = aside[faces[:, 0]], aside[faces[:, 1]], aside[faces[:, 2]]
        starts, ends = reduce(np.minimum, corners), reduce(np.maximum, corners)
        for down in (0.0, 0.35, 0.7):
            if closed:
                seen = normals @ (math.cos(down) * along + np.array([0, 0, -math.sin(down)])) < 0
                worst = max(worst, overlap(starts[seen], ends[seen]))
            elif down == 0.0:  # the tilt matters only for which triangles face the sonar
                worst = max(worst, overlap(starts, ends))
    return math.ceil(worst * 1.15)


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals (face, 3) of triangles, not normalised."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def deepest_overlap(starts: np.ndarray, ends: np.ndarray) -> int:
    """Largest number of open intervals (start, end) that share a point."""
    starts, ends = np.sort(starts), np.sort(ends)
    # At a shared corner, one interval ends before the next one starts.
    open_there = np.arange(1, len(starts) + 1) - np.searchsorted(ends, starts, side="right")
    return int(open_there.max(initial=0))


def _overlap_by_bins(starts: np.ndarray, ends: np.ndarray) -> int:
    """As `deepest_overlap`, counted in bins without a sort: never too few, and at most a few per cent too many."""
    if len(starts) == 0:
        return 0
    low, high = starts.min(), ends.max()
    scale = (BINS - 1) / max(high - low, 1e-30)
    first, last = (((values - low) * scale).astype(np.int64) for values in (starts, ends))
    change = np.bincount(first, minlength=BINS)
    change[1:] -= np.bincount(last, minlength=BINS)[:-1]
    return int(np.cumsum(change).max())


def most_front(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], directions: int = 256) -> int:
    """Most triangles of a closed surface that face a distant point, over sampled directions, plus 10 %.

    Vertices (vertex, 3) [m]. The directions lie on a Fibonacci spiral over the sphere, which covers any roll and pitch.
    """
    some = faces
    if len(faces) > 2 * FINE:  # drawn, for every so many-th triangle of a regular mesh may look the same way
        some = faces[np.random.default_rng(0).choice(len(faces), FINE, replace=False)]
    normals = _normals(vertices.astype(np.float64), some)
    k = np.arange(directions) + 0.5
    z, angle = 1 - 2 * k / directions, math.pi * (1 + 5**0.5) * k
    planar = np.sqrt(1 - z * z)
    towards = np.stack([planar * np.cos(angle), planar * np.sin(angle), z])
    step = max(1, PAIRS_AT_ONCE // len(some))  # all directions at once would take gigabytes for a fine mesh
    seen = [(normals @ towards[:, k : k + step] > 0).sum(axis=0).max() for k in range(0, directions, step)]
    return min(math.ceil(int(max(seen)) * 1.1 * len(faces) / len(some)), len(faces))


def has_crossing_triangles(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> bool:
    """True if an edge of the surface passes through the inside of one of its triangles (Möller and Trumbore, 1997).

    Bodies that merely touch, such as bricks in a pile, do not cross. Vertices (vertex, 3) are in metres.
    """
    points = vertices.astype(np.float64)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    step = max(1, PAIRS_AT_ONCE // len(faces))
    a, ab, ac = points[faces[:, 0]], *(points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
    normal = np.cross(ab, ac)
    for first in range(0, len(edges), step):
        start, end = (points[edges[first : first + step, k]][:, None] for k in (0, 1))  # (edge, 1, xyz)
        direction = end - start
        slope = (direction * normal).sum(-1)  # (edge, face)
        flat = np.abs(slope) < 1e-9 * np.sqrt((direction**2).sum(-1) * (normal**2).sum(-1))
        slope = np.where(flat, 1.0, slope)
        from_corner = start - a
        along = -(from_corner * normal).sum(-1) / slope
        turned = np.cross(direction, from_corner)
        u, v = (turned * ac).sum(-1) / slope, -(turned * ab).sum(-1) / slope
        inside = (np.minimum(u, v) > INSIDE) & (u + v < 1 - INSIDE) & (along > INSIDE) & (along < 1 - INSIDE)
        if (inside & ~flat).any():
            return True
    return False
