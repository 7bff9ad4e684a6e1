"""Which way the triangles of a closed surface face: outward, and inward around a cavity."""

from __future__ import annotations

import math

import numpy as np
import trimesh
from jaxtyping import Float


def turn_outward(surface: trimesh.Trimesh) -> None:
    """Wind the triangles of a closed surface so that their normals point out of the material, in place.

    trimesh's `fix_normals` turns every body outward, cavities too, and takes seconds for a scan of 500,000 triangles.
    """
    trimesh.repair.fix_winding(surface)
    body = trimesh.graph.connected_component_labels(surface.face_adjacency, node_count=len(surface.faces))
    volumes = np.bincount(body, weights=signed_volumes(surface.triangles, surface.centroid))
    inward = ((volumes < 0) != _cavities(surface.triangles, body, volumes))[body]
    if inward.any():
        faces = np.array(surface.faces)
        faces[inward] = faces[inward][:, ::-1]
        surface.faces = faces


def signed_volumes(
    triangles: Float[np.ndarray, "triangle 3 3"], middle: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "triangle"]:
    """Volumes (triangle,) [m³] between triangles (triangle, 3, 3) [m] and a point; negative if one faces the point."""
    a, b, c = np.moveaxis(triangles - middle, 1, 0)
    return (np.cross(a, b) * c).sum(axis=1) / 6


def _cavities(triangles: np.ndarray, body: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """Which bodies (body,) are cavities: inside a body that is none, and wound the other way than that one.

    `body` numbers the body of each triangle. A body inside another that is wound alike is a part of its own, such as a
    shaft in its housing.
    """
    cavity = np.zeros(len(volumes), bool)
    if len(volumes) == 1:
        return cavity
    order = np.argsort(body, kind="stable")
    parts = np.split(triangles[order], np.cumsum(np.bincount(body))[:-1])
    low, high = (np.array([end(part, axis=(0, 1)) for part in parts]) for end in (np.min, np.max))
    for one in np.argsort(-np.abs(volumes), kind="stable"):  # the outer before the inner
        around = np.flatnonzero(((low < low[one]) & (high > high[one])).all(axis=1))
        holders = [other for other in around if _holds(parts[other], parts[one][0, 0])]
        if holders:
            nearest = min(holders, key=lambda other: abs(volumes[other]))
            cavity[one] = not cavity[nearest] and volumes[one] * volumes[nearest] < 0
    return cavity


def _holds(triangles: np.ndarray, point: np.ndarray) -> bool:
    """Whether a closed surface (triangle, 3, 3) holds a point (3,), by the solid angle it fills as seen from there.

    Source: van Oosterom and Strackee, The solid angle of a plane triangle, 1983.
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    far = [np.linalg.norm(side, axis=1) for side in (a, b, c)]
    dots = [(p * q).sum(axis=1) for p, q in ((b, c), (c, a), (a, b))]
    below = far[0] * far[1] * far[2] + sum(dot * length for dot, length in zip(dots, far, strict=True))
    angle = 2 * np.arctan2((np.cross(a, b) * c).sum(axis=1), below).sum()
    return bool(abs(angle) > 3 * math.pi)  # 4π inside, 2π on the surface, 0 outside
