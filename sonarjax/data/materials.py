"""What the faces of a random object send back: Lambert's law, a glossy lobe, and differences from face to face."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.random import fold_in, normal
from jaxtyping import Array, Float

from sonarjax.data.draws import Stream
from sonarjax.scene import Mesh

LAMBERT = (0.0, 2.0)
"""Exponent of cos(incidence) [1]: 0 is eq. 2 alone, 2 is Lambert's law on both ways."""
GLOSSY_SHARE, GLOSS, LOBE_DEG = 0.5, (0.3, 10.0), (5.0, 20.0)
"""How often an object has a glossy lobe, how strong it is beside the diffuse echo [1], and its width [deg]."""
FACE_DB = (0.0, 3.0)
"""Standard deviation of the differences from face to face [dB]."""
NUMBERS = 8  # that a material takes from its stream


def draw_reflectivity(mesh: Mesh, height: Array, faces: int, *, key: Array) -> Float[Array, "face"]:
    """What each triangle (face,) of a mesh in the ground frame sends back to a head at `height` [m] above the origin.

    The first `faces` of them are the object's; all others, the tank's walls, send back 1.
    """
    stream = Stream(NUMBERS, key=key)
    exponent = stream.between(*LAMBERT)
    gloss = stream.sometimes(GLOSSY_SHARE, stream.log_between(*GLOSS), 0.0)
    width, spread = jnp.radians(stream.between(*LOBE_DEG)), stream.between(*FACE_DB)
    each = spread * normal(fold_in(key, 1), (len(mesh.faces) // 2 + 1,))
    sent = reflectivity(mesh, height, exponent, gloss, width, each)
    return jnp.where(jnp.arange(len(mesh.faces)) < faces, sent, 1.0)


def reflectivity(
    mesh: Mesh, height: Any, exponent: Any, gloss: Any, width: Any, quads_db: Float[Array, "quad"]
) -> Float[Array, "face"]:
    """What each triangle (face,) of a mesh in the ground frame sends back to a head at `height` [m] above the origin.

    cos(incidence)^`exponent`, Lambert's law (Urick, Principles of Underwater Sound, 1983, ch. 8), and a lobe around the
    normal of strength `gloss` [1] and `width` [rad]; two triangles in a row share one of `quads_db` (quad,) [dB].
    Incidence is that at a triangle's middle.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals, sight = jnp.cross(b - a, c - a), (a + b + c) / 3 - jnp.array([0.0, 0.0, 1.0]) * height
    length = jnp.sqrt(jnp.square(normals).sum(1) * jnp.square(sight).sum(1) + 1e-20)
    cosine = jnp.clip(jnp.abs((normals * sight).sum(1)) / length, 1e-3, 1.0)
    lobe = gloss * jnp.exp(-jnp.square(jnp.arccos(cosine) / width))
    return (cosine**exponent + lobe) * 10 ** (quads_db[jnp.arange(len(mesh.faces)) // 2] / 10)
