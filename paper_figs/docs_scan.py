"""The drawing of docs/renderer.md: a scan, what is left of it for a sonar, and both as the sonar sees them.

`python -m paper_figs.docs_scan` writes paper_figs/drawn/docs_scan.png. Mesh and frames are the package's own.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from experiments.bench_mesh import X_M, scan
from experiments.bench_render import make_sonar
from paper_figs import style
from sonarjax.render import reduced_for, render
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.reduce import real_arrays

TRIANGLES = 40_000
LIGHT = np.array([0.45, -0.6, 0.66])
PART_M = (-0.03, 0.07, 0.12, 0.22)
"""The part of the side view that is drawn large: y from and to, z from and to [m]."""


def draw() -> Figure:
    """Part of the scan and of the reduced mesh, their labels, and where these differ."""
    sonar = make_sonar()
    full = Mesh.from_arrays(*scan(TRIANGLES, np.random.default_rng([0, TRIANGLES])), name="scan")
    found = reduced_for(full, sonar)
    labels = [np.asarray(render(mesh, Pose(x=X_M), sonar).labels()) for mesh in (full, found.mesh)]
    figure = style.sheet(style.TWO_COLUMNS, 2.9)
    panels = figure.subplots(1, 5, width_ratios=(1.35, 1.35, 1, 1, 1))
    for panel, mesh in zip(panels[:2], (full, found.mesh), strict=True):
        _draw_part(panel, *real_arrays(mesh))
        panel.set_title(f"{len(real_arrays(mesh)[1]):,} triangles")
    for panel, image, name in zip(panels[2:4], labels, ("scan", "reduced"), strict=True):
        _draw_labels(panel, np.choose(image, [0.5, 1.0, 0.0]), name)
    _draw_labels(panels[4], np.where(labels[0] == labels[1], 0.85, 0.0), "differences")
    style.letters(panels)
    return figure


def _draw_part(ax: Axes, vertices: np.ndarray, faces: np.ndarray) -> None:
    """The triangles that look along −x, as they are seen from there, in `PART_M`."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shade = 0.35 + 0.6 * np.clip(normal @ (LIGHT * [-1, 1, 1]), 0, 1)
    seen = np.flatnonzero(normal[:, 0] < 0)
    seen = seen[np.argsort(-corners[seen].mean(axis=1)[:, 0])]  # the farthest first
    tints = np.repeat(shade[seen, None], 3, axis=1)
    shown = PolyCollection(corners[seen][..., 1:], facecolors=tints, edgecolors=style.BLACK, linewidths=0.15)
    shown.set_rasterized(True)
    ax.add_collection(shown)
    ax.set(xlim=PART_M[:2], ylim=PART_M[2:], aspect="equal")
    style.bare(ax)


def _draw_labels(ax: Axes, image: np.ndarray, name: str) -> None:
    rows, columns = slice(100, 420), slice(16, 80)
    ax.imshow(image[rows, columns], cmap="gray", vmin=0, vmax=1, origin="lower", aspect="auto", interpolation="nearest")
    ax.set_title(name)
    style.bare(ax)


def main() -> None:
    """Write the drawing."""
    style.write_drawings({"docs_scan": draw})


if __name__ == "__main__":
    main()
