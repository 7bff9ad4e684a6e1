"""The two frames behind one pair: the object alone, which gives the labels, and the object among the tank's walls."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.data.shapes import remove_walls
from sonarjax.data.views import View
from sonarjax.render import RenderQuality, SonarFrame, render
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import with_skirts


def render_scenes(mesh: Mesh, view: View, quality: RenderQuality) -> tuple[SonarFrame, SonarFrame]:
    """Render a pair's two frames: the object alone, as in a template, and the scene that the image shows.

    `mesh` is in the ground frame. The second frame has the walls, if there are any, and reaches beyond the aperture
    (see `with_skirts`). Both go through one compiled render, one after the other.
    """

    def rendered(scene: tuple[Array, Array]) -> SonarFrame:
        vertices, aperture = scene
        sonar = view.sonar.replace(elevation_aperture=aperture)
        return render(replace(mesh, vertices=vertices), Pose(), sonar, quality=quality)

    bare = remove_walls(mesh).vertices
    vertices = jnp.stack([bare, jnp.where(view.has_walls, mesh.vertices, bare)])
    apertures = jnp.stack([view.sonar.elevation_aperture, with_skirts(view.sonar).elevation_aperture])
    both = jax.lax.map(rendered, (vertices, apertures))
    alone, seen = (replace(jax.tree.map(lambda v, k=k: v[k], both), sonar=view.sonar) for k in (0, 1))
    return alone, seen
