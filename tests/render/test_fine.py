"""Meshes finer than the sonar can tell: which are reduced, to which error, and that the frame stays the same."""

import math

import numpy as np
import pytest
import trimesh

from sonarjax import SonarjaxError
from sonarjax.render import RenderQuality, mesh_tolerance, reduced_for, render, template_bank
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar

SHIPPED = ("target", "non_target", "brick", "concrete_cylinder", "ball", "tank")


@pytest.fixture(scope="module")
def sonar():
    return Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)


@pytest.fixture(scope="module")
def rough():
    """A closed body of 20,480 triangles with bumps of millimetres."""
    shape = trimesh.creation.icosphere(5, 1.0)
    along = shape.vertices @ np.array([[3.0, 9.0, 17.0], [-4.0, 11.0, -23.0], [2.0, -13.0, 29.0]])
    radius = 0.12 * (1 + 0.2 * np.sin(along[:, 0])) + 0.002 * np.sin(along[:, 1:]).sum(1)
    return Mesh.from_arrays(shape.vertices * radius[:, None] + [0, 0, 0.16], shape.faces, name="rough")


@pytest.fixture(scope="module")
def reduced(rough, sonar):
    return reduced_for(rough, sonar)


def test_tolerance_is_a_share_of_bin_and_beam():
    def sonar(**given):
        return Sonar.preset("didson-hf", range_min=1.5, range_max=4.0, **given)

    fine = sonar(n_ranges=5120)
    assert mesh_tolerance(fine) == pytest.approx(2.5 / 5120 / 8)
    coarse = sonar(n_ranges=16)
    spacing = np.diff(np.asarray(coarse.azimuth)).min()
    assert mesh_tolerance(coarse) == pytest.approx(1.5 * spacing / 8)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_objects_stay_as_they_are(sonar, name):
    mesh = getattr(objects, name)()
    found = reduced_for(mesh, sonar)
    assert found.mesh is mesh and found.after == found.before
    assert found.error.largest == 0.0


def test_fine_mesh_is_reduced_and_its_labels_stay(sonar, rough, reduced):
    found = reduced
    assert found.before == 20_480 and found.after < found.before / 2
    assert found.error.usual <= mesh_tolerance(sonar)
    pose = Pose(x=2.3, y=0.0, yaw=0.4)
    before, after = (np.asarray(render(mesh, pose, sonar).labels()) for mesh in (rough, found.mesh))
    either = (before > 0) | (after > 0)
    assert either.sum() > 1000
    assert (before == after)[either].mean() > 0.98


def test_what_is_asked_for_is_done(sonar, rough, reduced):
    assert reduced_for(rough, sonar, 0.0).mesh is rough
    assert reduced_for(rough, sonar, 1e-9).mesh is rough  # nothing to be gained within a nanometre
    assert reduced_for(rough, sonar, 0.004).after < reduced.after
    with pytest.raises(SonarjaxError, match="tolerance"):
        reduced_for(rough, sonar, -0.001)


@pytest.mark.slow
def test_bank_of_a_rough_body_is_that_of_finer_slabs(sonar, reduced):
    """A bank puts no slabs at a rough body's edges; many even slabs tell what it ought to show."""
    mesh = reduced.mesh
    assert mesh.crease.shape[-1] > mesh.events  # else there is nothing to leave out
    banks = [template_bank(mesh, sonar, [0.3, 2.0], x=2.3, quality=RenderQuality(sub_beams=n)) for n in (1, 6)]
    quick, fine = (np.digitize(in_frame(bank, sonar), [0.25, 0.75]) for bank in banks)
    either = (quick != 1) | (fine != 1)
    assert either.sum() > 1000
    assert (quick == fine)[either].mean() > 0.95


def in_frame(bank, sonar):
    """Templates (yaw, range, beam) in whole frames of background: two banks may be cropped differently."""
    (row, column), (rows, columns) = np.asarray(bank.offset), bank.templates.shape[1:]
    frames = np.full((len(bank.templates), *sonar.shape), 0.5, np.float32)
    frames[:, row : row + rows, column : column + columns] = np.asarray(bank.templates)
    return frames
