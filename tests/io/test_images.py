"""PNG, NPY and NPZ as frames: values, masks, geometry, and everything that must be refused."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from skimage import io as skimage_io

from sonarjax.io import PIXEL_LIMIT, SonarjaxError, describe, read_frames, write_npz

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
UNIT = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)


def test_png_as_another_writer_makes_it(tmp_path):
    path = tmp_path / "a.png"
    skimage_io.imsave(path, GREY, check_contrast=False)
    (frame,) = read_frames(path)
    np.testing.assert_allclose(frame.image, GREY / 255.0, atol=1e-7)
    assert (frame.stem, frame.mask, frame.geometry) == ("a", None, None)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_depths(make, saved, dtype):
    values = GREY.astype(dtype) * np.iinfo(dtype).max // 255
    (frame,) = read_frames(saved("a.png", make.png(values)))
    np.testing.assert_allclose(frame.image, values / np.iinfo(dtype).max, atol=1e-7)


def test_grey_saved_as_colour_is_accepted_and_colour_is_not(make, saved):
    rgb = np.repeat(GREY[..., None], 3, axis=2)
    (frame,) = read_frames(saved("a.png", make.png(rgb)))
    np.testing.assert_allclose(frame.image, GREY / 255.0, atol=1e-7)
    rgb[0, 0, 1] += 1
    with pytest.raises(SonarjaxError, match="grey, opaque"):
        read_frames(saved("b.png", make.png(rgb)))


def test_16_bits_of_colour_or_transparency_are_refused(make, saved):
    """The decoder would keep the upper 8 of them."""
    deep = GREY.astype(np.uint16) * 257
    rgb = make.png(np.repeat(deep[..., None], 3, axis=2))
    rgba = make.png(np.stack([deep, deep, deep, np.full_like(deep, 65535)], axis=2))
    two = make.png(np.repeat(deep, 2, axis=1), width=4)  # grey and transparency, from a header with colour type 4
    size = struct.pack(">IIBBBBB", 4, 3, 16, 4, 0, 0, 0)
    grey_alpha = two[:8] + make.chunk(b"IHDR", size) + two[33:]
    for content in (rgb, rgba, grey_alpha):
        with pytest.raises(SonarjaxError, match="a.png: header: got 16-bit colour or transparency: save it as 16-bit"):
            read_frames(saved("a.png", content))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_transparent_grey_value_is_refused(make, saved, dtype):
    content = make.png(GREY.astype(dtype), extra=make.chunk(b"tRNS", struct.pack(">H", 40)))
    with pytest.raises(SonarjaxError, match="a.png: expected a grey, opaque picture, got one grey value"):
        read_frames(saved("a.png", content))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2"])
def test_integers_scale_by_the_maximum_of_their_type(make, saved, dtype):
    top = np.iinfo(dtype).max
    (frame,) = read_frames(saved("a.npy", make.npy(np.array([[0, top // 2, top]], dtype))))
    np.testing.assert_allclose(frame.image, [[0, (top // 2) / top, 1]], atol=1e-6)
    assert frame.image.dtype == np.float32


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, ">f4", bool])
def test_floats_and_booleans_stay(make, saved, dtype):
    values = np.array([[0, 1], [1, 0]], dtype)
    (frame,) = read_frames(saved("a.npy", make.npy(values)))
    np.testing.assert_array_equal(frame.image, values)
    assert frame.image.dtype == np.float32


def test_rounding_is_clipped_and_column_order_is_kept(make, saved):
    values = np.asfortranarray(UNIT.astype(np.float64) * (1 + 5e-7))
    (frame,) = read_frames(saved("a.npy", make.npy(values)))
    np.testing.assert_allclose(frame.image, UNIT, atol=1e-6)
    assert frame.image.max() == 1.0


def test_npz_with_mask_and_geometry(tmp_path):
    path = tmp_path / "frame.npz"
    mask = np.ones((3, 4), bool)
    mask[0] = False
    write_npz(path, image=UNIT, mask=mask, azimuth_deg=np.arange(4.0), range_edges_m=np.arange(1.0, 5.0))
    for spec in (path, f"{path}:0"):
        (frame,) = read_frames(spec)
        np.testing.assert_array_equal(frame.image, UNIT)
        np.testing.assert_array_equal(frame.mask, mask)
    assert frame.geometry == {
        "azimuth_deg": [0.0, 1.0, 2.0, 3.0],
        "range_min_m": 1.0,
        "range_max_m": 4.0,
        "n_ranges": 3,
    }
    text = describe(path)
    assert "66.7% of the pixels" in text and "range_edges_m" in text


HOLES = np.where(np.arange(3)[:, None] == 1, np.nan, UNIT)
ROWS = np.repeat([[True], [False], [True]], 4, axis=1)


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf, -9999.0, 1e30])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_a_pixel_that_was_not_measured_may_hold_anything(make, saved, dtype, hole):
    """It becomes 0 if it is no value; the others stay, masked or not."""
    with np.errstate(over="ignore"):
        image = np.where(ROWS | (np.arange(4) > 1), UNIT, hole).astype(dtype)
    (frame,) = read_frames(saved("a.npz", make.npz(image=image, mask=ROWS)))
    np.testing.assert_array_equal(frame.image, np.where(ROWS | (np.arange(4) > 1), UNIT.astype(dtype), 0))
    np.testing.assert_array_equal(frame.mask, ROWS)
    assert frame.image.dtype == np.float32


@pytest.mark.parametrize(
    ("hole", "message"),
    [
        (np.nan, "image: expected finite values where the mask is true, got NaN or infinity"),
        (-np.inf, "image: expected finite values where the mask is true, got NaN or infinity"),
        (1.5, r"image: expected floats in \[0, 1\], got 0 to 1.5"),
    ],
)
def test_a_measured_pixel_must_hold_a_value(make, saved, hole, message):
    image = HOLES.copy()
    image[2, 3] = hole
    path = saved("a.npz", make.npz(image=image, mask=ROWS))
    with pytest.raises(SonarjaxError, match=message) as caught:
        read_frames(path)
    assert str(caught.value).startswith(f"{path}: image: ") and "\n" not in str(caught.value)


def test_uneven_range_bins_are_refused(make, saved):
    for edges, even in ((np.linspace(0.7, 3.9, 4, dtype=np.float32), True), (np.array([1.0, 1.1, 1.3, 1.7]), False)):
        path = saved("a.npz", make.npz(image=UNIT, azimuth_deg=np.arange(4.0), range_edges_m=edges))
        if even:
            assert read_frames(path)[0].geometry["range_max_m"] == pytest.approx(3.9)
        else:
            with pytest.raises(SonarjaxError, match="range_edges_m: expected range bins of equal length"):
                read_frames(path)


def test_mask_of_numbers(make, saved):
    (frame,) = read_frames(saved("a.npz", make.npz(image=UNIT, mask=np.ones((3, 4), np.uint8))))
    assert frame.mask.dtype == bool and frame.mask.all()


OBJECTS = np.array([[None, 1]], object)
BAD_ARRAYS = [
    (np.full((3, 4), np.nan), "expected finite values"),
    (np.full((3, 4), -np.inf), "expected finite values"),
    (np.full((3, 4), 1.5), r"expected floats in \[0, 1\], got 1.5"),
    (np.full((3, 4), -0.1), r"expected floats in \[0, 1\], got -0.1"),
    (
        np.full((3, 4), 200, np.int16),
        "expected uint8, uint16 or float, got int16: convert it to the type",
    ),
    (np.full((3, 4), 200, np.int32), "expected uint8, uint16 or float, got int32"),
    (np.full((3, 4), 200, np.uint32), "expected uint8, uint16 or float, got uint32"),
    (np.zeros((3, 4), np.int64), "expected uint8, uint16 or float, got int64"),
    (np.zeros((3, 4), complex), "dtype: expected bool, integer or float"),
    (np.array([["a", "b"]]), "dtype: expected bool, integer or float"),
    (np.zeros((3, 4), [("x", "f4")]), "dtype: expected bool, integer or float"),
    (OBJECTS, "dtype: expected bool, integer or float"),
    (np.zeros(5), r"expected a shape \(range, beam\) that is not empty, got \(5,\)"),
    (np.zeros((2, 3, 4)), r"expected a shape \(range, beam\)"),
    (np.float32(0.5), r"expected a shape \(range, beam\)"),
    (np.zeros((0, 4)), r"that is not empty, got \(0, 4\)"),
]


@pytest.mark.parametrize(("array", "message"), BAD_ARRAYS, ids=[message for _, message in BAD_ARRAYS])
def test_bad_images(make, saved, array, message):
    for path in (saved("a.npy", make.npy(array)), saved("a.npz", make.npz(image=array))):
        with pytest.raises(SonarjaxError, match=message) as caught:
            read_frames(path)
        assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


BAD_MEMBERS = [
    ({"labels": UNIT}, "image: expected an array of this name, found 'labels'"),
    ({"image": UNIT, "mask": np.ones((4, 3), bool)}, r"mask: expected the image's shape \(3, 4\), got \(4, 3\)"),
    ({"image": UNIT, "mask": UNIT}, "mask: expected booleans"),
    ({"image": UNIT[0], "mask": np.ones((3, 4), bool)}, r"image: expected a shape \(range, beam\)"),
    ({"image": np.full((3, 4), np.nan), "mask": np.full((3, 4), np.nan)}, "mask: expected booleans"),
    ({"image": UNIT, "mask": np.zeros((3, 4), bool)}, "mask: expected at least one measured pixel"),
    (
        {"image": UNIT, "azimuth_deg": np.arange(3.0), "range_edges_m": np.arange(4.0)},
        "azimuth_deg: expected 4 numbers",
    ),
    ({"image": UNIT, "azimuth_deg": np.zeros(4), "range_edges_m": np.arange(4.0)}, "in ascending order"),
    ({"image": UNIT, "azimuth_deg": np.full(4, np.nan), "range_edges_m": np.arange(4.0)}, "expected finite"),
    (
        {"image": UNIT, "azimuth_deg": np.arange(4.0), "range_edges_m": np.linspace(-1, 1, 4)},
        "range_edges_m: expected numbers from 0 to 1000, got -1 to 1",
    ),
    (
        {"image": UNIT, "azimuth_deg": np.arange(4.0), "range_edges_m": np.linspace(1, 2000, 4)},
        "range_edges_m: expected numbers from 0 to 1000, got 1 to 2000",
    ),
    (
        {"image": UNIT, "azimuth_deg": np.array([-400.0, 0, 1, 500]), "range_edges_m": np.arange(4.0)},
        "azimuth_deg: expected numbers from -180 to 180, got -400 to 500",
    ),
    ({"image": b"nonsense"}, "image: expected NPY data"),
]


@pytest.mark.parametrize(("members", "message"), BAD_MEMBERS, ids=[message for _, message in BAD_MEMBERS])
def test_bad_npz(make, saved, members, message):
    with pytest.raises(SonarjaxError, match=message):
        read_frames(saved("a.npz", make.npz(**members)))


def test_a_second_array_is_not_dropped_without_a_word(make, saved):
    path = saved("a.npy", make.npy(UNIT) + make.npy(UNIT))
    with pytest.raises(SonarjaxError, match="a.npy: image: expected one array, 48 bytes of numbers, got 224"):
        read_frames(path)


@pytest.mark.parametrize("alone", [False, True])
def test_an_animated_png_is_refused(tmp_path, alone):
    """Also one whose first picture is no part of the animation."""
    path, pictures = tmp_path / "a.png", [Image.fromarray(GREY // k) for k in (1, 2)]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], default_image=alone)
    with pytest.raises(SonarjaxError, match="a.png: expected a PNG of one picture, got an animation of 2"):
        read_frames(path)


@pytest.mark.parametrize("ending", ["npy", "npz", "png"])
def test_truncated(make, saved, ending):
    whole = {"npy": make.npy(UNIT), "npz": make.npz(image=UNIT), "png": make.png(GREY)}[ending]
    for size in (1, 9, len(whole) // 2, len(whole) - 13, len(whole) - 1):
        with pytest.raises(SonarjaxError):
            read_frames(saved(f"a.{ending}", whole[:size]))


@pytest.mark.parametrize("ending", ["npy", "npz", "png", "aris", "ddf", "raw"])
def test_foreign_content(saved, ending):
    with pytest.raises(SonarjaxError):
        read_frames(saved(f"a.{ending}", b"\x00\xff not what it says it is" * 200))


def test_a_damaged_npz_member_is_noticed(make, saved):
    content = bytearray(make.npz(image=np.random.default_rng(0).random((30, 40), np.float32)))
    content[2000] ^= 0x40
    with pytest.raises(SonarjaxError, match="image: "):
        read_frames(saved("a.npz", bytes(content)))


def test_a_zip_bomb_stops_at_what_the_array_announces(make, saved):
    header = make.npy_header("{'descr': '|u1', 'fortran_order': False, 'shape': (3, 4)}")
    with pytest.raises(SonarjaxError, match="expected 12 bytes of numbers, got more"):
        read_frames(saved("a.npz", make.npz(image=header + bytes(50_000_000))))


def test_pixel_limit(make, saved):
    side = 100_000
    text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({side}, {side})}}"
    for path in (saved("a.npy", make.npy_header(text)), saved("a.npz", make.npz(image=make.npy_header(text)))):
        with pytest.raises(SonarjaxError, match=f"expected at most {PIXEL_LIMIT} numbers"):
            read_frames(path)
    with pytest.raises(SonarjaxError, match=f"expected at most {PIXEL_LIMIT} pixels"):
        read_frames(saved("a.png", make.png(GREY, width=side, height=side)))
    with pytest.raises(SonarjaxError, match="bytes cannot hold 5000 x 5000 pixels"):
        read_frames(saved("a.png", make.png(GREY, width=5000, height=5000)))


def test_a_second_png_header_cannot_get_round_the_limit(make, saved):
    body = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    with pytest.raises(SonarjaxError, match="two headers|cannot be decoded"):
        read_frames(saved("a.png", make.png(GREY, extra=make.chunk(b"IHDR", body))))


def test_a_png_text_bomb_is_refused(make, saved):
    bomb = make.chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(80_000_000)))
    with pytest.raises(SonarjaxError, match="cannot be decoded"):
        read_frames(saved("a.png", make.png(GREY, extra=bomb)))


@pytest.mark.parametrize(
    "text",
    ["", "()", "{", "{'descr': '<f4'}", "{'descr': 'O', 'fortran_order': False, 'shape': (1, 1)}", "(" * 3000]
    + [
        "{'descr': '<f4', 'fortran_order': 1, 'shape': (1, 1)}",
        "{'descr': 'f4,f4', 'fortran_order': False, 'shape': ()}",
    ]
    + ["{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 1)}", "__import__('os').getcwd()"],
)
def test_hostile_npy_headers(make, saved, text):
    with pytest.raises(SonarjaxError):
        read_frames(saved("a.npy", make.npy_header(text, bytes(64))))


def test_real_frames(real):
    (frame,) = read_frames(real("pipe/frames/frame_002.npz"))
    assert frame.shape == (210, 82) and frame.mask is not None and 0.3 < frame.mask.mean() < 0.9
