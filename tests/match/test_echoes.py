"""Echo templates: their box, a grey against the closed form, and what they find in a simulated frame."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.engine import PLAIN
from sonarjax.match.echoes import echo_templates
from sonarjax.match.search import SearchConfig, TargetSearch
from sonarjax.render import Window, plan_window
from sonarjax.sensor import EchoLaw, SensorModel, observe_scene, stored_echo

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0))
YAWS = np.radians([0.0, 50.0, 200.0])


def drawn(mesh: sj.Mesh, sonar: sj.Sonar = SONAR) -> tuple[sj.TemplateBank, np.ndarray]:
    size = plan_window(mesh, sonar, 2.3)
    quality = sj.RenderQuality(sub_beams=1)
    bank = sj.template_bank(mesh, sonar, YAWS, x=2.3, size=size, quality=quality)
    return bank, echo_templates(bank, mesh, sonar, size, quality, PLAIN)


def test_they_lie_in_the_box_of_the_bank_with_the_floor_at_one_half() -> None:
    bank, echoes = drawn(sj.objects.target())
    semantic = np.asarray(bank.templates)
    assert echoes.shape == semantic.shape
    assert np.abs(echoes - 0.5).max() == pytest.approx(0.5)
    inner = np.zeros(semantic.shape, bool)
    inner[:, 3:-3, 2:-2] = True
    lit, hidden = (inner & (semantic == grey) for grey in (1.0, 0.0))
    assert (echoes[lit] > 0.5).mean() > 0.95
    assert (echoes[hidden] < 0.5).mean() > 0.7  # echoes by way of the floor lie in the shadow too
    corner = echoes[:, :2, :2]  # the margin in front of the object: bare floor
    assert np.allclose(corner, 0.5, atol=1e-6)


def test_a_grey_is_a_power_of_the_energy_over_the_floors() -> None:
    """An echo as wide as a bin's floor, bare floor and full shadow, against the closed form."""
    height, edges = float(SONAR.height), np.asarray(SONAR.range_edges, np.float64)
    rows = np.arange(200, 240)
    floor = np.arcsin(height / edges[rows]) - np.arcsin(height / edges[rows + 1])
    echo = np.stack([floor, 0 * floor, 0 * floor], axis=1).astype(np.float32)
    shadow = np.zeros_like(echo)
    shadow[:, 2] = 1.0
    law = EchoLaw(*(jnp.float32(v) for v in (5.0, 0.1, 0.25)))
    found = np.asarray(stored_echo(jnp.asarray(echo), jnp.asarray(shadow), SONAR, Window(200, 0, (40, 3)), law))
    assert np.allclose(found, [6.1**0.25 - 1.1**0.25, 0.0, 0.1**0.25 - 1.1**0.25], atol=2e-4)


@pytest.mark.slow
@pytest.mark.computes
def test_a_frame_correlates_more_with_them_than_with_semantic_templates(key: jax.Array) -> None:
    """Also the yaw is found, without any segmentation."""
    mesh, truth = sj.objects.target(), sj.Pose(x=2.2, y=0.1, yaw=math.radians(100.0))
    image = np.asarray(observe_scene(mesh, truth, SONAR, SensorModel.nominal(), key=key)[0])
    search = TargetSearch(mesh, SONAR, SearchConfig(range_step=0.2))
    of_map, of_echo = (search.find(image, picture=picture) for picture in ("map", "frame"))
    assert of_echo.scores.max() > of_map.scores.max()
    above = [float(found.scores.max() - np.median(found.scores)) for found in (of_map, of_echo)]
    assert above[1] > 1.2 * above[0]
    assert math.dist(search.place(of_echo), (2.2, 0.1)) < 0.05
    found = float(of_echo.bank.yaws[of_echo.scores.argmax()]) + math.atan2(0.1, 2.2)
    assert abs(math.remainder(found - float(truth.yaw), 2 * math.pi)) < math.radians(10.0)


@pytest.mark.slow
def test_a_catalogue_keeps_them_small_and_finds_the_same() -> None:
    mesh = sj.objects.brick()
    image = np.asarray(sj.render(mesh, sj.Pose(x=2.3, yaw=0.4), SONAR).semantic())
    whole, compact = (
        TargetSearch(mesh, SONAR, SearchConfig(yaw_bins=12), compact=compact).find_near(3, image, None, "frame")
        for compact in (False, True)
    )
    assert np.allclose(whole.scores, compact.scores, atol=0.01)
    assert compact.bank.templates.size == 0
