"""Measure on the host, once for each mesh, what vertical slices can meet: how many triangles, and if they cross."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
from jaxtyping import Float, Int

INSIDE = 1e-4  # triangles must pass through each other by this share of their size: bodies that only touch do not cross
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
    """True if two triangles of the surface pass through each other (Möller, 1997, J. Graphics Tools 2(2)).

    They do if each has corners on both sides of the other's plane, and if both meet the planes' common line in one
    stretch. Bodies that merely touch, such as bricks in a pile, do not cross. Vertices (vertex, 3) are in metres.
    """
    corners = vertices.astype(np.float64)[faces]  # (face, corner, xyz)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    offsets = (normals * corners[:, 0]).sum(axis=1)
    sizes = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    straddles = _straddles(corners, sizes, normals, offsets)
    first, second = np.nonzero(np.triu(straddles & straddles.T))
    line = np.cross(normals[first], normals[second])
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-30)
    starts, ends = zip(
        _stretch(corners[first], normals[second], offsets[second], line),
        _stretch(corners[second], normals[first], offsets[first], line),
        strict=True,
    )
    shared = np.minimum(*ends) - np.maximum(*starts)
    return bool((shared > INSIDE * np.minimum(sizes[first], sizes[second])).any())


def _straddles(corners: np.ndarray, sizes: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Whether each triangle has corners on both sides of the plane of each other one (face, face)."""
    away = np.stack([corners[:, k] @ normals.T for k in range(3)]) - offsets  # (corner, face, other face)
    return np.minimum(-away.min(axis=0), away.max(axis=0)) > INSIDE * sizes[:, None]


def _stretch(
    corners: np.ndarray, normals: np.ndarray, offsets: np.ndarray, line: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where triangles (pair, corner, 3) meet planes: the two ends (pair,) along the directions `line` (pair, 3)."""
    away = np.einsum("pcx,px->pc", corners, normals) - offsets[:, None]
    along = np.einsum("pcx,px->pc", corners, line)
    next_away, next_along = np.roll(away, -1, axis=1), np.roll(along, -1, axis=1)
    meets = (away * next_away <= 0) & (away != next_away)  # (pair, edge)
    at = along + (next_along - along) * away / np.where(meets, away - next_away, 1.0)
    return np.where(meets, at, np.inf).min(axis=1), np.where(meets, at, -np.inf).max(axis=1)
