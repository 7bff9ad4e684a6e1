"""Fan pictures in and out: held to OpenCV, to closed forms, and to their own way back."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from experiments.common.fans import sector_of
from sonarjax.io import (
    FanGeometry,
    FanOptions,
    PictureBox,
    SonarjaxError,
    content_box,
    fan_around,
    fan_to_polar,
    fit_fan,
    polar_to_fan,
)  # fmt: skip

OPENING, NEAR, FAR = math.radians(30), 1.0, 4.0
BINS, BEAMS = 256, 96


def fan_of(image, opening=OPENING, near=NEAR, far=FAR, pixel=0.01, **options):
    """A polar image (range, beam) as a picture that just holds it: picture, mask, geometry."""
    geometry, shape = fan_around(opening, near, far, pixel)
    axes = geometry.azimuth(image.shape[1]), geometry.range_edges(image.shape[0])
    picture, mask = polar_to_fan(image, *axes, geometry, shape, **options)
    return picture, mask, geometry


def smooth() -> np.ndarray:
    r, b = np.meshgrid(np.linspace(0, 1, BINS), np.linspace(0, 1, BEAMS), indexing="ij")
    return (0.5 + 0.3 * np.sin(6 * r) * np.cos(5 * b)).astype(np.float32)


def speckled(rng, width: float = 2.0) -> np.ndarray:
    """Rayleigh speckle of a coherent field whose grains are a Gaussian of `width` cells wide (standard deviation)."""
    real, imaginary = (gaussian_filter(rng.standard_normal((BINS, BEAMS)), width, mode="nearest") for _ in range(2))
    field = np.hypot(real, imaginary)
    return np.clip(field / field.mean() / 4, 0, 1).astype(np.float32)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(error, dtype=np.float64))))


def test_polar_image_equals_opencvs(rng):
    """OpenCV counts angles clockwise from the right and samples points: our beams and bins lie on its finer grid."""
    picture = gaussian_filter(rng.random((240, 300)), 3).astype(np.float32)
    picture = (picture - picture.min()) / np.ptp(picture)
    geometry = FanGeometry(math.radians(40), 0.0, 2.2, apex_row=230.0, apex_column=140.0, row_m=0.01, column_m=0.01)
    image, mask = fan_to_polar(picture, geometry, (220, 160), order=1)
    centre, width, height = (139.5, 229.5), 440, 2880
    theirs = cv2.warpPolar(picture, (width, height), centre, 220.0, cv2.INTER_LINEAR | cv2.WARP_POLAR_LINEAR)
    azimuth = np.degrees(geometry.azimuth(160))
    rows = np.rint((270 - azimuth) / 0.125).astype(int)
    assert np.ptp((270 - azimuth) / 0.125 - rows) < 1e-9
    wanted = theirs[rows, 1::2].T
    inner = np.s_[60:-2, 8:-8]  # at the sector's edge and apex OpenCV mixes in what is outside
    assert mask[inner].all()
    np.testing.assert_allclose(image[inner], wanted[inner], atol=0.005)  # it counts fractions of a pixel in 1/32


@pytest.mark.parametrize(("ranges", "azimuth_deg"), [(1.5, -20.0), (1.2, 25.0), (1.9, 0.0)])
def test_point_target_is_where_geometry_puts_it(ranges, azimuth_deg):
    """Starboard (negative azimuth) on the right, near below; and back into its bin and beam."""
    opening, near, far = math.radians(60), 1.0, 2.0
    bins, beams = 200, 120
    row, column = round((ranges - near) / 0.005 - 0.5), round((azimuth_deg + 30) / 0.5 - 0.5)
    image = np.zeros((bins, beams), np.float32)
    image[row, column] = 1.0
    picture, _, _ = fan_of(image, opening, near, far, 0.002, order=1)
    y, x = np.meshgrid(*(np.arange(n) + 0.5 for n in picture.shape), indexing="ij")
    at = near + (row + 0.5) * 0.005, math.radians((column + 0.5) * 0.5 - 30)
    forward = far - (picture * y).sum() / picture.sum() * (far - near * math.cos(opening / 2)) / picture.shape[0]
    to_port = (0.5 - (picture * x).sum() / picture.sum() / picture.shape[1]) * 2 * far * math.sin(opening / 2)
    assert forward == pytest.approx(at[0] * math.cos(at[1]), abs=0.001)
    assert to_port == pytest.approx(at[0] * math.sin(at[1]), abs=0.001)
    back, _ = fan_to_polar(picture, fan_around(opening, near, far, 0.002)[0], (bins, beams))
    assert np.unravel_index(back.argmax(), back.shape) == (row, column)


def test_both_ways_equal_a_smooth_field_in_metres():
    """A field of x (forward) and y (to port), on a picture with rows and columns of different length."""

    def field(x, y):
        return (0.5 + 0.2 * np.sin(2 * x) + 0.2 * np.cos(3 * y + 0.5)).astype(np.float32)

    geometry = FanGeometry(OPENING, NEAR, FAR, apex_row=412.0, apex_column=120.0, row_m=0.01, column_m=0.0125)
    rows, columns = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5, indexing="ij")
    picture = field((412 - rows) * 0.01, (120 - columns) * 0.0125)
    azimuth, edges = geometry.azimuth(BEAMS), geometry.range_edges(BINS)
    r, a = np.meshgrid((edges[1:] + edges[:-1]) / 2, azimuth, indexing="ij")
    image, mask = fan_to_polar(picture, geometry, (BINS, BEAMS))
    assert mask.all()
    np.testing.assert_allclose(image, field(r * np.cos(a), r * np.sin(a)), atol=0.01)
    again, seen = polar_to_fan(field(r * np.cos(a), r * np.sin(a)), azimuth, edges, geometry, picture.shape)
    np.testing.assert_allclose(again[seen], picture[seen], atol=0.01)
    x, y = (412 - rows) * 0.01, (120 - columns) * 0.0125
    ranges, angles = np.hypot(x, y), np.arctan2(y, x)
    np.testing.assert_array_equal(seen, (ranges >= 1) & (ranges <= 4) & (np.abs(angles) <= OPENING / 2))
    assert not again[~seen].any()


def test_uneven_beams_and_bins_equal_a_smooth_field_in_metres():
    """Beams and bins that grow across the fan take the field's mean over them; a window beyond the fan is masked."""

    def field(x, y):
        return (0.5 + 0.2 * np.sin(2 * x) + 0.2 * np.cos(3 * y + 0.5)).astype(np.float32)

    geometry = FanGeometry(OPENING, NEAR, FAR, apex_row=412.0, apex_column=120.0, row_m=0.01, column_m=0.0125)
    rows, columns = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5, indexing="ij")
    picture = field((412 - rows) * 0.01, (120 - columns) * 0.0125)
    azimuth = OPENING / 2 * np.sin(np.linspace(-1.4, 1.4, 40))
    edges = NEAR + (FAR + 1 - NEAR) * np.linspace(0, 1, 81) ** 1.5
    r, a = np.meshgrid((edges[1:] + edges[:-1]) / 2, azimuth, indexing="ij")
    image, mask = fan_to_polar(picture, geometry, azimuth=azimuth, range_edges=edges)
    assert image.shape == (80, 40)
    np.testing.assert_allclose(image[mask], field(r * np.cos(a), r * np.sin(a))[mask], atol=0.01)
    assert mask[edges[1:] <= FAR].all() and not mask[edges[:-1] > FAR + 0.02].any()


def test_beams_with_gaps_stay_where_they_are():
    """A picture of the azimuth itself, read at beams of unequal spacing, and such beams shown at pixels."""
    geometry, shape = fan_around(math.radians(40), NEAR, FAR, 0.01)
    _, angles = geometry.places(*np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"))
    azimuth = np.radians([-10.0, -9, -8, 0, 1, 2, 10, 18])
    read, mask = fan_to_polar(angles.astype(np.float32), geometry, (20, 8), azimuth=azimuth)
    np.testing.assert_allclose(read[mask], np.broadcast_to(azimuth, read.shape)[mask], atol=math.radians(0.05))
    image = np.tile(azimuth.astype(np.float32), (20, 1))
    picture, seen = polar_to_fan(image, azimuth, geometry.range_edges(20), geometry, shape, order=1)
    inner = seen & (angles > azimuth[0]) & (angles < azimuth[-1])
    np.testing.assert_allclose(picture[inner], angles[inner], atol=math.radians(0.05))


@pytest.mark.parametrize(("kind", "pixel", "most"), [("smooth", 0.011, 0.001), ("speckled", 0.0055, 0.01)])
def test_round_trip(rng, kind, pixel, most):
    """Within 1 % of full scale; speckle with grains of 2 cells, pixels as small as the finest beam (half a bin)."""
    image = smooth() if kind == "smooth" else speckled(rng)
    assert pytest.approx(0.0055, rel=0.01) == NEAR * OPENING / BEAMS
    picture, _, geometry = fan_of(image, pixel=pixel)
    back, mask = fan_to_polar(picture, geometry, image.shape)
    assert mask.all()
    assert rms(back - image) < most
    assert rms(back - image) < 0.15 * image.std()


@pytest.mark.parametrize("finer", [2, 3, 4])
@pytest.mark.parametrize("opening_deg", [30, 60, 130])
def test_round_trip_of_speckle_as_fine_as_cells(rng, opening_deg, finer):
    """Within 1 % of the image's own RMS, far beams many pixels wide; a mean over the cells would lose a tenth."""
    image = np.clip(rng.rayleigh(0.18, (BINS, BEAMS)), 0, 1).astype(np.float32)
    opening = math.radians(opening_deg)
    pixel = min((FAR - NEAR) / BINS, NEAR * opening / BEAMS) / finer
    picture, _, geometry = fan_of(image, opening, pixel=pixel)
    back, mask = fan_to_polar(picture, geometry, image.shape)
    assert mask.all()
    assert rms(back - image) < 0.01 * rms(image)


def test_coarse_polar_grid_averages(rng):
    """White noise keeps its mean and loses its variance as its cells' pixels are many; points would keep it."""
    geometry, shape = fan_around(OPENING, NEAR, FAR, 0.005)
    picture = rng.random(shape, np.float32)
    image, _ = fan_to_polar(picture, geometry, (30, 12))
    area = np.diff(geometry.range_edges(30) ** 2) / 2 * OPENING / 12 / 0.005**2
    wanted = np.sqrt(1 / 12 / area).mean()
    assert (image - 0.5).std() < 1.5 * wanted
    assert image.mean() == pytest.approx(0.5, abs=0.01)


def test_uneven_cells_are_averaged_only_if_the_smallest_is_coarse(rng):
    geometry, shape = fan_around(OPENING, NEAR, FAR, 0.005)
    picture = rng.random(shape, np.float32)
    edges, azimuth = geometry.range_edges(30), geometry.azimuth(12)
    split = np.insert(edges, 10, edges[9] + 3 * 0.005)  # one bin of three pixels
    averaged, _ = fan_to_polar(picture, geometry, order=1, azimuth=azimuth, range_edges=edges)
    taken, _ = fan_to_polar(picture, geometry, order=1, azimuth=azimuth, range_edges=split)
    assert averaged.std() < 0.05 < 0.12 < taken.std()


def test_coarse_picture_averages(rng):
    image = rng.random((600, 192), np.float32)
    picture, mask, _ = fan_of(image, pixel=0.05)  # a pixel covers 10 bins and 4 to 18 beams
    assert (picture[mask] - 0.5).std() < 0.08
    assert picture[mask].mean() == pytest.approx(0.5, abs=0.01)


def test_flat_stays_flat_up_to_the_edges():
    picture, seen, geometry = fan_of(np.full((BINS, BEAMS), 0.7, np.float32), pixel=0.02)
    np.testing.assert_allclose(picture[seen], 0.7, rtol=1e-5)
    image, mask = fan_to_polar(picture, geometry, (BINS, BEAMS))
    assert mask.all()
    np.testing.assert_allclose(image, 0.7, rtol=1e-5)


@pytest.mark.parametrize("opening_deg", [30.0, 120.0, 200.0])
def test_padded_and_resized_picture_is_found_by_its_box(opening_deg):
    image = smooth()
    opening = math.radians(opening_deg)
    picture, _, _ = fan_of(image, opening)
    squeezed = cv2.resize(picture, (picture.shape[1] * 3 // 2, picture.shape[0]), interpolation=cv2.INTER_LINEAR)
    padded = np.pad(squeezed, ((13, 5), (20, 31)))
    geometry = fit_fan(content_box(padded), opening, NEAR, FAR)
    assert geometry.row_m / geometry.column_m == pytest.approx(1.5, rel=0.02)
    back, mask = fan_to_polar(padded, geometry, image.shape)
    assert mask.mean() > 0.999
    inner = np.s_[3:-3, 3:-3]  # the picture's rim was mixed with black when it was resized
    assert rms((back - image)[inner]) < 0.01


def test_box_of_a_sector_by_hand():
    geometry = fit_fan(PictureBox(10.0, 110.0, 20.0, 220.0), math.radians(60), 1.0, 2.0)
    assert geometry.row_m == pytest.approx((2 - math.sqrt(3) / 2) / 100)
    assert geometry.column_m == pytest.approx(2 / 200)
    assert geometry.apex_column == 120.0
    assert geometry.apex_row == pytest.approx(10 + 2 / geometry.row_m)
    assert geometry.polar_shape() == (round(1 / geometry.row_m), round(math.pi / 3 * 1.5 / 0.01))


@pytest.mark.parametrize(
    ("edges_deg", "apex_column", "column_m"),
    [
        ((-30, 30), 120.0, 2 / 200),
        ((-30, 0), 20.0, 1 / 200),
        ((10, 30), 20 + 200 * 1 / (1 - math.sin(math.radians(10))), (1 - math.sin(math.radians(10))) / 200),
    ],
)
def test_box_of_a_part_of_a_sector_by_hand(edges_deg, apex_column, column_m):
    """Beams on one side of the middle: their box begins at the sonar, or at the near end of the inner beam."""
    edges = math.radians(edges_deg[0]), math.radians(edges_deg[1])
    geometry = fit_fan(PictureBox(10.0, 110.0, 20.0, 220.0), math.radians(60), 1.0, 2.0, edges=edges)
    top = 2 * math.cos(math.radians(max(edges_deg[0], 0)))
    assert geometry.column_m == pytest.approx(column_m)
    assert geometry.apex_column == pytest.approx(apex_column)
    assert geometry.row_m == pytest.approx((top - math.sqrt(3) / 2) / 100)
    assert geometry.apex_row == pytest.approx(10 + top / geometry.row_m)


def test_a_sector_between_its_own_edges_is_the_sector():
    for opening in (0.5, 2.0, math.pi, 5.0, 2 * math.pi):
        whole = fit_fan(BOX, opening, 1.0, 2.0)
        assert fit_fan(BOX, opening, 1.0, 2.0, edges=(-opening / 2, opening / 2)) == whole


def eight_bit(rng, image=None) -> np.ndarray:
    """A fan of speckle, or of `image`: 8 bits, 19 black pixels around, and nothing measured is 0."""
    picture, seen, _ = fan_of(speckled(rng) if image is None else image)
    return np.pad(np.where(seen, np.maximum(np.rint(255 * picture), 1), 0).astype(np.uint8), 19)


def test_box_is_the_fans_whatever_else_a_picture_shows(rng):
    picture = eight_bit(rng)
    there = PictureBox(19.0, picture.shape[0] - 19.0, 19.0, picture.shape[1] - 19.0)
    labelled = picture.copy()
    labelled[2:9, 3:40] = 255
    noisy = np.where(picture > 0, picture, rng.integers(0, 9, picture.shape)).astype(np.uint8)
    compressed = cv2.imdecode(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 95))[1], cv2.IMREAD_GRAYSCALE)
    black_specks = np.where(rng.random(picture.shape) < 0.4, 0, picture)
    assert [content_box(one) for one in (picture, labelled, noisy)] == [there] * 3
    np.testing.assert_allclose(content_box(picture / np.float32(255)), there)
    np.testing.assert_allclose(content_box(compressed), there, atol=1)
    np.testing.assert_allclose(content_box(black_specks), there, atol=2)
    assert (compressed > 0)[16].any() and (compressed > 0)[:, 16].any()  # its noise reaches out of the fan


def test_box_holds_a_dark_fan_and_both_sides_of_a_band_that_was_not_measured(rng):
    dark = np.zeros((BINS, BEAMS), np.float32)
    dark[100, 40] = 1.0
    picture, cut = eight_bit(rng, dark), eight_bit(rng)
    cut[120:160] = 0
    there = PictureBox(19.0, picture.shape[0] - 19.0, 19.0, picture.shape[1] - 19.0)
    assert content_box(picture) == content_box(cut) == there


def test_window_is_read_off_the_sides(rng):
    """Of a picture resized to other scales, whose publishers do not tell at which range it begins."""
    picture, _, _ = fan_of(speckled(rng) + np.float32(0.1), near=1.6)
    stretched = cv2.resize(picture, (picture.shape[1], picture.shape[0] * 5 // 4), interpolation=cv2.INTER_NEAREST)
    geometry = sector_of(np.pad(stretched, 9), OPENING)
    assert geometry.range_min == pytest.approx(0.4, abs=0.003)
    assert geometry.column_m / geometry.row_m == pytest.approx(1.25, rel=0.01)


def test_cut_off_picture_is_masked():
    """Without its lower third, and the apex told, the rest is where it was."""
    image = smooth()
    picture, _, whole = fan_of(image)
    rows = picture.shape[0] * 2 // 3
    cut = picture[:rows]
    geometry = fit_fan(content_box(cut), OPENING, NEAR, FAR, whole.apex_row)
    back, mask = fan_to_polar(cut, geometry, image.shape)
    bottom = (whole.apex_row - rows) * whole.row_m
    middle = (whole.range_edges(BINS)[1:] + whole.range_edges(BINS)[:-1]) / 2
    shown = middle[:, None] * np.cos(whole.azimuth(BEAMS)) > bottom
    assert (mask != shown).mean() < 0.01
    assert not back[~mask].any()
    assert rms((back - image)[mask & shown]) < 0.005


def test_masked_part_of_a_polar_image_does_not_bleed():
    image, mask = np.full((BINS, BEAMS), 0.5, np.float32), np.ones((BINS, BEAMS), bool)
    image[100:150], mask[100:150] = 1.0, False
    picture, seen, geometry = fan_of(image, mask=mask)
    np.testing.assert_allclose(picture[seen], 0.5, rtol=1e-5)
    ranges, _ = geometry.places(*np.meshgrid(*(np.arange(n) + 0.5 for n in picture.shape), indexing="ij"))
    assert not seen[(ranges > 2.2) & (ranges < 2.7)].any()
    assert not picture[~seen].any()


@pytest.mark.parametrize("pixel", [0.005, 0.01, 0.05])
def test_masked_beams_are_as_wide_in_the_picture_as_they_are(pixel):
    mask = np.ones((BINS, BEAMS), bool)
    mask[:, 40] = mask[:, 70:72] = False
    picture, seen, geometry = fan_of(smooth(), mask=mask, pixel=pixel)
    _, inside, _ = fan_of(smooth(), pixel=pixel)
    _, angles = geometry.places(*np.meshgrid(*(np.arange(n) + 0.5 for n in picture.shape), indexing="ij"))
    beams = np.clip(np.floor((angles + OPENING / 2) / OPENING * BEAMS).astype(int), 0, BEAMS - 1)
    np.testing.assert_array_equal(seen, inside & mask[0, beams])


def test_masked_part_of_a_picture_is_masked_in_the_polar_image():
    """And does not bleed: there the picture may hold anything."""
    picture, _, geometry = fan_of(np.full((BINS, BEAMS), 0.5, np.float32))
    ranges, _ = geometry.places(*np.meshgrid(*(np.arange(n) + 0.5 for n in picture.shape), indexing="ij"))
    hole = (ranges > 2.2) & (ranges < 2.7)
    image, mask = fan_to_polar(np.where(hole, np.nan, picture), geometry, (BINS, BEAMS), mask=~hole)
    middle = (geometry.range_edges(BINS)[1:] + geometry.range_edges(BINS)[:-1]) / 2
    assert not mask[(middle > 2.21) & (middle < 2.69)].any() and mask[(middle < 2.19) | (middle > 2.71)].all()
    np.testing.assert_allclose(image[mask], 0.5, rtol=1e-5)
    assert not image[~mask].any()


def test_a_mask_that_is_true_everywhere_changes_nothing(rng):
    """Nor does the mask of a polar image itself, in the picture that it was made of."""
    picture, _, geometry = fan_of(speckled(rng))
    shape, axes = (BINS, BEAMS), (geometry.azimuth(BEAMS), geometry.range_edges(BINS))
    image, mask = fan_to_polar(picture, geometry, shape)
    for one, other in zip(
        fan_to_polar(picture, geometry, shape, mask=np.ones(picture.shape, bool)), (image, mask), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    plain = polar_to_fan(image, *axes, geometry, picture.shape)
    for held in (np.ones(shape, bool), mask):
        for one, other in zip(polar_to_fan(image, *axes, geometry, picture.shape, held), plain, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_full_circle_may_be_larger_by_rounding():
    above = np.nextafter(np.nextafter(2 * math.pi, 9), 9)
    assert fan_around(above, NEAR, FAR, 0.1) == fan_around(2 * math.pi, NEAR, FAR, 0.1)
    with pytest.raises(SonarjaxError, match="opening: expected above 0 and up to 360 deg"):
        fan_around(2 * math.pi * (1 + 1e-6), NEAR, FAR, 0.1)


@pytest.mark.parametrize("kind", [np.uint8, bool, np.int32, np.float16, np.longdouble])
def test_labels_stay_labels(rng, kind):
    blobs = gaussian_filter(rng.standard_normal((BINS, BEAMS)), 6)
    labels = np.digitize(blobs, np.quantile(blobs, [0.6, 0.9])).astype(kind)
    picture, _, geometry = fan_of(labels, pixel=0.006, order=0)
    assert picture.dtype == kind
    assert set(np.unique(picture)) == set(np.unique(labels))
    back, mask = fan_to_polar(picture, geometry, labels.shape, order=0)
    assert (back.dtype, mask.mean()) == (kind, pytest.approx(1.0, abs=0.01))
    assert (back == labels)[mask].mean() > 0.97


def test_black_or_missing_picture_is_all_masked():
    geometry = FanGeometry(OPENING, NEAR, FAR, apex_row=-1000.0, apex_column=0.0, row_m=0.01, column_m=0.01)
    image, mask = fan_to_polar(np.ones((40, 30), np.float32), geometry, (8, 5))
    assert not mask.any() and not image.any()


def test_beams_of_unequal_width_and_one_beam():
    azimuth = np.radians([-10.0, -2.0, 1.0, 9.0])
    image = np.tile(np.array([0.1, 0.3, 0.6, 0.9], np.float32), (50, 1))
    geometry, shape = fan_around(math.radians(28), NEAR, FAR, 0.01)
    picture, seen = polar_to_fan(image, azimuth, geometry.range_edges(50), geometry, shape, order=0)
    _, angles = geometry.places(*np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"))
    wanted = image[0][np.digitize(np.degrees(angles), [-6, -0.5, 5])]
    np.testing.assert_allclose(picture[seen], wanted[seen], rtol=1e-6)
    assert np.degrees(angles[seen]).min() > -14.1 and np.degrees(angles[seen]).max() < 13.1
    one, seen = polar_to_fan(image[:, :1], np.zeros(1), geometry.range_edges(50), geometry, shape)
    np.testing.assert_allclose(one[seen], 0.1, rtol=1e-5)


BOX = PictureBox(0.0, 100.0, 0.0, 100.0)
PICTURE = np.ones((4, 4))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: content_box(np.zeros((4, 4))), "black"),
        (lambda: fit_fan(BOX, 0.0, 1.0, 2.0), "opening"),
        (lambda: fit_fan(BOX, math.nan, 1.0, 2.0), "opening"),
        (lambda: fit_fan(BOX, 7.0, 1.0, 2.0), "opening"),
        (lambda: fit_fan(BOX, 0.5, 2.0, 1.0), "2 to 1 m"),
        (lambda: fit_fan(BOX, 0.5, -1.0, 1.0), "range"),
        (lambda: fit_fan(BOX, 0.5, 1.0, math.inf), "range"),
        (lambda: fit_fan(BOX, 0.5, 1.0, 2.0, 0.0), "apex"),
        (lambda: fit_fan(PictureBox(1.0, 1.0, 0.0, 5.0), 0.5, 1.0, 2.0), "box"),
        (lambda: fan_around(0.5, 1.0, 2.0, 0.0), "pixel"),
        (lambda: fan_around(0.5, 1.0, 2.0, 1e-6), "at most"),
        (lambda: fan_to_polar(np.ones((4, 4)), fit_fan(BOX, 0.5, 1.0, 2.0), (0, 5)), "shape"),
        (lambda: fan_to_polar(np.ones((4, 4)), fit_fan(BOX, 0.5, 1.0, 2.0), (10**5, 10**5)), "shape"),
        (lambda: fan_to_polar(PICTURE, fit_fan(BOX, 0.5, 1.0, 2.0), (4, 3), azimuth=np.arange(2.0)), "azimuth"),
        (lambda: fan_to_polar(PICTURE, fit_fan(BOX, 0.5, 1.0, 2.0), range_edges=np.array([2.0, 1])), "range_edges"),
        (lambda: fan_to_polar(PICTURE, fit_fan(BOX, 0.5, 1.0, 2.0), azimuth=np.array([])), "shape"),
        (lambda: polar(np.array([0.1, 0.0]), np.arange(3.0)), "azimuth"),
        (lambda: polar(np.array([0.0, 0.1]), np.arange(2.0)), "range_edges"),
        (lambda: polar(np.array([0.0, 0.1]), np.array([0.0, 1.0, math.nan])), "range_edges"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(SonarjaxError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


def polar(azimuth, edges):
    return polar_to_fan(np.ones((2, 2)), azimuth, edges, fit_fan(BOX, 0.5, 1.0, 2.0), (5, 5))


@pytest.mark.parametrize("name", ["beams", "bins", "width"])
def test_options_of_no_size_are_refused(name: str) -> None:
    with pytest.raises(SonarjaxError, match=f"--{name}: expected a number of 1 or more, got 0"):
        FanOptions(**{name: 0})


@pytest.mark.parametrize("name", ["opening_deg", "range_min", "range_max", "apex"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_options_that_are_no_number_are_refused(name: str, value: float) -> None:
    with pytest.raises(SonarjaxError, match=f"--{name.replace('_', '-')}: expected a finite number, got "):
        FanOptions(**{name: value})
