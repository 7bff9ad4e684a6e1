"""Labels and energies from dense Embree rays, written without a line of the renderer: the reference of these tests."""

import math

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

SUB_AZIMUTHS = 4
ELEVATIONS = 1024
SAME_RUN_BINS = 0.5  # neighbouring rays whose ranges differ by less belong to one run


def to_sonar_frame(points, sonar):
    """Ground points (..., 3) in the sonar frame: the head at the origin, x along the tilted axis (no roll)."""
    t = float(sonar.tilt)
    moved = points - np.array([0.0, 0.0, float(sonar.height)])
    rotation = np.array([[math.cos(t), 0, math.sin(t)], [0, 1, 0], [-math.sin(t), 0, math.cos(t)]])
    return moved @ rotation


def placed(mesh, x, y, yaw, sonar):
    """The mesh standing on the floor at (x, y), turned by yaw, as a trimesh in the sonar frame."""
    c, s = math.cos(yaw), math.sin(yaw)
    vertices = np.asarray(mesh.vertices, np.float64) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [x, y, 0.0]
    faces = np.asarray(mesh.faces)
    faces = faces[faces[:, 0] != faces[:, 1]]
    return trimesh.Trimesh(to_sonar_frame(vertices, sonar), faces, process=False)


def directions(azimuth, elevation):
    """Unit rays (azimuth, elevation, 3)."""
    a, e = azimuth[:, None], elevation[None]
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e) + 0 * a], -1)


def first_hits(surface, rays):
    """Distance of the first hit of rays (..., 3) from the head, inf for none: Embree's triangle, our plane."""
    flat = rays.reshape(-1, 3)
    face = RayMeshIntersector(surface).intersects_first(np.zeros_like(flat), flat)
    corner = surface.triangles[np.maximum(face, 0)]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    distance = (normal * corner[:, 0]).sum(1) / (normal * flat).sum(1)
    return np.where(face >= 0, distance, np.inf).reshape(rays.shape[:-1])


def floor_range(rays, sonar):
    """Distance of the floor along rays (..., 3), inf above the horizon."""
    t = float(sonar.tilt)
    down = rays[..., 0] * math.sin(t) - rays[..., 2] * math.cos(t)
    return np.where(down > 1e-9, float(sonar.height) / np.maximum(down, 1e-9), np.inf)


def labels(mesh, x, y, yaw, sonar):
    """Labels (range, beam) and the shares h and s they come from."""
    surface = placed(mesh, x, y, yaw, sonar)
    bounds = np.asarray(sonar.azimuth_edges, np.float64)
    step = float(sonar.range_bin)
    bearing = np.arctan2(surface.vertices[:, 1], surface.vertices[:, 0])
    height = np.arctan2(surface.vertices[:, 2], np.hypot(surface.vertices[:, 0], surface.vertices[:, 1]))
    reach = float(sonar.elevation_aperture) / 2
    low, high = max(height.min() - 1e-3, -reach), min(height.max() + 1e-3, reach)
    cell = (high - low) / ELEVATIONS
    elevation = low + cell * (np.arange(ELEVATIONS) + 0.5)
    h, s = np.zeros(sonar.shape), np.zeros(sonar.shape)
    beams = np.flatnonzero((bounds[1:] > bearing.min()) & (bounds[:-1] < bearing.max()))
    for beam in beams:
        part = (np.arange(SUB_AZIMUTHS) + 0.5) / SUB_AZIMUTHS
        azimuth = bounds[beam] + (bounds[beam + 1] - bounds[beam]) * part
        hit = first_hits(surface, directions(azimuth, elevation))
        # An elevation cell hides the floor between its own two ends.
        ends = floor_range(directions(azimuth, np.append(elevation - cell / 2, elevation[-1] + cell / 2)), sonar)
        hit[hit > floor_range(directions(azimuth, elevation), sonar)] = np.inf
        for k in range(SUB_AZIMUTHS):
            h[:, beam] += covered(*runs(hit[k], step), sonar) / SUB_AZIMUTHS
            solid = np.isfinite(hit[k])
            s[:, beam] += covered(ends[k, :-1][solid], ends[k, 1:][solid], sonar) / SUB_AZIMUTHS
    shares = np.stack([(1 - h) * (1 - s), h, s * (1 - h)])
    return shares.argmax(0), h, s


def runs(hit, step):
    """Nearest and farthest range of each visible run of one ray fan, none shorter than a bin."""
    solid = np.flatnonzero(np.isfinite(hit))
    if len(solid) == 0:
        return np.zeros(0), np.zeros(0)
    breaks = np.flatnonzero((np.diff(solid) > 1) | (np.abs(np.diff(hit[solid])) > SAME_RUN_BINS * step)) + 1
    chains = np.split(hit[solid], breaks)
    near, far = np.array([c.min() for c in chains]), np.array([c.max() for c in chains])
    half = np.maximum(far - near, step) / 2
    return (near + far) / 2 - half, (near + far) / 2 + half


def covered(near, far, sonar):
    """Share (range,) of each bin that the intervals cover, at most 1."""
    edges = float(sonar.range_min) + float(sonar.range_bin) * np.arange(sonar.n_ranges + 1)
    ramps = np.clip(edges[:, None] - near, 0.0, np.maximum(far - near, 0.0)).sum(1)
    return np.clip(np.diff(ramps) / float(sonar.range_bin), 0.0, 1.0)


def energy(mesh, x, y, yaw, sonar, elevations=2048, sub_azimuths=64):
    """The beams that see the object, and their energy (range, beam): every ray's Δφ/r² dropped into the bin it hits."""
    surface = placed(mesh, x, y, yaw, sonar)
    bounds = np.asarray(sonar.azimuth_edges, np.float64)
    reach = float(sonar.elevation_aperture) / 2
    cell = 2 * reach / elevations
    elevation = -reach + cell * (np.arange(elevations) + 0.5)
    edges = float(sonar.range_min) + float(sonar.range_bin) * np.arange(sonar.n_ranges + 1)
    out = np.zeros(sonar.shape)
    bearing = np.arctan2(surface.vertices[:, 1], surface.vertices[:, 0])
    beams = np.flatnonzero((bounds[1:] > bearing.min()) & (bounds[:-1] < bearing.max()))
    for beam in beams:
        azimuth = bounds[beam] + (bounds[beam + 1] - bounds[beam]) * (np.arange(sub_azimuths) + 0.5) / sub_azimuths
        rays = directions(azimuth, elevation)
        distance = np.minimum(first_hits(surface, rays), floor_range(rays, sonar)).ravel()
        out[:, beam] = np.histogram(distance, edges, weights=cell / distance**2 / sub_azimuths)[0]
    return beams, out[:, beams]
