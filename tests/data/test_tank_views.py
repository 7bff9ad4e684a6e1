"""Views of §3.1: what Table 1 says, and an object that the sonar can see."""

from __future__ import annotations

import math

import jax
import numpy as np
import pytest

from sonarjax.data.pairs import PAPER_PAIRS
from sonarjax.data.tank_views import BEHIND_M, GROUND_RANGES_M, TRANSLATION_M, draw_tank_view
from sonarjax.data.views import TILTS
from sonarjax.scene.objects import TANK_M
from sonarjax.segment.training import PRESETS


@pytest.fixture(scope="module")
def views():
    keys = jax.random.split(jax.random.key(3), 400)
    return jax.jit(jax.vmap(lambda key: draw_tank_view(256, 64, key=key)))(keys)


def test_tilts_are_those_of_table_1_each_as_often(views):
    tilts = np.asarray(views.sonar.tilt)
    nearest = np.abs(tilts[:, None] - np.array(TILTS)).argmin(1)
    assert np.abs(tilts - np.array(TILTS)[nearest]).max() < math.radians(1.6)
    assert (np.bincount(nearest, minlength=3) > 100).all()


def test_the_object_is_moved_by_table_1s_translation_at_most(views):
    nearest = np.abs(np.asarray(views.sonar.tilt)[:, None] - np.array(TILTS)).argmin(1)
    ahead = np.asarray(views.pose.x) - np.array(GROUND_RANGES_M)[nearest]
    for moved in (ahead, np.asarray(views.pose.y)):
        assert np.abs(moved).max() <= TRANSLATION_M + 1e-6
        assert np.ptp(moved) > 1.8 * TRANSLATION_M


def test_the_object_stands_on_lit_floor_in_the_window(views):
    sonar, pose = views.sonar, views.pose
    ground = np.hypot(pose.x, pose.y)
    down = np.arctan2(sonar.height, ground)
    assert (np.abs(down - sonar.tilt) < sonar.elevation_aperture / 2).all()
    slant = np.hypot(ground, sonar.height)
    assert ((slant > sonar.range_min) & (slant < sonar.range_max)).all()
    assert (np.abs(np.arctan2(pose.y, pose.x)) < np.asarray(sonar.azimuth)[:, -1]).all()


def test_the_tank_has_table_1s_size_and_holds_head_and_object(views):
    walls = np.asarray(views.walls)
    assert np.asarray(views.has_walls).all()
    sides = np.stack([np.linalg.norm(walls[:, k] - walls[:, 0], axis=1) for k in range(1, walls.shape[1])])
    for side in TANK_M:
        assert np.isclose(sides, side, atol=1e-4).any(axis=0).all()
    far, near = walls[..., 0].max(1), walls[..., 0].min(1)
    assert (far - np.asarray(views.pose.x) > BEHIND_M - 1e-3).all()
    assert (near < 0.03).all() and (far > 0).all()  # a tank at an angle has a corner a little further


def test_the_papers_recipe_is_eq_3_alone_for_30_epochs_of_its_pairs():
    recipe = PRESETS["paper-cpu"]
    assert (recipe.pairs, recipe.epochs, recipe.sets) == (PAPER_PAIRS, 30, 1)
    assert recipe.pair_settings.tank and recipe.pair_settings == PRESETS["paper"].pair_settings
    networks = recipe.networks
    assert (networks.adversarial, networks.cross_entropy, networks.distance) == (1.0, 0.0, 100.0)
    assert (networks.head, networks.inputs, networks.normaliser) == ("tanh", "grey", "affine")
    assert (recipe.mirrored, recipe.plain) == (0.0, 0.0)
