"""The free numbers of a sonar: what each changes, and what is refused."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.calibrate.inputs import starts_of
from sonarjax.calibrate.parameters import PARAMETERS, changed_sonar, check_free, prior_std
from sonarjax.sonar import GeometryStd

SONAR = sj.Sonar.preset("didson-hf")


def test_no_change_is_the_nominal_sonar() -> None:
    same = changed_sonar(SONAR, tuple(PARAMETERS), jnp.zeros(len(PARAMETERS)))
    for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(SONAR), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


def test_poses_within_the_outer_beams_are_in_view() -> None:
    """A single beam has all of its width, and an outer one its outer half."""
    level = SONAR.replace(tilt=0.0)
    single = level.replace(azimuth=jnp.zeros(1), beam_width=math.radians(5.0))
    for sonar, azimuth, seen in ((single, 2.0, True), (single, 3.0, False), (level, 14.4, True), (level, 15.0, False)):
        pose = sj.Pose([2.3 * math.cos(math.radians(azimuth))], [2.3 * math.sin(math.radians(azimuth))], [0.0])
        if seen:
            assert len(starts_of(pose, 1, sonar)) == 1
        else:
            with pytest.raises(sj.SonarjaxError, match="expected the object in view"):
                starts_of(pose, 1, sonar)


def test_a_rolled_sonar_sees_what_its_beams_reach() -> None:
    """The renderer decides, by a small box. The azimuth without roll would be wrong at all four places."""
    sonar = SONAR.replace(roll=0.5, tilt=math.radians(20.0), height=0.9, elevation_aperture=math.radians(40.0))
    mesh = sj.Mesh.from_arrays(*sj.objects.box((0.02, 0.02, 0.02), (0.0, 0.0, 0.01)))
    for x, y, seen in ((1.6, 0.5, True), (1.7, 0.55, True), (1.6, -0.42, False), (1.7, -0.45, False)):
        assert bool(np.asarray(sj.render(mesh, sj.Pose(x, y), sonar).highlight).any()) == seen
        if seen:
            assert len(starts_of(sj.Pose([x], [y]), 1, sonar)) == 1
        else:
            with pytest.raises(sj.SonarjaxError, match="expected the object in view"):
                starts_of(sj.Pose([x], [y]), 1, sonar)


def test_each_number_changes_what_it_says() -> None:
    def changed(name: str, value: float) -> sj.Sonar:
        return changed_sonar(SONAR, (name,), jnp.array([value]))

    for name in ("tilt", "roll", "height", "elevation_aperture"):
        assert float(getattr(changed(name, 0.01), name)) == pytest.approx(float(getattr(SONAR, name)) + 0.01)
    for change, limit in ((-25.0, 65.0), (5.0, 90.0), (-120.0, 1.0)):  # [deg]; what no sonar can have is not reached
        assert float(changed("highlight_max_incidence", change).highlight_max_incidence) == pytest.approx(limit)
    assert float(changed("range_offset", 0.02).range_max) == pytest.approx(4.02)
    stretched = changed("range_scale", 0.01)
    assert (float(stretched.range_min), float(stretched.range_max)) == pytest.approx((1.515, 4.04))
    np.testing.assert_allclose(changed("azimuth_scale", 0.02).azimuth, 1.02 * np.asarray(SONAR.azimuth), rtol=1e-5)
    bent, outer = np.asarray(changed("beam_bend", 0.1).azimuth), float(SONAR.azimuth[-1])
    assert bent[-1] == pytest.approx(outer, rel=1e-5)  # the outer beams and the middle stay
    u = np.asarray(SONAR.azimuth) / outer
    np.testing.assert_allclose(bent, outer * (u + 0.1 * (u - u**3)), rtol=1e-4, atol=1e-6)
    skewed = np.asarray(changed("beam_skew", 0.1).azimuth)
    np.testing.assert_allclose(skewed, outer * (u + 0.1 * (u**2 - 1 / 3)), rtol=1e-4, atol=1e-6)
    assert np.mean(skewed) == pytest.approx(0.0, abs=0.002)  # the fan as a whole is not turned: that is yaw's and y's


def test_names_come_in_one_order() -> None:
    assert check_free(["height", "tilt"]) == ("tilt", "height")


@pytest.mark.parametrize("free", [(), ("tilt", "tilt"), ("tilt", "pitch"), "yaw"])
def test_free_numbers_that_do_not_exist_are_refused(free) -> None:
    with pytest.raises(sj.SonarjaxError, match=r"free: expected names .*: tilt, roll, height"):
        check_free(free)


def test_prior_is_given_or_stated_or_usual() -> None:
    stated = SONAR.replace(geometry_std=GeometryStd(height=0.02))
    found = prior_std(("tilt", "roll", "height"), {"tilt": 0.01}, stated)
    np.testing.assert_allclose(found, [0.01, math.radians(3.0), 0.02])


@pytest.mark.parametrize(("prior", "what"), [({"roll": 0.1}, "not among"), ({"tilt": 0.0}, "positive"),
                                             ({"tilt": math.nan}, "positive")])  # fmt: skip
def test_priors_that_cannot_be_are_refused(prior, what) -> None:
    with pytest.raises(sj.SonarjaxError, match=what):
        prior_std(("tilt", "height"), prior, SONAR)
