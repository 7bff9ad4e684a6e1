"""Gradients of energy at upright edges and painted facets; room for mixed scenes, and for thin strips with gaps."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.render import RenderQuality
from sonarjax.scene import objects

HEIGHT, TILT, HALF_APERTURE = 0.9, math.radians(20.0), math.radians(7.0)
QUALITY = RenderQuality(sub_beams=1)
STRIP = np.array([[0, -0.3, 0], [0, 0.3, 0], [0, 0.3, 0.02], [0, -0.3, 0.02]])
LADDER = sj.Sonar.preset(
    "didson-hf", tilt=TILT, height=HEIGHT, range_min=1.5, range_max=8.0, n_ranges=512,
    azimuth=np.radians(np.linspace(-2, 2, 8)),
)  # fmt: skip

# ---------------------------------------------------------------- gradients of energy

BRICK = objects.brick()
NEAR = sj.Sonar.preset(
    "didson-hf", tilt=TILT, azimuth=np.radians(np.linspace(-6, 6, 32)), range_min=1.8, range_max=3.0, n_ranges=64
)
EVEN, PAINTED = np.ones(BRICK.n_faces, np.float32), np.where(np.arange(BRICK.n_faces) % 2, 0.3, 1.0)


@jax.jit
def object_energy(y, lean, lambert, reflectivity):
    """Energy of a brick high above the floor, which sends nothing back then, and its derivative by y."""
    mesh = replace(BRICK, reflectivity=reflectivity)

    def total(y):
        pose = sj.Pose(2.3, y, 0.4, 20.02, 0.05 * lean, -0.04 * lean)
        return 1e3 * sj.render(mesh, pose, NEAR.replace(height=20.9, lambert=lambert)).intensity.sum()

    return jax.jvp(total, (y,), (jnp.ones(()),))


@pytest.mark.parametrize(
    ("lean", "lambert", "reflectivity", "sideways"),
    [
        (1.0, 1.0, EVEN, (0.02, 0.03, 0.06)),  # -64 to -68 with edges that stay where they are, -4.5 to -5.6 without
        (0.0, 1.0, EVEN, (0.02, 0.05)),
        (1.0, 0.0, EVEN, (0.02, 0.04)),
        (1.0, 0.0, PAINTED, (0.0, 0.03)),  # -616 and -521 without the paint
        (1.0, 1.0, PAINTED, (0.0, 0.03)),
    ],
    ids=["leaning", "upright", "no cosine", "painted", "painted, cosine"],
)
def test_energy_moves_with_upright_edges(lean, lambert, reflectivity, sideways):
    """Central differences. Where a slice meets an edge lengthwise it shows no bend, but both faces differ in energy."""
    at = [jnp.float32(v) for v in (lean, lambert)] + [jnp.asarray(reflectivity, jnp.float32)]
    for y in sideways:
        ours = float(object_energy(jnp.float32(y), *at)[1])
        step = 1e-3
        up, down = (float(object_energy(jnp.float32(y + by), *at)[0]) for by in (step, -step))
        assert ours == pytest.approx((up - down) / (2 * step), rel=0.2)


# ---------------------------------------------------------------- closed and open together


@pytest.mark.slow
def test_a_closed_object_beside_an_open_one_has_room():
    """The scene is then open, and the rear triangles of the ball count. Its echo is that of the ball alone."""
    ball, sheet = objects.ball(rings=10, sectors=20), sj.Mesh.from_arrays(STRIP, [[0, 1, 2], [0, 2, 3]])
    poses = [sj.Pose(x=2.3), sj.Pose(x=-5.0)]
    together = jax.jit(lambda: sj.render([ball, sheet], poses, LADDER, quality=QUALITY))()
    alone = sj.render(ball, poses[0], LADDER, quality=QUALITY)
    assert int(together.overflow) == 0
    for name in ("highlight", "shadow"):
        ours, theirs = (np.asarray(getattr(frame, name)) for frame in (together, alone))
        assert theirs.max() > 0.9
        np.testing.assert_allclose(ours.sum(), theirs.sum(), rtol=0.01)


# ---------------------------------------------------------------- thin surfaces with gaps


@pytest.mark.parametrize("rungs", [*(pytest.param(count, marks=pytest.mark.slow) for count in (3, 12)), 6])
def test_the_gaps_of_a_ladder_are_lit(rungs):
    """The shadow of upright strips above each other is the union of the shadows of single ones."""
    strips = [STRIP + [0, 0, 0.02 + 0.06 * k] for k in range(rungs)]
    corners = np.array([[0, 1, 2], [0, 2, 3]])
    ladder = sj.Mesh.from_arrays(np.concatenate(strips), np.concatenate([corners + 4 * k for k in range(rungs)]))
    pose = sj.Pose(2.0)
    alone = [sj.render(sj.Mesh.from_arrays(strip, corners), pose, LADDER, quality=QUALITY).shadow for strip in strips]
    together = sj.render(ladder, pose, LADDER, quality=QUALITY).shadow
    union = np.max(np.asarray(alone), axis=0)
    assert (union[:, 4] < 0.1).any() and (union[:, 4] > 0.9).any()
    assert (np.abs(np.asarray(together) - union) < 0.3).all()
