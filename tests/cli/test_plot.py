"""`plot.py`: units on the axes, port on the left, geometry of the fan, outlines where the template lies."""

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from PIL import Image

from sonarjax import plot
from sonarjax.io import SonarjaxError
from sonarjax.render import SonarFrame
from sonarjax.sonar import Sonar


@pytest.fixture(scope="module")
def sonar():
    azimuth = jnp.asarray(np.radians([-10.0, -4.0, 0.0, 5.0, 12.0]), jnp.float32)  # uneven
    return Sonar.preset("didson-hf", n_ranges=20).replace(azimuth=azimuth)


@pytest.fixture
def axes():
    return Figure().subplots()


def port_bright(sonar) -> np.ndarray:
    """An image (range, beam) whose port-most beam is bright, starboard-most dark."""
    return np.broadcast_to(np.linspace(0, 1, sonar.n_beams, dtype=np.float32), sonar.shape)


def corners(mesh) -> np.ndarray:
    """Cell corners (range_edge, beam_edge, 2) in the axes' own coordinates."""
    return mesh.get_coordinates()


def test_polar_axes_are_degrees_and_metres(axes, sonar):
    plot.plot_polar(axes, port_bright(sonar), sonar)
    assert axes.get_xlabel() == "azimuth, to port [°]"
    assert axes.get_ylabel() == "range [m]"
    assert axes.get_ylim() == pytest.approx((1.5, 4.0))
    edges = np.degrees(np.asarray(sonar.azimuth_edges))
    assert axes.get_xlim() == pytest.approx((edges[-1], edges[0]))


def test_fan_axes_are_metres_of_equal_length(axes, sonar):
    mesh = plot.plot_fan(axes, port_bright(sonar), sonar)
    assert axes.get_xlabel() == "lateral, to port [m]"
    assert axes.get_ylabel() == "forward, slant range [m]"
    assert axes.get_aspect() == 1
    # Every corner lies at its own range and azimuth from (0, 0).
    lateral, forward = np.moveaxis(corners(mesh), -1, 0)
    np.testing.assert_allclose(np.hypot(lateral, forward), np.linspace(1.5, 4, 21)[:, None] * np.ones(6), rtol=1e-6)
    np.testing.assert_allclose(np.arctan2(lateral, forward)[0], np.asarray(sonar.azimuth_edges), atol=1e-6)


@pytest.mark.parametrize("draw", [plot.plot_polar, plot.plot_fan])
def test_port_is_left_and_far_is_up_on_the_screen(axes, sonar, draw):
    mesh = draw(axes, port_bright(sonar), sonar)
    screen = axes.transData.transform(corners(mesh).reshape(-1, 2)).reshape(21, 6, 2)
    starboard, port = screen[10, 0, 0], screen[10, -1, 0]
    assert port < starboard
    assert screen[0, 3, 1] < screen[-1, 3, 1]


def test_port_is_left_in_the_pixels(axes, sonar, tmp_path):
    plot.plot_fan(axes, port_bright(sonar), sonar)
    axes.set_axis_off()
    plot.save_figure(axes.figure, tmp_path / "fan.png", dpi=50)
    pixels = np.asarray(Image.open(tmp_path / "fan.png").convert("L")).astype(float)
    row = pixels[int(pixels.shape[0] * 0.4)]
    inside = np.flatnonzero(row < 250)  # the port-most beam is as white as the paper
    assert row[inside[:3]].mean() > row[inside[-3:]].mean() + 100


@pytest.mark.parametrize("draw", [plot.plot_polar, plot.plot_fan])
def test_an_image_of_another_shape_is_refused(axes, sonar, draw):
    with pytest.raises(SonarjaxError, match=r"\(20, 5\)"):
        draw(axes, np.zeros((5, 20), np.float32), sonar)


def frame_of(sonar) -> SonarFrame:
    """A frame with a highlight, a shadow and unlit floor, without rendering."""
    highlight, shadow = np.zeros(sonar.shape, np.float32), np.zeros(sonar.shape, np.float32)
    highlight[8:10, 2:4], shadow[10:15, 2:4] = 1, 1
    lit = np.broadcast_to(np.arange(20)[:, None] > 5, sonar.shape)
    layers = (jnp.asarray(layer) for layer in ((1 + highlight) * lit, highlight, shadow, lit))
    return SonarFrame(*layers, jnp.zeros((), jnp.int32), sonar)


def test_a_frame_is_shown_in_both_views(sonar, tmp_path):
    figure = plot.plot_frame(frame_of(sonar), sonar)
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert [title.rpartition(", ")[2] for title in titles] == ["polar view", "fan view"] * 2
    plot.save_figure(figure, tmp_path / "frame.png", dpi=40)
    assert (tmp_path / "frame.png").read_bytes()[:4] == b"\x89PNG"


def test_a_dark_frame_is_shown_too(sonar, tmp_path):
    dark = jnp.zeros(sonar.shape)
    frame = SonarFrame(dark, dark, dark, dark > 0, jnp.zeros((), jnp.int32), sonar)
    figure = plot.plot_frame(frame, sonar)
    drawn = [part for axes in figure.axes for part in axes.collections if isinstance(part, QuadMesh)]
    unlit = [part for part in drawn if np.ma.getmaskarray(part.get_array()).all()]
    assert len(unlit) == 4  # intensity and map, in both views
    for part in unlit:
        colours = part.get_cmap()(part.norm(part.get_array()))
        np.testing.assert_allclose(np.reshape(colours, (-1, 4)), [to_rgba(plot.UNLIT_COLOR)] * part.get_array().size)
    plot.save_figure(figure, tmp_path / "dark.png", dpi=40)
    assert (tmp_path / "dark.png").read_bytes()[:4] == b"\x89PNG"


def test_decibel():
    values = plot.decibel(np.array([[1.0, 0.1, 0.0]]), floor=-30.0)
    np.testing.assert_allclose(values, [[0, -10, -30]])
    assert (plot.decibel(np.zeros((2, 2)), floor=-30.0) == -30).all()


def test_scores_are_drawn_in_degrees_with_the_best_marked(axes):
    yaws = np.radians([-10.0, 0.0, 90.0, 180.0])
    plot.plot_scores(axes, yaws, np.array([0.9, 0.1, 0.3, 0.2]), threshold=0.5)
    curve, best, _ = axes.lines
    np.testing.assert_allclose(curve.get_xdata(), [0, 90, 180, 350], atol=1e-9)
    np.testing.assert_allclose(best.get_xdata(), 350)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("yaw [°]", "correlation")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["best: 350°", "threshold: 0.50"]


def test_scores_without_a_number_are_drawn(axes):
    plot.plot_scores(axes, np.zeros(2), np.full(2, np.nan))
    assert axes.get_legend() is None


@pytest.mark.parametrize("view", ["polar", "fan"])
def test_an_outline_lies_around_its_template(axes, sonar, view):
    (plot.plot_polar if view == "polar" else plot.plot_fan)(axes, port_bright(sonar), sonar)
    template = np.full((12, 4), 0.5)
    template[3:5, 1:3], template[5:9, 1:3] = 1.0, 0.0
    plot.draw_outline(axes, template, sonar, offset=(5, 1), view=view)
    highlight, shadow = (item for item in axes.collections if isinstance(item, QuadContourSet))
    near, far = (np.concatenate([path.vertices for path in item.get_paths()])[:, 1] for item in (highlight, shadow))
    bins = 1.5 + (np.array([8, 10, 14]) * 0.125)  # first highlight row, first shadow row, one past the last
    slack = 0.125 if view == "polar" else 0.16  # half-way between pixel centres; forward is shorter than range
    assert near.min() == pytest.approx(bins[0], abs=slack)
    assert near.max() == pytest.approx(bins[1], abs=slack)
    assert far.max() == pytest.approx(bins[2], abs=slack)


def test_an_outline_must_lie_in_the_image_and_may_be_empty(axes, sonar):
    plot.draw_outline(axes, np.full((4, 3), 0.5), sonar)
    plot.draw_outline(axes, np.ones((1, 3)), sonar)
    assert not axes.collections
    with pytest.raises(SonarjaxError, match="outline"):
        plot.draw_outline(axes, np.ones((4, 3)), sonar, offset=(18, 0))


def test_a_saved_figure_is_reproducible_and_all_or_nothing(axes, tmp_path):
    for name in ("a.png", "b.png", "c.pdf", "d.svg"):
        plot.save_figure(axes.figure, tmp_path / name, dpi=40)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "c.pdf").read_bytes()[:4] == b"%PDF"
    assert b"<svg" in (tmp_path / "d.svg").read_bytes()
    with pytest.raises(SonarjaxError, match="cannot be written"):
        plot.save_figure(axes.figure, tmp_path / "absent" / "a.png")


def test_calibration_needs_a_template_of_each_kind_for_each_frame(sonar):
    frames = [port_bright(sonar)] * 2
    with pytest.raises(SonarjaxError, match="expected as many templates of each kind as frames, got 2, 2 and 1"):
        plot.plot_calibration(frames, frames, frames[:1], sonar)
