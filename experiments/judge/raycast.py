"""Embree rays from the sonar head at one object on the floor z = 0: direct echoes, and echoes by way of the floor.

The floor's part is closed form, so rays are traced only where the object may be. Multipath is the image method: a path
that touches the floor on both ways is as long as to the object's mirror image below the floor, and one that touches it
on one way is the mean of the two (Urick, Principles of Underwater Sound, 1983, ch. 5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from experiments.judge.view import View

NONE, FLOOR, OBJECT = 0, 1, 2
"""What a ray meets first."""
VISIBLE_WITHIN_M = 5e-4
"""A point counts as seen when nothing lies nearer than this before it [m]; Embree works in float32."""


@dataclass(frozen=True)
class Paths:
    """Echo paths by way of the object, one entry each (path,)."""

    column: np.ndarray
    """Sub-beam."""
    length: np.ndarray
    """Slant range at which the device shows the path: half the way there and back [m]."""
    near: np.ndarray
    """Length of the leg other than the traced one [m]: the spreading of power that solid angle does not hold."""
    cos_in: np.ndarray
    """Cosine of incidence of the traced leg [1]."""
    cos_out: np.ndarray
    """Cosine of incidence of the other leg [1]."""
    cos_half: np.ndarray
    """Cosine between the normal and the bisector of both legs [1]: 1 where a mirror would send the sound back."""
    elevation_in: np.ndarray
    """Elevation of the traced leg at the sonar, above the beam axis [rad]."""
    elevation_out: np.ndarray
    """Elevation of the other leg [rad]."""
    solid_angle: np.ndarray
    """Solid angle of the ray [sr]."""


@dataclass(frozen=True)
class Hits:
    """What the rays meet. Rows are sines of depression, near floor to far (ray,); columns are sub-beams (sub,)."""

    view: View
    """The geometry."""
    sine: np.ndarray
    """Sine of depression (ray,); the first `view.n_ranges · SAMPLES` rows meet the floor at `view.sample_ranges`."""
    elevation: np.ndarray
    """Elevation above the beam axis (ray, sub) [rad]."""
    solid_angle: np.ndarray
    """Solid angle (ray, sub) [sr]."""
    kind: np.ndarray
    """`NONE`, `FLOOR` or `OBJECT` (ray, sub), whichever is met first."""
    distance: np.ndarray
    """Slant range of what is met first (ray, sub) [m]; infinite for none."""
    cosine: np.ndarray
    """Cosine of incidence there (ray, sub) [1]; 0 for none."""
    one_bounce: Paths
    """By way of the floor on one of the two ways."""
    two_bounces: Paths
    """By way of the floor on both ways."""

    def direct(self) -> Paths:
        """The direct echoes of the object."""
        row, column = np.nonzero(self.kind == OBJECT)
        r, c, e = (values[row, column] for values in (self.distance, self.cosine, self.elevation))
        return Paths(column, r, r, c, c, c, e, e, self.solid_angle[row, column])


class Body:
    """A surface in the water as an Embree scene whose origin is the sonar head."""

    def __init__(self, triangles: np.ndarray) -> None:
        """`triangles` (face, corner, 3) [m] from the sonar head."""
        self._triangles = np.ascontiguousarray(triangles, np.float32)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, self._triangles)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        self._normals = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    def trace(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (ray,) [m], infinite for a miss, and normal (ray, 3) of what `directions` (ray, 3) meet first."""
        rays = np.ascontiguousarray(directions, np.float32)
        found = self._scene.run(np.zeros_like(rays), rays, query="INTERSECT", output=True)
        face = found["primID"]
        return np.where(face >= 0, found["tfar"], np.inf), self._normals[np.maximum(face, 0)]


def place(vertices: np.ndarray, faces: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """Triangles (face, corner, 3) [m] in the ground frame: turned by `yaw` [rad] about the vertical, then moved [m]."""
    c, s = np.cos(yaw), np.sin(yaw)
    moved = vertices @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [x, y, 0.0]
    return moved[faces]


def cast(triangles: np.ndarray, view: View) -> Hits:
    """Trace all rays of `view` at `triangles` (face, corner, 3) [m] in the ground frame; none of them is bare floor."""
    sine = _sines(view, triangles)
    elevation = view.elevation(sine)
    shape = elevation.shape
    solid_angle = view.solid_angle(sine, elevation)
    down = sine > 0
    floor_range = np.where(down, view.height / np.where(down, sine, 1.0), np.inf)
    kind = np.repeat(np.where(down, FLOOR, NONE).astype(np.uint8)[:, None], shape[1], axis=1)
    distance = np.repeat(floor_range.astype(np.float32)[:, None], shape[1], axis=1)
    cosine = np.repeat(np.maximum(sine, 0).astype(np.float32)[:, None], shape[1], axis=1)
    no_paths = Paths(np.zeros(0, np.int64), *(np.zeros(0) for _ in range(8)))
    hits = Hits(view, sine, elevation, solid_angle, kind, distance, cosine, no_paths, no_paths)
    if len(triangles) == 0:
        return hits
    head = np.array([0.0, 0.0, view.height])
    body = Body(triangles - head)
    rows, columns = _part(view, sine, triangles)
    rays = view.directions(elevation[rows, columns], columns)
    found, normal = (values.reshape(*rays.shape[:2], -1) for values in body.trace(rays.reshape(-1, 3)))
    hit = found[..., 0] < distance[rows, columns]
    kind[rows, columns][hit] = OBJECT
    distance[rows, columns][hit] = found[..., 0][hit]
    cosine[rows, columns][hit] = np.abs((normal * rays).sum(-1))[hit]
    one, two = _bounces(hits, triangles, body)
    return replace(hits, one_bounce=one, two_bounces=two)


def _bounces(hits: Hits, triangles: np.ndarray, body: Body) -> tuple[Paths, Paths]:
    """Paths that touch the floor once, and twice: rays that meet the floor first go on to the mirror image."""
    view, flip = hits.view, np.array([1.0, 1.0, -1.0])
    mirrored = triangles * flip
    rows, columns = _part(view, hits.sine, mirrored)
    row, column = np.nonzero(hits.kind[rows, columns] == FLOOR)
    rays = view.directions(hits.elevation[rows, columns], columns)[row, column]
    far, normal = Body(mirrored - [0.0, 0.0, view.height]).trace(rays)
    row, column = row + rows.start, column + columns.start
    met = np.isfinite(far)
    row, column, rays, far, normal = row[met], column[met], rays[met], far[met], normal[met]
    cos_in, high = np.abs((normal * rays).sum(-1)), hits.elevation[row, column]
    weight = hits.solid_angle[row, column]
    two = Paths(column, far, far, cos_in, cos_in, cos_in, high, high, weight)
    # The same points of the real object, seen from the head: unmirror them in the floor, which lies `height` below it.
    point = rays * far[:, None] * flip - [0.0, 0.0, 2 * view.height]
    near = np.linalg.norm(point, axis=1)
    toward = point / near[:, None]
    seen = body.trace(toward)[0] > near - VISIBLE_WITHIN_M
    real, arriving = normal * flip, rays * flip
    both = toward + arriving
    half = np.abs((real * both).sum(-1)) / np.maximum(np.linalg.norm(both, axis=1), 1e-6)
    seen &= (real * toward).sum(-1) * (real * arriving).sum(-1) > 0  # both legs on one side of the face
    cos_out = np.abs((real * toward).sum(-1))
    level, down = np.cos(view.tilt), np.sin(view.tilt)
    over = np.arcsin(np.clip(toward[:, 2] * level + toward[:, 0] * down, -1, 1))
    one = Paths(column, (near + far) / 2, near, cos_in, cos_out, half, high, over, weight)
    return Paths(*(values[seen] for values in vars(one).values())), two


def _sines(view: View, triangles: np.ndarray) -> np.ndarray:
    """Sines of depression (ray,): one ray for each range sample on the floor, and more up to the object's top."""
    sine = view.height / view.sample_ranges
    if np.any(sine > 1):
        raise ValueError(
            f"the window begins at {view.range_min:.2f} m, nearer than the floor {view.height:.2f} m below"
        )
    if len(triangles) == 0:
        return sine
    lowest, _ = _sine_span(view, triangles)
    step = sine[-2] - sine[-1]
    return np.concatenate([sine, np.arange(sine[-1] - step, lowest - step, -step)])


def _sine_span(view: View, triangles: np.ndarray) -> tuple[float, float]:
    """Least and greatest sine of depression that a triangle may have, on the safe side."""
    at = np.linspace(0, 1, 9)[:, None, None, None]
    along = (triangles * (1 - at) + np.roll(triangles, 1, axis=1) * at)[..., :2]
    away = np.linalg.norm(along, axis=-1)
    nearest, farthest = 0.98 * away.min(), away.max()  # the 2 %: edges are only sampled
    drops = view.height - np.array([triangles[..., 2].min(), triangles[..., 2].max()])
    sines = [d / np.hypot(d, a) for d in drops for a in (nearest, farthest)]
    return min(sines), max(sines)


def _part(view: View, sine: np.ndarray, triangles: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the rays that may meet `triangles`."""
    low, high = _sine_span(view, triangles)
    rows = slice(int(np.searchsorted(-sine, -high)), int(np.searchsorted(-sine, -low, "right")))
    points = triangles.reshape(-1, 3) - [0.0, 0.0, view.height]
    level, down = np.cos(view.tilt), np.sin(view.tilt)
    ahead = points[:, 0] * level - points[:, 2] * down
    up = points[:, 2] * level + points[:, 0] * down
    azimuth = np.arctan2(points[:, 1], np.hypot(ahead, up) if view.conical else ahead)
    slack = 2 * view.sub_width.max() + (0.003 if view.conical else 0.0)  # [rad]: on a cone, edges bend outwards
    columns = np.searchsorted(view.sub_azimuth, [azimuth.min() - slack, azimuth.max() + slack])
    return rows, slice(int(columns[0]), int(columns[1]))
