"""`render`: what a sonar would see of one or several objects on the floor, and the `SonarFrame` it returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt8

from sonarjax._cores import quick_jit
from sonarjax.io.errors import SonarjaxError
from sonarjax.render.window import Window, render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.sonar import Sonar

SUB_BEAMS = 2
ELEVATIONS = 64


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SonarFrame:
    """A rendered sonar image; every layer has shape (range, beam), near to far and starboard to port."""

    intensity: Float[Array, "range beam"]
    """Energy of first hits per range bin, objects and floor [rad/m²] (eq. 2 with k = I0 = 1), not scaled."""
    highlight: Float[Array, "range beam"]
    """Share of the pixel's range cell covered by first hits of an object, 0 to 1."""
    shadow: Float[Array, "range beam"]
    """Share of the pixel's floor hidden behind an object, 0 to 1."""
    lit: Bool[Array, "range beam"]
    """True where the floor is insonified, or an object is seen; elsewhere a real frame is as dark as shadow."""

    def semantic(self) -> Float[Array, "range beam"]:
        """One grey image (range, beam): shadow 0, background 0.5, highlight 1, mixed by their shares of the pixel."""
        return semantic_image(self.highlight, self.shadow)

    def labels(self) -> UInt8[Array, "range beam"]:
        """The class (range, beam) with the largest share: 0 background, 1 highlight, 2 shadow."""
        shares = jnp.stack(
            [(1 - self.highlight) * (1 - self.shadow), self.highlight, self.shadow * (1 - self.highlight)]
        )
        return jnp.argmax(shares, axis=0).astype(jnp.uint8)


def semantic_image(
    highlight: Float[Array, "*batch range beam"], shadow: Float[Array, "*batch range beam"]
) -> Float[Array, "*batch range beam"]:
    """0.5·(1 + h − s·(1 − h)): the classes' shares (range, beam) as one grey image in [0, 1]."""
    return jnp.clip(0.5 * (1 + highlight - shadow * (1 - highlight)), 0.0, 1.0)


def render(
    mesh: Mesh | Sequence[Mesh],
    pose: Pose | Sequence[Pose],
    sonar: Sonar,
    *,
    sub_beams: int = SUB_BEAMS,
    elevations: int = ELEVATIONS,
) -> SonarFrame:
    """Simulate a frame (range, beam) of one object, or of several given as sequences of equal length (§2.1, eq. 1–2).

    Differentiable in every float of `pose` [m, rad], `sonar` and the vertices, under jit, vmap, grad and jacfwd, the
    visibility included. `sub_beams` is the number of azimuth parts of a beam; edges of the object split it further.
    `elevations` is about the number of elevation cells of the energy integral; which surface is visible does not
    depend on it below 33 triangles a slice (`envelope.EXACT_LIMIT`), and is sampled at that many elevations above.

    Raises SonarjaxError when the numbers of meshes and poses differ or a quality is below 1.
    """
    if sub_beams < 1 or elevations < 1:
        raise SonarjaxError(f"sub_beams and elevations: expected at least 1, got {sub_beams} and {elevations}")
    if not isinstance(mesh, Mesh):
        mesh, pose = place_together(mesh, pose)
    assert isinstance(pose, Pose)
    return _render(mesh, pose, sonar, sub_beams, elevations)


@partial(quick_jit, static_argnames=("sub_beams", "elevations"))
def _render(mesh: Mesh, pose: Pose, sonar: Sonar, sub_beams: int, elevations: int) -> SonarFrame:
    layers = render_window(mesh, pose, sonar, Window(0, 0, sonar.shape), sub_beams, elevations)
    return SonarFrame(*layers)


def place_together(meshes: Sequence[Mesh], poses: Pose | Sequence[Pose]) -> tuple[Mesh, Pose]:
    """Several objects at their poses as one mesh in the ground frame, and the pose (at the origin) it stands at.

    Raises SonarjaxError when the numbers of meshes and poses differ, or there is none.
    """
    poses = [poses] if isinstance(poses, Pose) else list(poses)
    if len(meshes) != len(poses) or not meshes:
        raise SonarjaxError(f"render: expected as many poses as meshes, got {len(poses)} and {len(meshes)}")
    starts = [sum(len(m.vertices) for m in meshes[:k]) for k in range(len(meshes))]
    joined = replace(
        meshes[0],
        vertices=jnp.concatenate([p.to_ground(m.vertices) for m, p in zip(meshes, poses, strict=True)]),
        faces=jnp.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]),
        crease=jnp.concatenate([m.crease + s for m, s in zip(meshes, starts, strict=True)]),
        closed=all(m.closed for m in meshes),
        crossings=sum(m.crossings for m in meshes),
        front=sum(m.front for m in meshes),
        events=sum(min(m.events, len(m.crease)) for m in meshes),
        crossing=len(meshes) > 1 or meshes[0].crossing,
        radius=max(m.radius for m in meshes),
        top=max(m.top for m in meshes),
    )
    return joined, Pose()
