"""The renderer against closed forms: floor ranges, energies, silhouettes, shadows, symmetries, several objects."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sonarjax.io.errors import SonarjaxError
from sonarjax.render import RenderQuality, render
from sonarjax.scene import Mesh, Pose, objects
from sonarjax.sonar import Sonar
from sonarjax.sonar.parts import FloorPatch

HEIGHT = 0.9
APERTURE = math.radians(14.0)
SONAR = Sonar.preset("didson-hf", tilt=math.radians(20.0), height=HEIGHT)
FREE = SONAR.replace(tilt=0.0, height=20.0)  # the floor lies far outside the aperture
LOW = SONAR.replace(tilt=0.0, height=0.3)  # level, and the floor is in view beyond 0.3 / sin 7° = 2.46 m
CUBE = Mesh.from_arrays(*objects.box((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
AWAY = Pose(x=-5.0)  # behind the sonar
BIN = 2.5 / 512


def box(size, center=(0.0, 0.0, 0.0)):
    """A box as CUBE's arrays moved, so that all tests share one compiled renderer."""
    return CUBE.with_vertices(CUBE.vertices * jnp.asarray(size) + jnp.asarray(center))


def skewed(mirror=False):
    """A box without any symmetry, and its mirror image in y with its triangles turned outwards again."""
    rng = np.random.default_rng(3)
    vertices = np.asarray(box((0.22, 0.16, 0.12), (0.0, 0.0, 0.09)).vertices)
    vertices = (vertices + rng.uniform(-0.02, 0.02, vertices.shape)).astype(np.float32)
    if not mirror:
        return CUBE.with_vertices(jnp.asarray(vertices))
    flipped = vertices * np.array([1, -1, 1], np.float32)
    return replace(CUBE, faces=CUBE.faces[:, jnp.array([0, 2, 1])]).with_vertices(jnp.asarray(flipped))


def layers(frame):
    return [np.asarray(v, np.float64) for v in (frame.intensity, frame.highlight, frame.shadow)]


def assert_same(first, second, atol=1e-4):
    """Each layer agrees within `atol` of its largest value."""
    for a, b in zip(layers(first), layers(second), strict=True):
        np.testing.assert_allclose(a, b, atol=atol * b.max())


def rms(first, second):
    """Root of the squared difference over the squared image, for each layer."""
    return np.array([np.sqrt(((a - b) ** 2).sum() / (b**2).sum()) for a, b in zip(first, second, strict=True)])


def edges_of(sonar):
    return np.asarray(sonar.range_edges, np.float64)


def middles_of(sonar):
    edges = edges_of(sonar)
    return (edges[1:] + edges[:-1]) / 2


def floor_range(sonar, azimuth, elevation):
    """Slant range of the floor at an azimuth and elevation of the tilted sonar frame; inf above the horizon."""
    t = float(sonar.tilt)
    down = np.cos(elevation) * np.cos(azimuth) * math.sin(t) - np.sin(elevation) * math.cos(t)
    return np.where(down > 1e-9, float(sonar.height) / np.maximum(down, 1e-9), np.inf)


@pytest.fixture(scope="module")
def empty():
    return render(CUBE, AWAY, SONAR)


# ---------------------------------------------------------------- the floor


@pytest.mark.parametrize("tilt_deg", [15.0, 20.0, 25.0])
def test_floor_is_seen_where_the_aperture_says(tilt_deg):
    sonar = SONAR.replace(tilt=math.radians(tilt_deg))
    frame = render(CUBE, AWAY, sonar)
    azimuth = np.asarray(sonar.azimuth, np.float64)
    near, far = floor_range(sonar, azimuth, -APERTURE / 2), floor_range(sonar, azimuth, APERTURE / 2)
    assert near.min() == pytest.approx(HEIGHT / math.sin(math.radians(tilt_deg) + APERTURE / 2), rel=1e-4)
    middle = middles_of(sonar)[:, None]
    margin = 1e-5  # float32
    lit = np.asarray(frame.lit)
    assert lit[(middle > near + margin) & (middle < far - margin)].all()
    assert not lit[(middle < near - margin) | (middle > far + margin)].any()
    edges, echo = edges_of(sonar)[:, None], np.asarray(frame.intensity)
    assert (echo[(edges[1:] > near + margin) & (edges[:-1] < far - margin)] > 0).all()
    assert (echo[(edges[1:] < near - margin) | (edges[:-1] > far + margin)] == 0).all()
    assert not np.asarray(frame.highlight).any() and not np.asarray(frame.shadow).any()


@pytest.mark.parametrize("tilt_deg", [15.0, 20.0, 25.0])
def test_floor_range_and_energy_at_each_elevation(tilt_deg):
    sonar = SONAR.replace(tilt=math.radians(tilt_deg))
    echo = np.asarray(render(CUBE, AWAY, sonar).intensity, np.float64)
    edges, middle = edges_of(sonar), middles_of(sonar)
    elevation = np.linspace(-APERTURE / 2, APERTURE / 2, 40001)
    for beam in (0, 20, 48, 95):
        ranges = floor_range(sonar, float(sonar.azimuth[beam]), elevation)
        at_edge = np.interp(edges, ranges, elevation)  # clamped to the aperture
        # A bin holds the elevations Δφ between its edges, each with 1/r². Near the bin's middle: Δr/r is 0.3 %.
        np.testing.assert_allclose(echo[:, beam], np.diff(at_edge) / middle**2, rtol=6e-3, atol=3e-7)
        # Summed up from the near edge, r² × energy is the elevation at which a range is seen.
        seen = -APERTURE / 2 + np.cumsum(echo[:, beam] * middle**2)
        np.testing.assert_allclose(seen[50:], at_edge[51:] - (at_edge[0] + APERTURE / 2), atol=math.radians(0.02))


def test_floor_patch():
    patch = FloorPatch(x=2.2, y=0.05, length=0.6, width=0.3, yaw=0.2)
    sonar = SONAR.replace(floor=patch)
    mesh = box((0.1, 0.1, 0.1), (0.0, 0.0, 0.05))
    frame = render(mesh, Pose(x=2.25, y=0.05), sonar)
    bare = render(mesh, AWAY, sonar)
    endless = render(mesh, Pose(x=2.25, y=0.05), SONAR)
    inside, certain = np.zeros(sonar.shape, bool), np.zeros(sonar.shape, bool)
    energy = np.zeros(sonar.n_beams)
    elevation = np.linspace(-APERTURE / 2, APERTURE / 2, 20001)
    for beam, azimuth in enumerate(np.asarray(sonar.azimuth, np.float64)):
        r = floor_range(sonar, azimuth, elevation)
        t = float(sonar.tilt)
        x = r * (np.cos(elevation) * np.cos(azimuth) * math.cos(t) + np.sin(elevation) * math.sin(t)) - patch.x
        y = r * np.cos(elevation) * np.sin(azimuth) - patch.y
        along, across = math.cos(0.2) * x + math.sin(0.2) * y, math.cos(0.2) * y - math.sin(0.2) * x
        slack = np.minimum(patch.length / 2 - np.abs(along), patch.width / 2 - np.abs(across))
        at = np.interp(middles_of(sonar), r, slack, left=-1.0, right=-1.0)
        inside[:, beam], certain[:, beam] = at > 0, np.abs(at) > 1e-4
        energy[beam] = np.trapezoid(np.where(slack > 0, 1 / r**2, 0.0), elevation)
    lit = np.asarray(bare.lit)
    assert inside.sum() > 1000
    np.testing.assert_array_equal(lit[certain], inside[certain])
    # A bin that ends at the platform's edge may catch what rounding leaves of it.
    assert np.asarray(bare.intensity)[_eroded(~lit, 1, 0)].max() < 1e-4 * np.asarray(bare.intensity).max()
    # Range bins that the edge cuts have their share of the energy.
    np.testing.assert_allclose(np.asarray(bare.intensity).sum(0), energy, rtol=2e-3, atol=1e-5)
    # The object is as bright as on an endless floor, and its shadow ends with the platform.
    # A difference of 1e-4 is a few units in the last place of an end [bins].
    np.testing.assert_allclose(frame.highlight, endless.highlight, atol=1e-4)
    shadow, whole = np.asarray(frame.shadow), np.asarray(endless.shadow)
    assert whole[~inside].max() > 0.99  # the case cuts the shadow
    deep, off = _eroded(inside), _eroded(~inside)
    np.testing.assert_allclose(shadow[deep], whole[deep], atol=3e-3)  # 15 µm of range: float32
    assert shadow[off].max() < 1e-3  # an end that sweeps over the platform's edge inside one slab


def test_energy_of_a_platform_has_a_derivative_by_its_length():
    def energy(length):
        patch = FloorPatch(x=2.2, y=0.05, length=length, width=0.3, yaw=0.2)
        return render(box((0.1, 0.1, 0.1)), AWAY, SONAR.replace(floor=patch)).intensity.sum()

    values = np.array([float(energy(jnp.float32(length))) for length in (0.58, 0.6, 0.62)])
    slope = float(jax.grad(energy)(jnp.float32(0.6)))
    assert slope == pytest.approx((values[2] - values[0]) / 0.04, rel=0.05)
    assert values[1] == pytest.approx((values[0] + values[2]) / 2, rel=0.01)


def _eroded(mask, rows=3, columns=1):
    """True where all pixels within a few rows and columns are True."""
    out = mask.copy()
    for dr in range(-rows, rows + 1):
        for dc in range(-columns, columns + 1):
            out &= np.roll(mask, (dr, dc), (0, 1))
    return out


# ---------------------------------------------------------------- energy


def plate_energy(distance, half_height, azimuth):
    """∫ dφ / r² over an upright plate at `distance`: r = ρ / cos φ with ρ = distance / cos(azimuth)."""
    rho = distance / np.cos(azimuth)
    phi = np.arctan(half_height / rho)
    return (phi + np.sin(phi) * np.cos(phi)) / rho**2


@pytest.mark.parametrize("distance", [1.6, 2.3, 3.1, 3.9])
def test_energy_of_a_plate(distance):
    half = 0.05
    frame = render(box((0.02, 4.0, 2 * half), (0.01, 0, 0)), Pose(x=distance, z=20.0), FREE)
    azimuth = np.asarray(FREE.azimuth, np.float64)[16:80]  # at 3.9 m the outer beams leave the window
    echo = np.asarray(frame.intensity, np.float64).sum(0)[16:80]
    np.testing.assert_allclose(echo, plate_energy(distance, half, azimuth), rtol=2e-3)
    assert not np.asarray(frame.shadow).any() and not np.asarray(frame.lit).all()


def test_energy_falls_with_the_square_of_range():
    distances = np.array([1.6, 2.0, 2.5, 3.1, 3.9])
    energy = []
    for distance in distances:  # a plate that grows with distance keeps its solid angle
        mesh = box((0.02, 0.02 * distance, 0.04 * distance), (0.01, 0, 0))
        energy.append(np.asarray(render(mesh, Pose(x=float(distance), z=20.0), FREE).intensity, np.float64).sum())
    slope = np.polyfit(np.log(distances), np.log(energy), 1)[0]
    assert slope == pytest.approx(-2.0, abs=2e-3)


@pytest.mark.slow
def test_energy_does_not_depend_on_bins_or_elevations():
    pose = Pose(x=2.2, y=0.07, yaw=0.4)
    base = np.asarray(render(skewed(), pose, SONAR).intensity, np.float64)
    coarse = np.asarray(render(skewed(), pose, SONAR.replace(n_ranges=128)).intensity, np.float64)
    fine = np.asarray(render(skewed(), pose, SONAR, quality=RenderQuality(elevations=256)).intensity, np.float64)
    np.testing.assert_allclose(fine.sum(0), base.sum(0), rtol=2e-3)
    # Coarser bins: the middle of a bin stands for its floor, and hidden floor is taken as a share of the bin.
    np.testing.assert_allclose(coarse.sum(0), base.sum(0), rtol=2e-3)
    np.testing.assert_allclose(coarse, base.reshape(128, 4, -1).sum(1), atol=0.05 * base.max())


def test_column_energy_is_what_is_not_hidden(empty):
    """Every elevation hits one thing: Σ r² I over range is the lit part of the aperture, with or without an object."""
    frame = render(skewed(), Pose(x=2.2, yaw=0.4), SONAR)
    middle = middles_of(SONAR)[:, None]
    with_object, without = ((np.asarray(f.intensity, np.float64) * middle**2).sum(0) for f in (frame, empty))
    np.testing.assert_allclose(with_object, without, rtol=4e-3)


# ---------------------------------------------------------------- geometry of the echo


@pytest.mark.parametrize(("x", "y"), [(1.9, 0.0), (1.9, 0.15), (2.2, 0.15), (2.5, -0.25)])
def test_nearest_point_of_a_ball(x, y):
    radius = 0.11
    frame = render(objects.ball(radius), Pose(x=x, y=y), SONAR)
    rows = np.flatnonzero((np.asarray(frame.highlight) > 1e-3).any(axis=1))
    nearest = math.hypot(math.hypot(x, y), HEIGHT - radius) - radius
    assert edges_of(SONAR)[rows[0]] == pytest.approx(nearest, abs=1.5 * BIN)  # a bin, and half a pulse


@pytest.mark.parametrize("height", [0.06, 0.12, 0.2])
def test_shadow_length_behind_a_box(height):
    front, back = 2.0, 2.1
    frame = render(box((back - front, 0.8, height), (0.0, 0.0, height / 2)), Pose(x=(front + back) / 2), SONAR)
    shadow = np.asarray(frame.shadow, np.float64)
    stretch = HEIGHT / (HEIGHT - height)  # the ray over the top rear edge goes on to the floor
    start, end = math.hypot(front, HEIGHT), stretch * math.hypot(back, HEIGHT - height)
    for beam in (47, 48):  # 0.15° off the axis, ranges are longer by 3e-6
        rows = np.flatnonzero(shadow[:, beam] > 0.5)
        assert shadow[:, beam].sum() * BIN == pytest.approx(end - start, abs=0.05 * BIN)
        assert edges_of(SONAR)[rows[0]] == pytest.approx(start, abs=0.51 * BIN)
        assert edges_of(SONAR)[rows[-1] + 1] == pytest.approx(end, abs=0.51 * BIN)
    labels = np.asarray(frame.labels())
    assert labels[np.searchsorted(edges_of(SONAR), end) - 3, 48] == 2


@pytest.mark.parametrize(("width", "y"), [(0.1, 0.0), (0.203, 0.1), (0.0305, -0.2)])
def test_azimuth_width(width, y):
    """A plate square to the axis is between two azimuths: each beam's energy is the part of it that the plate fills."""
    distance, half = 2.2, 0.05
    frame = render(box((0.004, width, 2 * half), (0.002, 0, 0)), Pose(x=distance, y=y, z=20.0), FREE)
    low, high = math.atan((y - width / 2) / distance), math.atan((y + width / 2) / distance)
    bounds = np.asarray(FREE.azimuth_edges, np.float64)
    filled = np.clip((np.minimum(bounds[1:], high) - np.maximum(bounds[:-1], low)) / np.diff(bounds), 0, 1)
    # Off the axis a side of the plate, 4 mm deep, is seen too: 0.4 mm across, 4 % of a beam.
    side = 0.0 if abs(y) < width / 2 else 0.04
    echo = np.asarray(frame.intensity, np.float64).sum(0) / plate_energy(distance, half, np.asarray(FREE.azimuth))
    np.testing.assert_allclose(echo, filled, atol=3e-3 + side)
    total = (np.asarray(frame.highlight, np.float64).sum(0) > 1e-3).sum()
    assert total == pytest.approx((filled > 1e-3).sum(), abs=1)


def test_a_face_square_to_the_beam_is_one_pulse_thick():
    mesh = box((0.02, 4.0, 0.04), (0.01, 0, 0))
    for pulse, expected in ((0.0, BIN), (BIN / 3, BIN), (0.02, 0.02), (0.05, 0.05)):
        frame = render(mesh, Pose(x=2.3, z=20.0), FREE.replace(pulse_length=pulse))
        column = np.asarray(frame.highlight, np.float64)[:, 48]
        assert column.sum() * BIN == pytest.approx(expected, rel=2e-3)
        middle = (column * middles_of(FREE)).sum() / column.sum()
        assert middle == pytest.approx(2.3, abs=0.1 * BIN)  # the echo is centred on the face


def test_highlight_max_incidence():
    height, front, back = 0.1, 2.0, 2.2
    mesh, pose = box((back - front, 0.8, height), (0, 0, height / 2)), Pose(x=(front + back) / 2)
    every = render(mesh, pose, SONAR)
    steep = render(mesh, pose, SONAR.replace(highlight_max_incidence=45.0))  # the top is struck at 68° and more
    bottom, edge = math.hypot(front, HEIGHT), math.hypot(front, HEIGHT - height)
    rear = math.hypot(back, HEIGHT - height)
    for frame, length in ((every, max(bottom, rear) - edge), (steep, bottom - edge)):
        assert np.asarray(frame.highlight, np.float64)[:, 48].sum() * BIN == pytest.approx(length, abs=0.05 * BIN)
    np.testing.assert_allclose(steep.shadow, every.shadow, atol=1e-4)
    np.testing.assert_allclose(steep.intensity, every.intensity, rtol=1e-3, atol=1e-7)


# ---------------------------------------------------------------- classes


def test_classes_sum_to_one_and_give_the_grey_image():
    frame = render(skewed(), Pose(x=2.2, y=0.1, yaw=1.0), SONAR)
    h, s = np.asarray(frame.highlight, np.float64), np.asarray(frame.shadow, np.float64)
    assert min(h.min(), s.min()) >= 0 and max(h.max(), s.max()) <= 1 + 1e-6  # float32
    assert h.max() > 0.99 and s.max() > 0.99
    shares = np.stack([(1 - h) * (1 - s), h, s * (1 - h)])
    np.testing.assert_allclose(shares.sum(0), 1.0, atol=1e-6)
    np.testing.assert_allclose(frame.semantic(), 0.5 * shares[0] + shares[1], atol=1e-6)
    labels = np.asarray(frame.labels())
    assert labels.dtype == np.uint8 and set(np.unique(labels)) == {0, 1, 2}
    assert (np.take_along_axis(shares, labels[None].astype(int), 0)[0] >= shares.max(0) - 1e-6).all()
    assert frame.intensity.shape == frame.lit.shape == labels.shape == (512, 96)


# ---------------------------------------------------------------- symmetries


def test_mirror_in_azimuth():
    there = render(skewed(), Pose(x=2.2, y=0.13, yaw=0.7), SONAR)
    back = render(skewed(mirror=True), Pose(x=2.2, y=-0.13, yaw=-0.7), SONAR)
    for a, b in zip(layers(there), layers(back), strict=True):
        assert a.max() > 0
        np.testing.assert_allclose(a[:, ::-1], b, atol=2e-3 * b.max())
        assert np.abs(a[:, ::-1] - b).mean() < 1e-6


def test_yaw_by_a_full_turn():
    first = render(skewed(), Pose(x=2.2, y=0.1, yaw=0.3), SONAR)
    assert_same(render(skewed(), Pose(x=2.2, y=0.1, yaw=0.3 + 2 * math.pi), SONAR), first, atol=1e-3)
    assert_same(render(skewed(), Pose(x=2.2, y=0.1, yaw=0.3 - 2 * math.pi), SONAR), first, atol=1e-3)


def test_raising_object_and_sonar_together_changes_nothing():
    """Without a floor in view only the distance from the head counts."""
    first = render(skewed(), Pose(x=2.2, y=0.1, yaw=0.3, z=19.95), FREE)
    second = render(skewed(), Pose(x=2.2, y=0.1, yaw=0.3, z=15.95), FREE.replace(height=16.0))
    assert np.asarray(first.highlight).max() > 0.9
    assert_same(second, first, atol=2e-3)  # 20 m in float32 is good to 2 µm, 4e-4 bins


def test_tilting_and_rolling_object_and_sonar_together_changes_nothing():
    """Without a floor in view, turning the scene about the head by the sonar's own rotation gives the same image."""
    tilt, roll, p = 0.3, 0.15, np.array([2.2, 0.1, -0.06])
    ry = np.array([[math.cos(tilt), 0, math.sin(tilt)], [0, 1, 0], [-math.sin(tilt), 0, math.cos(tilt)]])
    rx = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    moved = ry @ rx @ p
    first = render(skewed(), Pose(x=float(p[0]), y=float(p[1]), z=20.0 + float(p[2])), FREE)
    turned = Pose(x=float(moved[0]), y=float(moved[1]), z=20.0 + float(moved[2]), roll=roll, pitch=tilt)
    second = render(skewed(), turned, FREE.replace(tilt=tilt, roll=roll))
    assert np.asarray(first.highlight).max() > 0.9
    assert_same(second, first, atol=3e-3)


def test_turning_the_object_about_a_level_sonar_shifts_the_image_by_beams():
    """A level sonar and an endless floor are the same in every direction: one beam's angle is one column."""
    step, start = math.radians(29.0 / 96), 0.03
    frames = []
    for beams in (0, 1, 10):
        angle = start + beams * step
        pose = Pose(x=2.3 * math.cos(angle), y=2.3 * math.sin(angle), yaw=0.5 + angle)
        frames.append((beams, render(skewed(), pose, LOW)))
    assert np.asarray(frames[0][1].highlight).max() > 0.9 and np.asarray(frames[0][1].shadow).max() > 0.9
    for beams, frame in frames[1:]:
        for a, b in zip(layers(frames[0][1]), layers(frame), strict=True):
            np.testing.assert_allclose(a[:, : 96 - beams], b[:, beams:], atol=3e-3 * max(b.max(), 1e-9))


# ---------------------------------------------------------------- nothing there


@pytest.mark.parametrize(
    "pose",
    [
        Pose(x=2.2, z=1.0),  # above the aperture
        Pose(x=0.6),  # under the aperture
        Pose(x=-2.2),  # behind the sonar
        Pose(x=2.2, z=-0.5),  # below the floor
        Pose(x=2.2, y=1.5),  # beside the fan
        Pose(x=5.5, z=0.3),  # beyond the window, its shadow too
    ],
    ids=["above", "under", "behind", "below", "beside", "beyond"],
)
def test_out_of_view_gives_the_empty_floor(empty, pose):
    frame = render(box((0.2, 0.2, 0.1), (0, 0, 0.05)), pose, SONAR)
    for a, b in zip(layers(frame), layers(empty), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    np.testing.assert_array_equal(frame.lit, empty.lit)
    assert (np.asarray(frame.semantic()) == 0.5).all() and not np.asarray(frame.labels()).any()


def test_object_half_in_the_floor_is_seen_above_it():
    """What is below the floor does not count: a box sunk by half looks like one of half the height."""
    sunk = render(box((0.2, 0.2, 0.2)), Pose(x=2.1, yaw=0.3), SONAR)
    half = render(box((0.2, 0.2, 0.1), (0, 0, 0.05)), Pose(x=2.1, yaw=0.3), SONAR)
    # Corners under the floor split the beams elsewhere: equal up to the sub-beams' resolution, not to rounding.
    assert (rms(layers(sunk), layers(half)) < [0.05, 0.03, 0.03]).all()


def test_aperture_cuts_a_tall_post():
    """A post from the floor to above the sonar is lit only between the aperture's two edges."""
    x = 2.2
    frame = render(box((0.1, 0.3, 2.0), (0.05, 0, 1.0)), Pose(x=x), SONAR)
    low, high = math.radians(20) + APERTURE / 2, math.radians(20) - APERTURE / 2  # depressions
    bottom, top = min(x / math.cos(low), math.hypot(x, HEIGHT)), x / math.cos(high)
    column = np.asarray(frame.highlight, np.float64)[:, 48]
    assert column.sum() * BIN == pytest.approx(bottom - top, abs=0.05 * BIN)
    rows = np.flatnonzero(column > 0.5)
    assert edges_of(SONAR)[rows[0]] == pytest.approx(top, abs=0.51 * BIN)
    # All floor behind it is hidden.
    behind = middles_of(SONAR) > math.hypot(x, HEIGHT) + BIN
    np.testing.assert_allclose(np.asarray(frame.shadow)[behind, 48], 1.0, atol=1e-5)


# ---------------------------------------------------------------- several objects


def test_two_objects_far_apart_are_the_union(empty):
    poses = [Pose(x=2.2, y=0.3, yaw=0.3), Pose(x=2.0, y=-0.3, yaw=1.0)]
    meshes = [skewed(), box((0.1, 0.2, 0.1), (0, 0, 0.05))]
    both = render(meshes, poses, SONAR)
    one, two = (render(m, p, SONAR) for m, p in zip(meshes, poses, strict=True))
    union = [a + b - e for a, b, e in zip(layers(one), layers(two), layers(empty), strict=True)]
    # Shares are the same; energy is cut in cells whose number depends on the triangles in the scene.
    assert (rms(layers(both), union) < [0.05, 1e-4, 1e-4]).all()
    np.testing.assert_array_equal(both.lit, np.asarray(one.lit) | np.asarray(two.lit))


@pytest.mark.slow
def test_front_object_hides_the_one_behind():
    front, small = box((0.05, 0.6, 0.2), (0, 0, 0.1)), box((0.1, 0.1, 0.1), (0, 0, 0.05))
    # The shadow's edge is 0.9 − 2.2·0.7/2.025 = 0.14 m high above the small box's rear.
    poses = [Pose(x=2.0), Pose(x=2.15)]
    both, alone = render([front, small], poses, SONAR), render(front, poses[0], SONAR)
    assert (rms(layers(both), layers(alone)) < [0.05, 1e-3, 1e-3]).all()
    swapped = render([small, front], poses[::-1], SONAR)  # the order plays no part
    assert (rms(layers(swapped), layers(both)) < 1e-3).all()


def test_wrong_calls_are_refused():
    with pytest.raises(SonarjaxError, match="poses"):
        render([CUBE, CUBE], [AWAY], SONAR)
    with pytest.raises(SonarjaxError, match="poses"):
        render([], [], SONAR)
    with pytest.raises(SonarjaxError, match="sub_beams"):
        render(CUBE, AWAY, SONAR, quality=RenderQuality(sub_beams=0))


def test_an_echo_is_lit_where_no_floor_is():
    """A box that hangs nearer than the floor that the aperture shows."""
    frame, bare = (render(box((0.2, 0.3, 0.2), (0.0, 0.0, 0.1)), pose, SONAR) for pose in (Pose(x=1.6, z=0.35), AWAY))
    before = (np.asarray(frame.highlight) > 0.5) & ~np.asarray(bare.lit)
    assert before.any() and np.asarray(frame.lit)[before].all()
    assert (np.asarray(frame.lit) | ~np.asarray(bare.lit)).all()
