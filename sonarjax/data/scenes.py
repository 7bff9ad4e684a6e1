"""The frames behind one pair: the object alone, which the labels show, and the object among the tank's walls."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.data.shapes import remove_walls
from sonarjax.data.views import View
from sonarjax.render import SonarFrame, render
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import with_skirts


def render_scenes(mesh: Mesh, view: View, *, sub_beams: int, elevations: int) -> tuple[SonarFrame, SonarFrame]:
    """Frames of the object alone, as a template has it, and of what an image is made of; `mesh` is in the ground frame.

    The second has the walls, where there are any, and reaches beyond the aperture (see `with_skirts`). One after the
    other through one compiled render.
    """

    def layers(scene: tuple[Array, Array]) -> tuple[Array, ...]:
        vertices, aperture = scene
        sonar = view.sonar.replace(elevation_aperture=aperture)
        frame = render(mesh.with_vertices(vertices), Pose(), sonar, sub_beams=sub_beams, elevations=elevations)
        return frame.intensity, frame.highlight, frame.shadow, frame.lit

    bare = remove_walls(mesh).vertices
    vertices = jnp.stack([bare, jnp.where(view.has_walls, mesh.vertices, bare)])
    apertures = jnp.stack([view.sonar.elevation_aperture, with_skirts(view.sonar).elevation_aperture])
    both = jax.lax.map(layers, (vertices, apertures))
    alone, seen = (SonarFrame(*(layer[k] for layer in both)) for k in (0, 1))
    return alone, seen
