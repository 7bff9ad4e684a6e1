"""Finely tessellated bodies: what slices of many triangles are tried on."""

from __future__ import annotations

import math

import numpy as np

from sonarjax.scene import Mesh, objects


def stepped_cylinder() -> Mesh:
    """Four upright cylinders on top of each other, each narrower than the one below: 768 faces, 128 candidates a slice.

    Each step's walls make the profile jump where they end to the left and to the right.
    """
    parts = []
    for k, radius in enumerate((0.10, 0.08, 0.06, 0.04)):
        vertices, faces = objects.cylinder_arrays(radius, height=0.05)
        parts.append((vertices + [0, 0, 0.05 * k], faces))
    return Mesh.from_arrays(*objects.join(*parts), name="stepped cylinder")


def bottle(sectors: int = 48, rings: int = 17) -> Mesh:
    """An upright bottle 0.25 m high whose shoulder is smooth: a solid of revolution of 1,632 faces."""
    z = np.linspace(0.0, 0.25, rings)
    radius = 0.02 + 0.035 / (1 + np.exp((z - 0.16) / 0.012))
    # The ball has two rings fewer than `rings + 1`: its poles become the middles of the bottom and of the top.
    vertices, faces = objects.sphere_arrays(1.0, rings + 1, sectors)
    angle = 2 * math.pi * np.arange(sectors) / sectors
    down = slice(None, None, -1)  # the ball's rings go from the top down
    vertices[:-2, 0], vertices[:-2, 1] = (np.outer(radius[down], f(angle)).ravel() for f in (np.cos, np.sin))
    vertices[:, 2] = np.concatenate([np.repeat(z[down], sectors), [z[-1], z[0]]])
    return Mesh.from_arrays(vertices, faces, name="bottle")


def deformed_sphere() -> Mesh:
    """A smooth lump about 0.2 m across that turns in yaw: a ball of 5,040 faces, each point moved along its radius."""
    vertices, faces = objects.sphere_arrays(1.0, rings=36, sectors=72)
    x, y, z = (vertices - [0, 0, 1]).T
    vertices = 0.1 * (1 + 0.3 * x + 0.25 * x * y + 0.15 * np.sin(3 * y + z))[:, None] * np.stack([x, y, z], axis=1)
    return Mesh.from_arrays(vertices - [0, 0, vertices[:, 2].min()], faces, name="deformed sphere")
