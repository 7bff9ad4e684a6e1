"""What each of several objects shows and hides, held to Embree's rays: whose triangle each of them hits first."""

from __future__ import annotations

import importlib.util
import math
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import sonarjax as sj
from sonarjax.data.layout import Layout, join_layout
from sonarjax.render import RenderQuality, Window
from sonarjax.render.window import render_objects

pytest.importorskip("embreex")
_spec = importlib.util.spec_from_file_location("render_embree_objects", Path(__file__).with_name("embree.py"))
embree = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(embree)

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20)).replace(n_ranges=256)
QUALITY = RenderQuality(sub_beams=4)
# The second stands in the first one's shadow and is taller; the third is beside them.
PLACES = ((2.3, 0.0, 0.3), (2.75, 0.05, 1.2), (2.5, 0.45, 2.0))


def layers_by_embree(mesh: trimesh.Trimesh, owner: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Highlight and shadow (object, range, beam) of triangles with these owners, in the sonar frame."""
    bounds, reach = np.asarray(SONAR.azimuth_edges, np.float64), float(SONAR.elevation_aperture) / 2
    cell, step = 2 * reach / 2048, float(SONAR.range_bin)
    elevation = -reach + cell * (np.arange(2048) + 0.5)
    corners = np.append(elevation - cell / 2, elevation[-1] + cell / 2)
    shown, hidden = np.zeros((2, count, *SONAR.shape))
    tracer, parts = embree.RayMeshIntersector(mesh), 8
    for beam in range(SONAR.n_beams):
        azimuth = bounds[beam] + (bounds[beam + 1] - bounds[beam]) * (np.arange(parts) + 0.5) / parts
        rays = embree.directions(azimuth, elevation)
        flat = rays.reshape(-1, 3)
        face = tracer.intersects_first(np.zeros_like(flat), flat).reshape(rays.shape[:-1])
        hit, floor = embree.first_hits(mesh, rays), embree.floor_range(rays, SONAR)
        whose = np.where((face >= 0) & (hit <= floor), owner[np.maximum(face, 0)], -1)
        ends = embree.floor_range(embree.directions(azimuth, corners), SONAR)
        for k in range(parts):
            for one in np.unique(whose[k][whose[k] >= 0]):
                own = whose[k] == one
                near, far = embree.runs(np.where(own, hit[k], np.inf), step)
                shown[one, :, beam] += embree.covered(near, far, SONAR) / parts
                hidden[one, :, beam] += embree.covered(ends[k, :-1][own], ends[k, 1:][own], SONAR) / parts
    return shown, hidden


@pytest.mark.slow
def test_objects_are_told_apart_as_embree_does() -> None:
    tall = sj.Mesh.from_arrays(*sj.objects.box((0.2, 0.2, 0.35), (0.0, 0.0, 0.175)))
    meshes = sj.stack_meshes([sj.objects.target(), tall])
    x, y, yaw = (jnp.array(v) for v in zip(*PLACES, strict=True))
    layout = Layout(jnp.array([0, 1, 0]), sj.Pose(x, y, yaw), jnp.ones(3, bool))
    mesh, objects = join_layout(meshes, layout, room=2)
    frame, layers = jax.jit(
        lambda: render_objects(mesh, objects, sj.Pose(), SONAR, Window(0, 0, SONAR.shape), QUALITY, True)
    )()
    assert int(frame.overflow) == 0
    faces, owner = np.asarray(mesh.faces), np.asarray(objects.owner)
    real = faces[:, 0] != faces[:, 1]
    placed = embree.to_sonar_frame(np.asarray(mesh.vertices, np.float64), SONAR)
    surface = trimesh.Trimesh(placed, faces[real], process=False)
    for ours, theirs in zip(layers, layers_by_embree(surface, owner[real], 3), strict=True):
        for k in range(3):
            mine, other = np.asarray(ours[k]) > 0.5, theirs[k] > 0.5
            assert other.sum() > 30
            assert (mine & other).sum() / (mine | other).sum() > 0.9
            assert np.abs(np.asarray(ours[k]) - theirs[k]).sum() < 0.1 * theirs[k].sum()
    # Together they are what the frame shows.
    for whole, parts in ((frame.highlight, layers.highlight), (frame.shadow, layers.shadow)):
        np.testing.assert_allclose(np.clip(parts.sum(0), 0, 1), whole, atol=0.05)


@pytest.mark.parametrize("painted", [0, 1])
def test_each_object_of_a_scene_keeps_its_own_reflectivity(painted: int) -> None:
    """One object that sends back half as much, in front of the other or behind it: only its own pixels change."""
    mesh = sj.objects.brick()
    dim = replace(mesh, reflectivity=jnp.full(mesh.n_faces, 0.5))
    poses = [sj.Pose(2.2, -0.3, 0.4), sj.Pose(2.5, 0.35, 1.0)]
    meshes = [dim if k == painted else mesh for k in range(2)]
    plain, seen = (sj.render(scene, poses, SONAR) for scene in ([mesh, mesh], meshes))
    alone = [np.asarray(sj.render(mesh, pose, SONAR).highlight) > 0.999 for pose in poses]
    ratio = np.asarray(seen.intensity) / np.maximum(np.asarray(plain.intensity), 1e-12)
    for k in range(2):
        assert alone[k].sum() > 20
        if k == painted:  # the rest of a bin's energy comes from the floor before the object
            assert np.median(ratio[alone[k]]) == pytest.approx(0.5, abs=1e-3) and ratio[alone[k]].max() < 0.7
        else:
            assert ratio[alone[k]] == pytest.approx(1.0, rel=1e-3)  # float32, in another order on one core
