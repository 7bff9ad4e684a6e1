"""The renders behind one pair: object alone, its images in floor and surface, and the object among the tank's walls.

All of them go through one compiled render, one after the other: four copies of it would take a minute to compile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from sonarjax.data.shapes import remove_walls
from sonarjax.data.views import NO_END_M, View
from sonarjax.render import SonarFrame, render
from sonarjax.scene import Mesh, Pose
from sonarjax.sensor import SensorModel, bounce_mesh
from sonarjax.sensor.multipath import WIDE_APERTURE
from sonarjax.sonar import FloorPatch, Sonar


def render_scenes(
    mesh: Mesh, view: View, model: SensorModel, *, sub_beams: int, elevations: int
) -> tuple[SonarFrame, SonarFrame, SonarFrame]:
    """Frames of the object alone, of the scene with its walls, and the echoes that come by way of the mirrors.

    `mesh` is in the ground frame. The echoes are those of `sonarjax.sensor.render_bounces` for the object alone.
    """
    sonar, alone = view.sonar, remove_walls(mesh)
    lifted, lift = _lifted(sonar)
    mirrors = []
    for plane, path in ((0.0, model.floor_path), (model.water_depth, model.surface_path)):
        image = bounce_mesh(alone, Pose(), sonar, plane, path)
        mirrors.append(image.with_vertices(image.vertices + jnp.array([0.0, 0.0, 1.0]) * lift))
    scenes = [(alone, sonar), (mirrors[0], lifted), (mirrors[1], lifted), (mesh, sonar)]
    wanted = [jnp.bool_(True), model.floor_bounce > 0, model.surface_bounce > 0, view.has_walls]

    def layers(scene: tuple[Mesh, Sonar]) -> tuple[Array, ...]:
        frame = render(scene[0], Pose(), scene[1], sub_beams=sub_beams, elevations=elevations)
        return frame.intensity, frame.highlight, frame.shadow, frame.lit

    first, floor, surface, walls = _one_by_one(layers, scenes, wanted)
    seen = SonarFrame(*(jnp.where(view.has_walls, a, b) for a, b in zip(walls, first, strict=True)))
    return SonarFrame(*first), seen, _echoes(SonarFrame(*floor), SonarFrame(*surface), model)


def _one_by_one(
    function: Callable[[Any], tuple[Array, ...]], items: list[Any], wanted: list[Array]
) -> list[tuple[Array, ...]]:
    """[function(item) for item in items], compiled once; zeros where the result is not wanted."""
    # The leaves are stacked, not the records: those hold one item's shapes.
    tree = jax.tree.structure(items[0])
    leaves = [
        jnp.stack([jnp.asarray(leaf) for leaf in column]) for column in zip(*map(jax.tree.leaves, items), strict=True)
    ]
    nothing = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(function, items[0]))

    def one(part: tuple[list[Array], Array]) -> tuple[Array, ...]:
        return jax.lax.cond(part[1], lambda: function(jax.tree.unflatten(tree, part[0])), lambda: nothing)

    results = jax.lax.map(one, (leaves, jnp.stack([jnp.asarray(w, bool) for w in wanted])))
    return [tuple(v[number] for v in results) for number in range(len(items))]


def _lifted(sonar: Sonar) -> tuple[Sonar, Array]:
    """The sonar so high that the floor is beyond its window, and by how much [m]."""
    lift = 2.0 * jnp.asarray(sonar.range_max, jnp.float32)
    floor = FloorPatch(x=0.0, y=0.0, length=NO_END_M, width=NO_END_M)
    return sonar.replace(height=sonar.height + lift, elevation_aperture=WIDE_APERTURE, floor=floor), lift


def _echoes(floor: SonarFrame, surface: SonarFrame, model: SensorModel) -> SonarFrame:
    """What `render_bounces` returns, from the two mirrors' frames."""
    return SonarFrame(
        intensity=model.floor_bounce * floor.intensity + model.surface_bounce * surface.intensity,
        highlight=jnp.maximum(floor.highlight, surface.highlight),
        shadow=jnp.zeros_like(floor.shadow),
        lit=floor.lit | surface.lit,
    )
