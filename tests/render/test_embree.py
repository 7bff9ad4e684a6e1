"""The renderer against Embree: labels over 3 meshes × 20 poses, and where the energy of each ray lands."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from sonarjax.render import render
from sonarjax.scene import Pose, objects
from sonarjax.sonar import Sonar

pytest.importorskip("embreex")
_spec = importlib.util.spec_from_file_location("render_embree", Path(__file__).with_name("embree.py"))
embree = importlib.util.module_from_spec(_spec)  # loaded by place: --import-mode=importlib adds no folder to the path
_spec.loader.exec_module(embree)

MESHES = {"target": objects.target, "concrete cylinder": objects.concrete_cylinder, "ball": objects.ball}
POSES = 20
ALL_PIXELS, OBJECT_PIXELS = 0.995, 0.95  # the bars of the issue


def sonar_at(tilt_deg):
    return Sonar.preset("didson-hf", tilt=math.radians(tilt_deg), height=0.9)


def poses(seed):
    rng = np.random.default_rng(seed)
    for index in range(POSES):
        x, y, yaw = (float(v) for v in rng.uniform([1.9, -0.25, 0.0], [2.6, 0.25, 2 * math.pi]))
        yield (15.0, 20.0, 25.0)[index % 3], x, y, yaw


def counts(mesh, cases):
    """Pixels, those that agree, object pixels of either, and those of them that agree, summed over the cases."""
    total = np.zeros(4, int)
    for tilt_deg, x, y, yaw in cases:
        sonar = sonar_at(tilt_deg)
        ours = np.asarray(render(mesh, Pose(x=x, y=y, yaw=yaw), sonar).labels())
        theirs, _, _ = embree.labels(mesh, x, y, yaw, sonar)
        same, either = ours == theirs, (ours > 0) | (theirs > 0)
        total += [same.size, same.sum(), either.sum(), (same & either).sum()]
    return total


def test_labels_of_a_few_frames_agree_with_embree():
    pixels, same, either, both = counts(objects.target(), list(poses(0))[:3])
    assert either > 3 * 500 and same / pixels >= ALL_PIXELS and both / either >= OBJECT_PIXELS


@pytest.fixture(scope="module")
def agreement():
    return {name: counts(make(), poses(seed)) for seed, (name, make) in enumerate(MESHES.items())}


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_labels_agree_with_embree(agreement, name):
    pixels, same, either, both = agreement[name]
    print(f"\n{name}: {same / pixels:.5f} of all pixels, {both / either:.4f} of {either} object pixels")
    assert either > 20 * 500  # the objects are there
    assert same / pixels >= ALL_PIXELS
    assert both / either >= OBJECT_PIXELS


@pytest.mark.slow
def test_labels_agree_over_the_whole_set(agreement):
    pixels, same, either, both = np.sum(list(agreement.values()), axis=0)
    print(f"\nall: {same / pixels:.5f} of all pixels, {both / either:.4f} of {either} object pixels")
    assert same / pixels >= ALL_PIXELS and both / either >= OBJECT_PIXELS


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_energy_lands_where_the_rays_hit(name):
    """Cumulated over range, each beam's energy stays within 2.5 % of the beam's total at every range."""
    mesh = MESHES[name]()
    tilt_deg, x, y, yaw = next(poses(7))
    sonar = sonar_at(tilt_deg)
    ours = np.asarray(render(mesh, Pose(x=x, y=y, yaw=yaw), sonar).intensity, np.float64)
    beams, theirs = embree.energy(mesh, x, y, yaw, sonar)
    ours = ours[:, beams]
    difference = np.abs(np.cumsum(ours, 0) - np.cumsum(theirs, 0)) / theirs.sum(0)
    print(f"\n{name}: cumulated energy differs by {difference.max():.4f} at most, {difference.mean():.5f} on average")
    assert difference.max() <= 0.025
    assert difference.mean() <= 0.003
    # The nearest hit of all and the first echo of an object are in the same bin, or its neighbour.
    bare = np.asarray(render(mesh, Pose(x=-3.0), sonar).intensity, np.float64)[:, beams]
    first = [np.flatnonzero((image > 1.2 * bare + 1e-6).any(1))[0] for image in (ours, theirs)]
    assert abs(first[0] - first[1]) <= 1
