"""Meshes as shaded solids: an orthographic picture by the painter's algorithm, on a floor with a grid of 0.1 m."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from paper_figs import style

AZIMUTH, ELEVATION = math.radians(-60.0), math.radians(28.0)
LIGHT = np.array([0.15, -0.5, 0.85])
PIECE_M = 0.012  # triangles are cut down to this length, so that sorting them by depth is right
SHARP = math.cos(math.radians(35.0))  # faces that meet at less of an angle share no drawn edge
GRID_M = 0.1


def draw_solid(
    ax: Axes, vertices: np.ndarray, faces: np.ndarray, color: str = style.ORANGE, reach: float = 0.2
) -> None:
    """Draw a mesh, vertices (vertex, 3) [m] and faces (face, 3), standing on a floor of ±`reach` [m]."""
    _floor(ax, reach)
    right, up, towards = _axes()
    corners = vertices[faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shown = normals @ towards > 0
    shade = 0.45 + 0.55 * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    base = np.array([int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    polygons, colors, depth = [], [], []
    for triangle, value in zip(corners[shown], shade[shown], strict=True):
        for piece in _pieces(triangle):
            polygons.append(piece)
            colors.append(base * value)
            depth.append((piece @ towards).mean())
    for edge in _edges(vertices, faces, normals, shown):
        count = max(1, math.ceil(np.linalg.norm(edge[1] - edge[0]) / PIECE_M))
        way = edge[0] + np.linspace(0, 1, count + 1)[:, None] * (edge[1] - edge[0])
        for first, second in pairwise(way):
            polygons.append(np.stack([first, second]))
            colors.append(np.zeros(3))
            depth.append(float((first + second) @ towards / 2) + PIECE_M)  # before the faces that meet in it
    order = np.argsort(depth)
    flat = [np.stack([polygons[k] @ right, polygons[k] @ up], axis=1) for k in order]
    tints = [colors[k] for k in order]
    ax.add_collection(PolyCollection(flat, facecolors=tints, edgecolors=tints, linewidths=0.5, rasterized=True))
    ax.set_aspect("equal")
    style.bare(ax)
    tips = vertices @ np.stack([right, up], axis=1)
    ax.set_ylim(top=max(ax.get_ylim()[1], tips[:, 1].max() + 0.02))


def _axes() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (3,) to the right, up, and towards the viewer."""
    c, s = math.cos(AZIMUTH), math.sin(AZIMUTH)
    ce, se = math.cos(ELEVATION), math.sin(ELEVATION)
    return np.array([-s, c, 0]), np.array([-c * se, -s * se, ce]), np.array([c * ce, s * ce, se])


def _floor(ax: Axes, reach: float) -> None:
    right, up, _ = _axes()

    def flat(x: float, y: float) -> tuple[float, float]:
        point = np.array([x, y, 0.0])
        return float(point @ right), float(point @ up)

    for line in np.arange(-round(reach / GRID_M), round(reach / GRID_M) + 1) * GRID_M:
        for ends in (((line, -reach), (line, reach)), ((-reach, line), (reach, line))):
            ax.plot(*zip(*(flat(*end) for end in ends), strict=True), color=style.LIGHT, linewidth=0.6, zorder=0)
    start, tip = flat(reach, 0.0), flat(reach + 0.8 * GRID_M, 0.0)
    ax.annotate("x", xy=start, xytext=tip, color=style.GREY, ha="center", va="center",
                arrowprops={"arrowstyle": "<-", "color": style.GREY, "linewidth": 0.8})  # fmt: skip
    corners = np.array([flat(x, y) for x in (-reach, reach) for y in (-reach, reach)])
    ax.set_xlim(corners[:, 0].min() - 0.03, max(corners[:, 0].max(), tip[0]) + 0.03)
    ax.set_ylim(corners[:, 1].min() - 0.02, corners[:, 1].max() + 0.02)


def _pieces(triangle: np.ndarray) -> list[np.ndarray]:
    """A triangle (3, 3) [m] cut until no side is longer than PIECE_M."""
    lengths = np.linalg.norm(triangle - np.roll(triangle, -1, axis=0), axis=1)
    longest = int(lengths.argmax())
    if lengths[longest] <= PIECE_M:
        return [triangle]
    a, b, c = (triangle[(longest + k) % 3] for k in range(3))
    middle = (a + b) / 2
    return _pieces(np.stack([a, middle, c])) + _pieces(np.stack([middle, b, c]))


def _edges(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, shown: np.ndarray) -> list[np.ndarray]:
    """Edges (2, 3) [m] where faces meet at an angle, at least one of them turned to the viewer; outlines too."""
    sides: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(faces):
        for first, second in zip(face, np.roll(face, -1), strict=True):
            sides.setdefault((min(first, second), max(first, second)), []).append(number)
    drawn = []
    for (first, second), near in sides.items():
        outline = len({bool(shown[k]) for k in near}) == 2 or len(near) == 1
        sharp = len(near) == 2 and normals[near[0]] @ normals[near[1]] < SHARP
        if (outline or sharp) and any(shown[k] for k in near):
            drawn.append(vertices[[first, second]].astype(float))
    return drawn
