"""How much the faces of a random object send back: Lambert's law, a glossy lobe, and differences between faces."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.random import fold_in, normal
from jaxtyping import Array, Float

from sonarjax.data.draws import Stream
from sonarjax.scene import Mesh

LAMBERT = (0.0, 2.0)
"""Range of the exponent of cos(incidence) [1].

0 is eq. 2 alone. 1 is Lambert's law: its backscatter is cos² per area (Urick, Principles of Underwater Sound, 1983,
ch. 8), and the area in a given angle grows as 1/cos. No source for 2: ours, for faces that fade faster.
"""
GLOSSY_SHARE, GLOSS, LOBE_DEG = 0.5, (0.3, 10.0), (5.0, 20.0)
"""Share of objects with a glossy lobe, range of its strength relative to the diffuse echo [1], and of its width
[deg], the angle at which it has fallen to 1/e. No source: guesses, kept wide so that the network sees many materials.
"""
FACE_DB = (0.0, 3.0)
"""Range of the standard deviation of the differences between faces [dB]. No source: a guess, from none to clearly
visible.
"""
NUMBERS = 8  # random numbers that a material takes from its stream


def draw_reflectivity(mesh: Mesh, height: Array, faces: int, *, key: Array) -> Float[Array, "face"]:
    """Draw how much each triangle (face,) of a mesh in the ground frame sends back to a head at `height` [m].

    The first `faces` triangles are the object's. All others, the walls of the tank, have 1. No source: independent
    draws from ranges of ours; `reflectivity` has the law.
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
    """Factor on the energy that each triangle (face,) of a mesh in the ground frame sends back.

    It is cos(incidence)^`exponent`, after Lambert's law (Urick, Principles of Underwater Sound, 1983, ch. 8), plus a
    lobe around the normal, and all that times each pair's own level. The lobe is Gaussian in the angle of incidence,
    like the slopes of a rough surface's facets in Torrance and Sparrow (J. Opt. Soc. Am. 57, 1967). No source for the
    sum, or for levels that are normal in dB: models of ours. Incidence is taken at the middle of a triangle.

    Args:
        mesh: The mesh.
        height: Height of the sonar head above the origin [m].
        exponent: Exponent of cos(incidence) [1], 1 for Lambert's law.
        gloss: Strength of the lobe, relative to the diffuse echo at normal incidence [1].
        width: Angle at which the lobe has fallen to 1/e [rad].
        quads_db: Level of each pair of consecutive triangles (quad,) [dB].
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals, sight = jnp.cross(b - a, c - a), (a + b + c) / 3 - jnp.array([0.0, 0.0, 1.0]) * height
    length = jnp.sqrt(jnp.square(normals).sum(1) * jnp.square(sight).sum(1) + 1e-20)
    cosine = jnp.clip(jnp.abs((normals * sight).sum(1)) / length, 1e-3, 1.0)
    lobe = gloss * jnp.exp(-jnp.square(jnp.arccos(cosine) / width))
    return (cosine**exponent + lobe) * 10 ** (quads_db[jnp.arange(len(mesh.faces)) // 2] / 10)
