"""The frames behind one pair: the object alone, which the labels show, and the object among the tank's walls."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.data.shapes import remove_walls
from sonarjax.data.views import View
from sonarjax.render import SonarFrame, render
from sonarjax.scene import Mesh, Pose


def render_scenes(mesh: Mesh, view: View, *, sub_beams: int, elevations: int) -> tuple[SonarFrame, SonarFrame]:
    """Frames of the object alone and of the scene with its walls; `mesh` is in the ground frame.

    One after the other through one compiled render; where there are no walls there is one frame only.
    """
    quality = {"sub_beams": sub_beams, "elevations": elevations}

    def layers(scene: tuple[Array, Array]) -> tuple[Array, ...]:
        frame = render(mesh.with_vertices(scene[0]), Pose(), view.sonar, **quality)
        return frame.intensity, frame.highlight, frame.shadow, frame.lit

    def nothing(scene: tuple[Array, Array]) -> tuple[Array, ...]:
        dark = jnp.zeros(view.sonar.shape)
        return dark, dark, dark, dark > 0

    scenes = (
        jnp.stack([remove_walls(mesh).vertices, mesh.vertices]),
        jnp.stack([jnp.ones((), bool), view.has_walls]),
    )
    both = jax.lax.map(lambda scene: jax.lax.cond(scene[1], layers, nothing, scene), scenes)
    alone = SonarFrame(*(layer[0] for layer in both))
    return alone, SonarFrame(*(jnp.where(view.has_walls, layer[1], layer[0]) for layer in both))
