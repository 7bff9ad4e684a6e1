"""Room for the triangles that a slice meets where an object leans.

A mesh is measured once, standing upright (`scene.slicing`). Where it leans, a slice may meet more of its triangles: a
tube that lies along the beam shows all its sides in one slice.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sonarjax.render.candidates import front_faces
from sonarjax.render.window import in_sonar_frame
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.slicing import deepest_overlap
from sonarjax.sonar import Sonar

SPARE = 1.15
"""Factor by which there is more room than the poses need, because refinement moves the object [1]."""


def with_lean_room(mesh: Mesh, poses: Pose, sonar: Sonar) -> Mesh:
    """Give a mesh room for the triangles that slices meet at poses that lean. A function of the host.

    Args:
        mesh: The object, not stacked.
        poses: One pose or several [m, rad], of any shape. Upright ones are not looked at.
        sonar: The sonar that looks.

    Returns:
        The mesh, with more room if it needs it.
    """
    flat = jax.tree.map(lambda v: np.asarray(v).ravel(), poses)
    leaning = np.flatnonzero((flat.roll != 0) | (flat.pitch != 0))
    each = (jax.tree.map(lambda v, k=k: v[k], flat) for k in leaning)
    needed = max((_crossings(mesh, pose, sonar) for pose in each), default=0)
    return mesh.with_room(math.ceil(SPARE * needed), mesh.front) if needed else mesh


def _crossings(mesh: Mesh, pose: Pose, sonar: Sonar) -> int:
    """Most triangles that one slice of the sonar meets, as `candidates` counts them."""
    azimuth, seen = jax.device_get(_azimuths(mesh, pose, sonar))
    found = azimuth[seen]
    return deepest_overlap(found.min(axis=1), found.max(axis=1)) if len(found) else 0


@jax.jit
def _azimuths(mesh: Mesh, pose: Pose, sonar: Sonar) -> tuple[Float[Array, "face 3"], Bool[Array, "face"]]:
    """Azimuths [rad] of the corners of each triangle, and whether it can be seen."""
    vertices = in_sonar_frame(mesh, pose, sonar).vertices
    azimuth = jnp.arctan2(vertices[:, 1], vertices[:, 0])[mesh.faces]
    return azimuth, front_faces(vertices, mesh.faces, mesh.closed)
