"""What validation frames show: drawn piles, leaning objects and walls."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from experiments.common.drawn_piles import COUNT, pile_scenes
from experiments.common.engine import engine
from experiments.common.frames import observed, sonar_for
from experiments.common.leaning import Leaning, _placed, rotation
from experiments.common.sets import target
from experiments.common.validation import _empty_case, scenes
from experiments.common.walled import _seen, walled_cases
from sonarjax.refine import in_view
from sonarjax.scene import Pose
from sonarjax.sensor import SensorModel


def test_each_pile_differs_from_its_twin_and_from_the_test_pile() -> None:
    scenes = pile_scenes()
    assert len(scenes) == COUNT
    shapes = {np.shape(mesh.vertices) for scene in scenes.values() for mesh in scene}
    assert len(shapes) == 1  # they share compiled code
    bare = np.unique(np.round(np.asarray(target().vertices), 4), axis=0)
    for scene in scenes.values():
        own, other = (np.unique(np.round(np.asarray(mesh.vertices), 4), axis=0) for mesh in (scene.target, scene.other))
        assert own.shape != other.shape or not np.allclose(own, other)
        assert own.shape != bare.shape or not np.allclose(own, bare)
        assert own[:, 2].min() == pytest.approx(0.0, abs=1e-6)


def test_a_leaning_object_floats_as_little_as_asked_and_both_sonars_look_at_it() -> None:
    how = Leaning(tilt_deg=20.0, lean_deg=15.0, lift_m=0.05)
    for number in range(20):
        pose, sonars = _placed(target(), how, np.random.default_rng(number))
        low = rotation(pose).apply(np.asarray(target().vertices, float))[:, 2].min() + float(pose.z)
        assert -1e-6 <= low <= 0.05 + 1e-6
        assert max(abs(float(pose.roll)), abs(float(pose.pitch))) <= math.radians(15.0)
        for sonar in sonars:
            seen = in_view(pose, sonar)
            assert 2.1 < math.hypot(float(seen.x), float(seen.y)) < 2.5
            assert abs(math.degrees(math.atan2(float(seen.y), float(seen.x)))) <= 4.0 + 1e-3
        assert sonars[1, 2] - sonars[0, 2] == pytest.approx(math.pi / 2)


@pytest.mark.slow
@pytest.mark.computes
def test_neither_bare_floor_nor_noise_is_identified() -> None:
    """Frames of another seed than those to which the rule was fitted, and noise that no sonar took."""
    names, sonar, noise = list(scenes()), sonar_for(20.0), np.random.default_rng(0)
    seek = sj.Recognizer(scenes()["tower"].target, sonar, engine=engine())
    cases = [_empty_case(len(names) * k + names.index("tower"), 1, (20.0,)) for k in range(3)]
    assert all((case.clean == 0.5).all() and not case.is_target for case in cases)
    assert sum(seek(case.image).identified for case in cases) == 0
    assert not any(seek(noise.gamma(1.0, 0.1, sonar.shape).clip(0, 1)).identified for _ in range(2))
    assert not any(seek(noise.random(sonar.shape)).identified for _ in range(2))
    assert not seek(np.full(sonar.shape, 0.3)).identified


@pytest.mark.slow
def test_a_wall_is_seen_where_it_stands() -> None:
    sonar = sonar_for(20.0).replace(floor=sj.FloorPatch(1.0, 0.0, 4.0, 3.0, 0.0))
    model = jax.tree.map(jnp.float32, SensorModel.nominal())
    tank = sj.objects.tank((4.0, 3.0, 1.5))
    walled = np.asarray(_seen()(target(), Pose(2.3), tank, Pose(1.0), sonar, model, jax.random.key(0)))
    without = np.asarray(observed(target(), Pose(2.3), sonar, model, key=jax.random.key(0))[0])
    ranges = float(sonar.range_min) + (np.arange(sonar.n_ranges) + 0.5) * float(sonar.range_bin)
    foot = math.hypot(3.0, float(sonar.height))  # where the far wall meets the floor, which ends there
    wall = (ranges > foot - 0.1) & (ranges < foot)
    before = (ranges > 2.0) & (ranges < 2.25)
    assert walled[wall].mean() > without[wall].mean() + 0.2
    assert walled[before].mean() == pytest.approx(without[before].mean(), abs=0.1)


@pytest.mark.slow
def test_frames_with_walls_are_drawn_again_by_their_seed() -> None:
    first, second, other = walled_cases(3, 2), walled_cases(3, 1), walled_cases(4, 1)
    assert np.array_equal(first[0].image, second[0].image)
    assert not np.array_equal(first[0].image, other[0].image)


@pytest.mark.slow
def test_tanks_without_an_object_are_the_same_tanks() -> None:
    """The same device and walls: only the object and its shadow are gone, which is a small part of the frame."""
    (filled,), (empty,) = walled_cases(3, 1), walled_cases(3, 1, empty=True)
    assert (empty.shown, empty.sought, empty.tilt_deg) == ("nothing", filled.sought, filled.tilt_deg)
    assert math.isnan(empty.yaw) and not empty.is_target
    changed = np.abs(filled.image - empty.image) > 0.05
    assert 0.001 < changed.mean() < 0.25
