"""Small parts of the experiments whose results are shipped or printed."""

from __future__ import annotations

import numpy as np

from experiments.evaluate_segmenters import mirrored
from experiments.fit_threshold import best_threshold
from sonarjax.scene import objects


def test_best_threshold_is_the_middle_of_the_widest_run_of_least_errors():
    assert best_threshold(np.array([0.8, 0.9]), np.array([0.2, 0.4])) == np.float64(0.4 + 0.8) / 2
    # Cuts between 0.3 and 0.4 and between 0.6 and 0.9 err once, the one between 0.4 and 0.6 twice.
    target, other = np.array([0.4, 0.9, 0.95]), np.array([0.2, 0.3, 0.6])
    assert best_threshold(target, other) == 0.75


def test_a_mirrored_mesh_is_closed_and_another_object():
    mesh = objects.target()
    other = mirrored(mesh)
    ours, theirs = (np.asarray(m.vertices)[np.asarray(m.faces)] for m in (mesh, other))

    def volume(corners):
        return float(np.linalg.det(corners.astype(float)).sum() / 6)

    assert volume(ours) > 0  # faces look outwards
    np.testing.assert_allclose(volume(theirs), volume(ours), rtol=1e-5)
    np.testing.assert_allclose(theirs[..., 1].max(), -ours[..., 1].min(), atol=1e-6)
