"""`render`: simulate what a sonar sees of one or several objects on the floor, at one pose or a batch of poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import check_kind, listed, shown
from sonarjax.render.frame import RenderQuality, SonarFrame, Window
from sonarjax.render.window import render_window
from sonarjax.scene import Mesh, Pose
from sonarjax.scene.limits import check_pose
from sonarjax.scene.mesh import check_reflectivity, joined_reflectivity
from sonarjax.sonar import Sonar

AT_ONCE = 64
"""Items that an accelerator computes at once."""


def render(
    mesh: Mesh | Sequence[Mesh],
    pose: Pose | Sequence[Pose],
    sonar: Sonar,
    *,
    quality: RenderQuality = RenderQuality(),
) -> SonarFrame:
    """Simulate the frame of one object, or of several objects in one scene (§2.1, eq. 1–2).

    The frame is differentiable in every float of `pose`, `sonar` and the mesh vertices, visibility included, and works
    under `jit`, `vmap`, `grad` and `jacfwd`. For a batch of sonars use `jax.vmap`.

    If a slice crosses more triangles than the mesh has room for, the frame is rendered again with more room. Under a
    trace this is impossible: the frame's `overflow` then counts the triangles that were left out.

    Args:
        mesh: One mesh, stacked meshes, or a sequence of meshes that stand in the same scene.
        pose: Pose [m, rad] of the mesh, any batch shape, or a sequence with one pose for each mesh of the sequence.
        sonar: The sonar that looks.
        quality: How finely to render.

    Returns:
        A frame (*batch, range, beam). `*batch` is the shape of `pose`, broadcast with that of stacked meshes.

    Raises:
        SonarjaxError: An argument is of another kind; the numbers of meshes and poses differ, or a sequence holds a
            batch; there is no pose, or the poses do not fit the stacked meshes; the sonar is a batch; a reflectivity
            has another length than the mesh has triangles; a pose (unless traced) is not finite or absurdly far away;
            or JAX is in its 64-bit mode.
    """
    check_sonar_alone(sonar)
    check_kind(quality, RenderQuality, "quality")
    mesh, pose = one_scene(mesh, pose)
    stacked = mesh.closed.shape
    if 0 in pose.shape:
        raise SonarjaxError(f"pose: expected one or more, got shape {pose.shape}")
    try:
        np.broadcast_shapes(pose.shape, stacked)
    except ValueError:
        raise SonarjaxError(
            f"pose: expected a shape that broadcasts with {stacked} of the meshes, got {pose.shape}"
        ) from None
    return with_enough_room(lambda roomy: _render(roomy, pose, sonar, quality), mesh)


def one_scene(mesh: Mesh | Sequence[Mesh], pose: Pose | Sequence[Pose]) -> tuple[Mesh, Pose]:
    """Check the meshes and poses of a scene, and join its objects if there are several (`place_together`)."""
    meshes = listed(mesh, Mesh, "mesh")
    for one in meshes:
        check_reflectivity(one, "mesh")
    if isinstance(mesh, Mesh):
        check_kind(pose, Pose, "pose")
    poses = listed(pose, Pose, "pose")
    for one in poses:
        check_pose(one)
    if not isinstance(mesh, Mesh) and any((*m.closed.shape, *p.shape) for m, p in zip(meshes, poses, strict=False)):
        raise SonarjaxError("mesh: expected a sequence of single meshes and poses, got a batch in it: use jax.vmap")
    return (meshes[0], poses[0]) if isinstance(mesh, Mesh) else place_together(meshes, poses)


def single_scene(mesh: Mesh | Sequence[Mesh], pose: Pose | Sequence[Pose]) -> tuple[Mesh, Pose]:
    """As `one_scene`, for functions that take no batch. Raises SonarjaxError for one."""
    mesh, pose = one_scene(mesh, pose)
    if mesh.closed.shape or pose.shape:
        raise SonarjaxError(
            f"pose: expected one pose of one mesh, got shapes {pose.shape} and {mesh.closed.shape}: use jax.vmap"
        )
    return mesh, pose


def check_sonar_alone(sonar: Sonar) -> None:
    """Raise a SonarjaxError for a batch of sonars, or for anything that is no sonar."""
    check_kind(sonar, Sonar, "sonar")
    azimuth: Any = sonar.azimuth
    if isinstance(azimuth, list | tuple):
        raise SonarjaxError(f"sonar: azimuth: expected an array (beam,), got {shown(azimuth)}")
    if sum(np.ndim(number) for number in jax.tree.leaves(sonar)) != 1:  # of `azimuth`
        raise SonarjaxError("sonar: expected one sonar, got a batch: use jax.vmap")


def with_enough_room(rendered: Callable[[Mesh], Any], mesh: Mesh) -> Any:
    """Call `rendered(mesh)`, and again with a roomier mesh as long as its result reports an `overflow`.

    A traced overflow has no value yet, so it is left to the caller.
    """
    found = rendered(mesh)
    while not isinstance(found.overflow, jax.core.Tracer) and (missing := int(np.max(np.asarray(found.overflow)))) > 0:
        mesh = mesh.with_room(mesh.crossings + missing, mesh.front + missing)
        found = rendered(mesh)
    return found


@partial(jax.jit, static_argnames="quality")
def _render(mesh: Mesh, pose: Pose, sonar: Sonar, quality: RenderQuality) -> SonarFrame:
    window = Window(0, 0, sonar.shape)
    batch = jnp.broadcast_shapes(pose.shape, mesh.closed.shape)
    if not batch:
        return render_window(mesh, pose, sonar, window, quality)
    poses = jax.tree.map(lambda v: jnp.broadcast_to(v, batch).reshape(-1), pose)
    if not mesh.closed.shape:
        frames = one_by_one(lambda one: render_window(mesh, one, sonar, window, quality), poses)
    else:
        axes = len(mesh.closed.shape)
        meshes = jax.tree.map(lambda v: jnp.broadcast_to(v, (*batch, *v.shape[axes:])), mesh)
        meshes = jax.tree.map(lambda v: v.reshape(-1, *v.shape[len(batch) :]), meshes)
        frames = one_by_one(lambda one: render_window(one[0], one[1], sonar, window, quality), (meshes, poses))
    return jax.tree.map(lambda v: v.reshape(*batch, *v.shape[1:]), frames)


def one_by_one(function: Callable[[Any], Any], items: Any) -> Any:
    """Compute `jax.vmap(function)(items)`; on a CPU one item at a time, because a batch would not fit the caches, and
    on an accelerator `AT_ONCE`, so that many do not fill its memory.
    """
    count = len(jax.tree.leaves(items)[0])
    return jax.lax.map(function, items, batch_size=None if jax.default_backend() == "cpu" else min(count, AT_ONCE))


def place_together(meshes: Sequence[Mesh], poses: Pose | Sequence[Pose]) -> tuple[Mesh, Pose]:
    """Join several objects at their poses into one mesh in the ground frame.

    Returns:
        The joined mesh, and its pose, which is the origin.

    Raises:
        SonarjaxError: The numbers of meshes and poses differ, or there are none.
    """
    poses = [poses] if isinstance(poses, Pose) else list(poses)
    if len(meshes) != len(poses) or not meshes:
        raise SonarjaxError(f"pose: expected as many poses as meshes, got {len(poses)} and {len(meshes)}")
    starts = [sum(len(m.vertices) for m in meshes[:k]) for k in range(len(meshes))]
    crossings, front = _room_together(meshes)
    joined = replace(
        meshes[0],
        vertices=jnp.concatenate([p.to_ground(m.vertices) for m, p in zip(meshes, poses, strict=True)]),
        faces=jnp.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]),
        crease=jnp.concatenate([m.crease + s for m, s in zip(meshes, starts, strict=True)]),
        closed=jnp.stack([m.closed for m in meshes]).all(),
        radius=jnp.stack([m.radius for m in meshes]).max(),
        top=jnp.stack([m.top for m in meshes]).max(),
        crossings=crossings,
        front=front,
        events=sum(min(m.events, len(m.crease)) for m in meshes),
        intersecting=len(meshes) > 1 or meshes[0].intersecting,
        reflectivity=joined_reflectivity(meshes),
    )
    return joined, Pose()


def _room_together(meshes: Sequence[Mesh]) -> tuple[int, int]:
    """Most triangles of several objects that a slice crosses, and most that face the sonar.

    One open surface leaves the joined mesh open, so the rear triangles of closed objects count too, which were not
    counted for them alone. A slice meets about as many of these as of front ones. Where `closed` is traced it is not
    known; the overflow then tells what has no room.
    """
    traced = any(isinstance(m.closed, jax.core.Tracer) for m in meshes)
    closed = [] if traced else [bool(m.closed) for m in meshes]
    if all(closed) or not any(closed):
        return sum(m.crossings for m in meshes), sum(m.front for m in meshes)
    crossings = (min(m.crossings * (1 + both), m.n_faces) for m, both in zip(meshes, closed, strict=True))
    return sum(crossings), sum(m.n_faces for m in meshes)
