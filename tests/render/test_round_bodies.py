"""Tessellated round bodies: their edges must not show, neither in the energy nor where a slice is sampled."""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.render import RenderQuality, Window, place_window, plan_window, render_window
from sonarjax.scene import Pose, objects
from sonarjax.sonar import Sonar

pytestmark = pytest.mark.slow
SONAR = Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9)
POSES = ((2.1, 0.1, 0.3), (2.3, -0.15, 2.0))
FINER = 8


@partial(jax.jit, static_argnames=("shape", "quality"))
def layers(mesh, p, row, column, shape, quality):
    out = render_window(mesh, Pose(*p), SONAR, Window(row, column, shape), quality)
    return out.intensity, out.highlight, out.shadow


def errors(mesh, p, finer):
    """RMS error of intensity, highlight and shadow at the default quality against a `finer` one."""
    size = plan_window(mesh, SONAR, 2.05, 0.03)
    window = place_window(size, mesh, SONAR, p[0], p[1])
    at = (mesh, jnp.array(p), window.row, window.column, size.shape)
    pairs = zip(layers(*at, RenderQuality()), layers(*at, finer), strict=True)
    return np.array([float(jnp.sqrt(((a - b) ** 2).sum() / (b**2).sum())) for a, b in pairs])


@pytest.mark.parametrize("p", POSES)
def test_a_cylinder_converges(p):
    """Within 3 % of an 8 × finer render at the default quality: its facets' diagonals may not smear the energy."""
    found = errors(objects.concrete_cylinder(), p, RenderQuality(2 * FINER, 64 * FINER))
    print(f"\nintensity {found[0]:.2%}, highlight {found[1]:.2%}, shadow {found[2]:.2%}")
    assert (found < 0.03).all()


@pytest.mark.parametrize("p", POSES)
def test_a_sampled_ball_keeps_its_limb(p):
    """More triangles a slice than are followed exactly: the limb, where range goes with a root, is sampled densely."""
    mesh = objects.ball()
    found = errors(mesh, p, RenderQuality(4, 64 * FINER))
    print(f"\nintensity {found[0]:.2%}, highlight {found[1]:.2%}, shadow {found[2]:.2%}")
    assert (found < [0.05, 0.1, 0.02]).all()  # highlight: 28 % with evenly spread samples
