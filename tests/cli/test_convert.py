"""`sonarjax convert`: fan pictures into frames that the other commands take, frames into fan pictures."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from sonarjax.io import Frame, SonarjaxError, describe, fan_around, one_frame, read_frames, write_bag, write_png
from sonarjax.sonar import Sonar
from tests.cli.files import recording

SECTOR = ("--opening-deg", 29, "--range-min", 1.5, "--range-max", 4)


@pytest.fixture(scope="module")
def fan(tmp_path_factory):
    """`fan.png`, rings and spokes in a 29° fan from 1.5 to 4 m, 200 pixels of 1 cm wide, black around."""
    path = tmp_path_factory.mktemp("fan") / "fan.png"
    geometry, shape = fan_around(math.radians(29), 1.5, 4.0, 8 * math.sin(math.radians(14.5)) / 200)
    y, x = np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij")
    ranges, azimuth = geometry.places(y, x)
    inside = (ranges >= 1.5) & (ranges <= 4) & (np.abs(azimuth) <= math.radians(14.5))
    write_png(path, np.pad(np.where(inside, value(ranges, azimuth), 0.0), 7))
    return path


def value(ranges, azimuth):
    """Brighter to port, and with range in waves."""
    return 0.5 + 0.2 * np.sin(4 * ranges) + azimuth


def test_fan_becomes_a_frame(command, fan, tmp_path):
    out = tmp_path / "polar.npz"
    code, said, err = command("convert", fan, *SECTOR, "--out", out, "--bins", 200, "--beams", 80)
    assert (code, err) == (0, "")
    assert said.startswith(f"{out}: 200 range bins x 80 beams, opening 29 deg, range 1.5 to 4 m, 100.0% of")
    assert "; the fan in rows 7 to 261 and columns 7 to 207, the sonar at row 405.8" in said
    assert said.count("\n") == 1
    with np.load(out, allow_pickle=False) as held:
        assert set(held) == {"image", "mask", "azimuth_deg", "range_edges_m"}
        assert (held["image"].dtype, held["mask"].dtype) == (np.float32, bool)
        azimuth, edges = held["azimuth_deg"], held["range_edges_m"]
        np.testing.assert_allclose(azimuth, np.linspace(-14.5, 14.5, 161)[1::2], atol=1e-12)
        np.testing.assert_allclose(edges, np.linspace(1.5, 4, 201))
        middle = (edges[1:] + edges[:-1]) / 2
        wanted = value(*np.meshgrid(middle, np.radians(azimuth), indexing="ij"))
        assert np.sqrt(np.mean((held["image"] - wanted) ** 2)) < 0.01
    frame = read_frames(out)[0]  # what segment and recognize read
    assert frame.mask is not None and frame.geometry is not None
    assert frame.geometry["range_max_m"] == 4.0


def test_default_grid_keeps_the_resolution(command, fan, tmp_path):
    assert command("convert", fan, *SECTOR, "--out", tmp_path / "p.npz")[0] == 0
    bins, beams = read_frames(tmp_path / "p.npz")[0].shape
    assert abs(bins - 250) <= 1  # pixels of 1 cm: 2.5 m of range
    assert abs(beams - math.radians(29) * 275) <= 1  # an arc at 2.75 m


def test_and_back(command, fan, tmp_path):
    """Fan, frame and fan again: the picture without its border; both files are what others write and read."""
    polar, again = tmp_path / "polar.npz", tmp_path / "again.png"
    assert command("convert", fan, *SECTOR, "--out", polar)[0] == 0
    code, said, _ = command("convert", polar, "--out", again, "--width", 200)
    with Image.open(fan) as one, Image.open(again) as other:
        first, second = np.asarray(one)[7:-7, 7:-7] / 255, np.asarray(other) / 255
        assert (other.mode, first.shape) == ("L", second.shape)
    assert said.startswith(f"{again}: {second.shape[0]} x 200 pixels, opening 29 deg, range 1.5 to 4 m, ")
    assert code == 0
    np.testing.assert_array_equal(first > 0, second > 0)
    assert np.sqrt(np.mean((first - second) ** 2)) < 0.005


@pytest.mark.parametrize("preset", ["didson-hf", "aris-1800", "oculus"])
def test_speckle_comes_back(command, tmp_path, preset):
    """Frame, fan of 8 bits and frame again with the defaults: within 1 % of the frame's own RMS, so of full scale too.

    White speckle, finer than any sensor's, on even and uneven beams. A mean over the cells would lose a tenth of it.
    """
    sonar, toml = Sonar.preset(preset), tmp_path / "sonar.toml"
    sonar.to_toml(toml)
    image = np.clip(np.random.default_rng(0).rayleigh(0.18, sonar.shape), 0, 1).astype(np.float32)
    edges = np.linspace(float(sonar.range_min), float(sonar.range_max), sonar.n_ranges + 1)
    azimuth_deg = np.degrees(np.asarray(sonar.azimuth, np.float64))
    np.savez(tmp_path / "a.npz", image=image, azimuth_deg=azimuth_deg, range_edges_m=edges)
    assert command("convert", tmp_path / "a.npz", "--out", tmp_path / "a.png")[0] == 0
    assert command("convert", tmp_path / "a.png", "--sonar", toml, "--out", tmp_path / "b.npz")[::2] == (0, "")
    back = read_frames(tmp_path / "b.npz")[0]
    assert back.shape == image.shape and back.mask.all()
    assert np.sqrt(np.mean((back.image - image) ** 2)) < 0.01 * np.sqrt(np.mean(image**2))


def test_large_picture_gets_longer_pixels(command, tmp_path, monkeypatch):
    """Half as long as bins, or as many as are wanted at most, or as long as bins."""
    np.save(tmp_path / "a.npy", np.full((100, 20), 0.5, np.float32))
    sizes = {}
    for most in (10**6, 20_000, 100):
        monkeypatch.setattr(sys.modules["sonarjax.io.convert"], "LARGE", most)
        assert command("convert", tmp_path / "a.npy", *SECTOR, "--out", tmp_path / "a.png")[0] == 0
        with Image.open(tmp_path / "a.png") as picture:
            sizes[most] = picture.width * picture.height
    area = (4 - 1.5 * math.cos(math.radians(14.5))) * 8 * math.sin(math.radians(14.5))
    wanted = {10**6: area / 0.0125**2, 20_000: 20_000, 100: area / 0.025**2}
    assert sizes == pytest.approx(wanted, rel=0.02)


def test_mask_of_a_fan_in_an_npz_counts(command, fan, tmp_path):
    """What it leaves out neither is part of the frame nor tells where the fan is."""
    with Image.open(fan) as picture:
        image, out = np.asarray(picture) / 255, tmp_path / "p.npz"
    mask = np.ones(image.shape, bool)
    mask[100:140], mask[:5] = False, False
    image[:5], image[100:140] = 1.0, np.nan
    np.savez(tmp_path / "fan.npz", image=image, mask=mask)
    size = ("--bins", 200, "--beams", 80)
    code, said, err = command("convert", tmp_path / "fan.npz", *SECTOR, *size, "--out", out)
    assert (code, err) == (0, "") and "the fan in rows 7 to 261 and columns 7 to 207" in said
    frame = read_frames(out)[0]
    ranges, azimuth = np.meshgrid(np.linspace(1.5, 4, 401)[1::2], np.radians(np.linspace(-14.5, 14.5, 161)[1::2]))
    rows = (405.8 - 100 * ranges * np.cos(azimuth)).T
    assert not frame.mask[(rows > 101) & (rows < 139)].any() and frame.mask[(rows < 99) | (rows > 141)].all()
    assert np.sqrt(np.mean((frame.image - value(ranges, azimuth).T)[frame.mask] ** 2)) < 0.01


def test_a_mask_that_a_fan_picture_cannot_hold_is_noted(command, tmp_path):
    """As the note says, the frame comes back at its own ranges with --frame."""
    image, mask = np.full((60, 24), 0.3, np.float32), np.ones((60, 24), bool)
    image[30, 12], mask[54:] = 1.0, False
    polar, seen, out = (tmp_path / name for name in ("a.npz", "a.png", "b.npz"))
    np.savez(polar, image=image, mask=mask)
    code, _, err = command("convert", polar, *SECTOR, "--out", seen)
    assert code == 0 and err.count("\n") == 1
    assert err.startswith(f"sonarjax: note: {polar}: mask: 144 of 1440 pixels were not measured: ") and "--frame" in err
    assert command("convert", seen, *SECTOR, "--bins", 60, "--beams", 24, "--frame", "--out", out)[::2] == (0, "")
    back = read_frames(out)[0].image
    assert np.unravel_index(back.argmax(), back.shape) == (30, 12) and back[56:].max() < 0.02
    np.savez(polar, image=image, mask=np.ones_like(mask))
    assert command("convert", polar, *SECTOR, "--out", seen)[::2] == (0, "")


@pytest.mark.parametrize("beams", [200, 400, 480, 512])
def test_beams_all_around_become_a_picture(command, tmp_path, beams):
    """The sum of their widths is larger than a full circle by rounding."""
    azimuth_deg = (np.arange(beams) + 0.5 - beams / 2) * (360 / beams)
    edges = np.linspace(0, 5, 21)
    np.savez(tmp_path / "a.npz", image=np.full((20, beams), 0.5), azimuth_deg=azimuth_deg, range_edges_m=edges)
    code, said, err = command("convert", tmp_path / "a.npz", "--out", tmp_path / "a.png")
    assert (code, err) == (0, "") and "opening 360 deg" in said


def test_black_frame_is_found_again(command, tmp_path):
    """A measured zero is not black in the picture: the box of its pixels is the sector's."""
    image = np.zeros((60, 24), np.float32)
    image[30, 12] = 1.0
    np.savez(tmp_path / "a.npz", image=image)
    assert command("convert", tmp_path / "a.npz", *SECTOR, "--out", tmp_path / "a.png")[0] == 0
    options = ("--bins", 60, "--beams", 24)
    assert command("convert", tmp_path / "a.png", *SECTOR, *options, "--out", tmp_path / "b.npz")[0] == 0
    back = read_frames(tmp_path / "b.npz")[0].image
    assert np.unravel_index(back.argmax(), back.shape) == (30, 12)


def test_a_fan_that_does_not_begin_where_it_is_said_is_noted(command, fan, tmp_path):
    """Its nearest ranges are black: by its lower edge it is stretched, and objects move towards the sonar."""
    with Image.open(fan) as picture:
        pixels = np.asarray(picture).copy()
    pixels[-30:] = 0
    write_png(tmp_path / "a.png", pixels)
    code, _, err = command("convert", tmp_path / "a.png", *SECTOR, "--out", tmp_path / "p.npz")
    assert code == 0 and err.count("\n") == 1
    assert err.startswith(f"sonarjax: note: {tmp_path / 'a.png'}: a pixel is 0.01103 m high and 0.01002 m wide: unless")
    apex = ("--apex", 7 + 4 / 0.01)
    assert command("convert", tmp_path / "a.png", *SECTOR, *apex, "--out", tmp_path / "p.npz")[::2] == (0, "")


def test_whole_and_apex_say_the_same(command, fan, tmp_path):
    with Image.open(fan) as picture:
        pixels = np.asarray(picture)
    extended = np.pad(pixels[:-7], ((0, round(1.5 * math.cos(math.radians(14.5)) * 100)), (0, 0)))
    write_png(tmp_path / "whole.png", extended)
    size = ("--bins", 100, "--beams", 40)
    told = {"box": (), "whole": ("--whole",), "apex": ("--apex", len(extended))}
    frames = {}
    for name, options in told.items():
        source, out = tmp_path / "whole.png", tmp_path / f"{name}.npz"
        assert command("convert", source, *SECTOR, *size, *options, "--out", out)[0] == 0
        frames[name] = read_frames(out)[0].image
    np.testing.assert_array_equal(frames["whole"], frames["apex"])
    inner = np.s_[1:-1, 1:-1]  # the extension is of whole rows: the rim is up to half a pixel off
    np.testing.assert_allclose(frames["whole"][inner], frames["box"][inner], atol=0.01)


@pytest.fixture
def uneven(tmp_path):
    """`uneven.toml`, whose beams lie up to 0.9° from even ones; `polar.npz`, stripes on them; `seen.png`, their fan."""
    toml, polar = tmp_path / "uneven.toml", tmp_path / "polar.npz"
    toml.write_text('preset = "aris-1200"\nrange_min_m = 1.5\nrange_max_m = 4.0\nn_ranges = 100\n')
    sonar = Sonar.from_toml(toml)
    edges = np.linspace(1.5, 4.0, 101)
    image = value(*np.meshgrid((edges[1:] + edges[:-1]) / 2, np.asarray(sonar.azimuth) * 8, indexing="ij"))
    azimuth_deg = np.degrees(np.asarray(sonar.azimuth, np.float64))
    np.savez(polar, image=np.clip(image / 2 + 0.3, 0, 1), azimuth_deg=azimuth_deg, range_edges_m=edges)
    np.save(tmp_path / "bare.npy", read_frames(polar)[0].image)
    return SimpleNamespace(toml=toml, polar=polar, seen=tmp_path / "seen.png", sonar=sonar)


def test_fan_is_put_on_the_beams_of_an_uneven_sonar(command, uneven, tmp_path):
    assert command("convert", uneven.polar, "--out", uneven.seen)[0] == 0
    out = tmp_path / "back.npz"
    code, said, err = command("convert", uneven.seen, "--sonar", uneven.toml, "--out", out)
    assert (code, err) == (0, "") and f"{out}: 100 range bins x 48 beams, opening 27.58 deg" in said
    before, back = read_frames(uneven.polar)[0], read_frames(out)[0]
    np.testing.assert_allclose(back.geometry["azimuth_deg"], np.degrees(uneven.sonar.azimuth), atol=1e-5)
    np.testing.assert_allclose(np.load(out)["range_edges_m"], np.linspace(1.5, 4.0, 101))
    inner = np.s_[1:-1, 1:-1]
    assert back.mask[inner].all()
    assert np.sqrt(np.mean((back.image - before.image)[inner] ** 2)) < 0.01
    even = ("--opening-deg", 27.58, "--range-min", 1.5, "--range-max", 4, "--bins", 100, "--beams", 48)
    assert command("convert", uneven.seen, *even, "--out", out)[0] == 0
    assert np.sqrt(np.mean((read_frames(out)[0].image - before.image)[inner] ** 2)) > 0.02


@pytest.mark.parametrize(("low_deg", "high_deg"), [(-8, 20), (-20, 8), (-13.749, 13.876)])
def test_fan_of_beams_that_reach_farther_to_one_side(command, tmp_path, low_deg, high_deg):
    """The box of its pixels is that of the real beams, not of the sector about the middle that holds them."""
    toml, polar, seen, out = (tmp_path / name for name in ("s.toml", "p.npz", "p.png", "q.npz"))
    azimuth_deg = np.linspace(low_deg, high_deg, 96)
    own = "range_min_m = 1.5\nrange_max_m = 4.0\nn_ranges = 100\ntilt_deg = 20\nheight_m = 1\n"
    toml.write_text(f"{own}azimuth_deg = {azimuth_deg.tolist()}\nelevation_aperture_deg = 14\n")
    edges = np.linspace(1.5, 4.0, 101)
    image = gaussian_filter(np.random.default_rng(0).random((100, 96)), 1.5)
    np.savez(polar, image=image, azimuth_deg=azimuth_deg, range_edges_m=edges)
    assert command("convert", polar, "--out", seen)[0] == 0
    for options in ((), ("--frame",)):
        assert command("convert", seen, "--sonar", toml, *options, "--out", out)[::2] == (0, "")
        back = read_frames(out)[0]
        assert back.mask.all()
        assert np.sqrt(np.mean((back.image - image)[2:-2, 2:-2] ** 2)) < 0.05 * image.std()


def test_picture_of_a_smaller_window_fills_its_part_of_the_sonars(command, uneven, tmp_path):
    """What the picture does not show is masked; the rest is where it was."""
    assert command("convert", uneven.polar, "--out", uneven.seen)[0] == 0
    wide, out = tmp_path / "wide.toml", tmp_path / "wide.npz"
    wide.write_text(uneven.toml.read_text().replace("4.0", "6.5").replace("100", "200"))
    options = ("--range-min", 1.5, "--range-max", 4)
    assert command("convert", uneven.seen, "--sonar", wide, *options, "--out", out)[0] == 0
    frame, before = read_frames(out)[0], read_frames(uneven.polar)[0]
    assert frame.shape == (200, 48) and frame.geometry["range_max_m"] == 6.5
    assert not frame.mask[101:].any() and frame.mask[1:99, 1:-1].all()
    assert np.sqrt(np.mean((frame.image[:100] - before.image)[1:-1, 1:-1] ** 2)) < 0.01


def test_frame_without_axes_becomes_the_fan_of_a_sonar(command, uneven, tmp_path):
    one, other = uneven.seen, tmp_path / "other.png"
    assert command("convert", uneven.polar, "--out", one)[0] == 0
    assert command("convert", tmp_path / "bare.npy", "--sonar", uneven.toml, "--out", other)[0] == 0
    assert one.read_bytes() == other.read_bytes()


def test_one_beam_is_as_wide_as_is_told(command, complaint, tmp_path):
    """The opening of a frame of one beam is asked for, whatever the width of the sonar's beam."""
    out, toml = tmp_path / "p.png", tmp_path / "one.toml"
    image = np.full((50, 1), 0.5)
    np.save(tmp_path / "a.npy", image)
    np.savez(tmp_path / "a.npz", image=image, azimuth_deg=np.zeros(1), range_edges_m=np.linspace(1.5, 4.0, 51))
    own = "range_min_m = 1.5\nrange_max_m = 4.0\nn_ranges = 50\ntilt_deg = 20\nheight_m = 1\n"
    toml.write_text(f"{own}azimuth_deg = [0.0]\nbeam_width_deg = 1\nelevation_aperture_deg = 14\n")
    for given in ((tmp_path / "a.npz",), (tmp_path / "a.npy", "--sonar", toml)):
        needed = "--opening-deg: required for a frame of one beam"
        assert needed in complaint(2, "convert", *given, "--out", out)
        assert "--range-max: cannot be used" in complaint(2, "convert", *given, "--range-max", 4, "--out", out)
        code, said, err = command("convert", *given, "--opening-deg", 20, "--out", out)
        assert (code, err) == (0, "") and "opening 20 deg, range 1.5 to 4 m" in said
        with Image.open(out) as picture:
            assert picture.width == pytest.approx(8 * math.sin(math.radians(10)) / 0.025, abs=1)
        out.unlink()
    aside = {"azimuth_deg": np.full(1, 20.0), "range_edges_m": np.linspace(1.5, 4.0, 51)}
    np.savez(tmp_path / "aside.npz", image=image, **aside)
    said = complaint(2, "convert", tmp_path / "aside.npz", "--opening-deg", 9, "--out", out)
    assert "opening 9 deg" in said and "expected a fan that shows its beams" in said and not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("polar.npz", "--out", "p.npz"), "polar.npz: expected a fan picture to make a polar frame of"),
        (("polar.npz", *SECTOR, "--out", "p.npz"), "polar.npz: expected a fan picture to make a polar frame of"),
        (("FAN", "--sonar", "uneven.toml", "--bins", 3, "--out", "p.npz"), "fan.png: --bins: cannot be used with --so"),
        (("FAN", "--sonar", "no.toml", "--out", "p.npz"), "no.toml: no such file"),
        (("FAN", "--sonar", "uneven.toml", "--out", "uneven.toml"), "would overwrite the input"),
        (("polar.npz", "--sonar", "uneven.toml", "--out", "p.png"), "polar.npz: --sonar: cannot be used: the file"),
        (("FAN", "--sonar", "uneven.toml", "--out", "p.png"), "fan.png: --sonar: expected a frame of shape (100, 48)"),
        (("bare.npy", "--sonar", "uneven.toml", "--range-max", 3, "--out", "p.png"), "bare.npy: --range-max: cannot"),
        (("polar.npz", "--sonar", "uneven.toml", "--out", "p.bag"), "--sonar: cannot be used with the bag"),
    ],
)
def test_sonar_that_cannot_be_used(complaint, fan, uneven, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    before = set(os.listdir())
    given = [os.path.relpath(fan) if argument == "FAN" else argument for argument in arguments]
    assert words in complaint(2, "convert", *given)
    assert set(os.listdir()) == before


def test_frame_of_the_picture_counts_where_it_is_asked_for(command, tmp_path):
    """A picture that is all bright: only its frame can tell."""
    write_png(tmp_path / "a.png", np.pad(np.full((100, 80), 200, np.uint8), 10))
    for options, dark in (((), False), (("--frame",), True)):
        out = tmp_path / "a.npz"
        assert command("convert", tmp_path / "a.png", *SECTOR, *options, "--out", out)[0] == 0
        assert (read_frames(out)[0].image.min() < 0.1) == dark


def test_frame_goes_straight_into_segment(command, fan, tmp_path, stand_in):
    assert command("convert", fan, *SECTOR, "--bins", 64, "--beams", 24, "--out", tmp_path / "p.npz")[0] == 0
    assert command("segment", tmp_path / "p.npz", "--out-dir", tmp_path)[0] == 0
    assert np.load(tmp_path / "labels_p.npz")["labels"].shape == (64, 24)


@pytest.mark.slow  # compiles the network
def test_frame_is_segmented_by_the_shipped_network(command, fan, tmp_path):
    assert command("convert", fan, *SECTOR, "--bins", 128, "--beams", 96, "--out", tmp_path / "p.npz")[0] == 0
    assert command("segment", tmp_path / "p.npz", "--out-dir", tmp_path)[0] == 0
    labels = np.load(tmp_path / "labels_p.npz")["labels"]
    assert labels.shape == (128, 96) and labels.max() <= 2


def test_frame_of_the_right_shape_is_recognized(command, place, fan, tmp_path, stand_in):
    assert command("convert", fan, *SECTOR, "--bins", 64, "--beams", 24, "--out", tmp_path / "p.npz")[0] == 0
    options = ("--target", place / "brick.stl", "--sonar", place / "sonar.toml", "--out", tmp_path / "r.jsonl")
    assert command("recognize", tmp_path / "p.npz", *options)[0] == 0
    assert stand_in.calls[0]["mask"].all()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("FAN", "--out", "p.npz"), 2, "fan.png: --opening-deg: required for a fan picture"),
        (("FAN", "--opening-deg", 29, "--range-max", 4, "--out", "p.npz"), 2, "fan.png: --range-min: required"),
        (("FAN", *SECTOR, "--out", "p.jpg"), 2, "--out: 'p.jpg': expected an ending .npz"),
        (("FAN", *SECTOR, "--out", "FAN"), 2, "would overwrite the input"),
        (("FAN", *SECTOR, "--out", "missing/p.npz"), 2, "--out: 'missing/p.npz' cannot be written: expected a fold"),
        (("FAN", *SECTOR, "--width", 300, "--out", "p.npz"), 2, "--width: can only be used with a .png"),
        (("a.npy", *SECTOR, "--apex", 0, "--out", "p.png"), 2, "--apex: can only be used with a .npz"),
        (("a.npy", "--range-min", 0, "--out", "p.bag"), 2, "--range-min: cannot be used with the bag"),
        (("a.npy", *SECTOR, "--whole", "--out", "p.png"), 2, "--whole: can only be used with a .npz"),
        (("FAN", *SECTOR[:2], "--range-min", 4, "--range-max", 1.5, "--out", "p.npz"), 2, "fan.png: fan: range"),
        (("FAN", "--opening-deg", 0, *SECTOR[2:], "--out", "p.npz"), 2, "fan.png: fan: opening"),
        (("FAN", "--opening-deg", 400, *SECTOR[2:], "--out", "p.npz"), 2, "fan.png: fan: opening: expected above"),
        (("a.npy", "--opening-deg", 400, *SECTOR[2:], "--out", "p.png"), 2, "a.npy: fan: opening: expected above 0"),
        (("FAN", "--opening-deg", 1e-9, *SECTOR[2:], "--out", "p.npz"), 2, "fan.png: fan: opening, range and apex: ex"),
        (("FAN", *SECTOR[:2], "--range-min", 4, "--range-max", 4, "--out", "p.npz"), 2, "fan.png: fan: range: exp"),
        (("a.npy", *SECTOR[:2], "--range-min", -1, "--range-max", 4, "--out", "p.png"), 2, "a.npy: fan: range: expect"),
        (("FAN", *SECTOR[:4], "--range-max", 1500, "--out", "p.npz"), 2, "fan.png: fan: range: expected at most 1000"),
        (("FAN", *SECTOR[:2], "--range-min", 3.999, "--range-max", 4, "--out", "p.npz"), 2, "fan.png: fan: opening, r"),
        (("FAN", "--opening-deg", "nan", *SECTOR[2:], "--out", "p.npz"), 2, "--opening-deg: expected a number"),
        (("tiny.png", *SECTOR, "--out", "p.npz"), 2, "tiny.png: fan: picture: expected a fan of at least 8 x 8 pixels"),
        (("speck.png", *SECTOR, "--out", "p.npz"), 2, "speck.png: fan: picture: expected a fan of at least 8 x 8"),
        (("a.npy", *SECTOR, "--width", 7, "--out", "p.png"), 2, "x 7 of the frame: give a larger --width"),
        (("FAN", *SECTOR, "--whole", "--apex", 0, "--out", "p.npz"), 2, "fan.png: --apex: cannot be used with --whole"),
        (("FAN", *SECTOR, "--apex", 3, "--out", "p.npz"), 2, "fan.png: fan: apex: expected a row below"),
        (("FAN", *SECTOR, "--apex", 7.001, "--out", "p.npz"), 2, "fan.png: fan: expected a fan that overlaps"),
        (("FAN", *SECTOR, "--bins", 1.5, "--out", "p.npz"), 2, "--bins: expected a whole number"),
        (("black.png", *SECTOR, "--out", "p.npz"), 2, "black.png: fan: expected pixels above 0"),
        (("a.npy", "--out", "p.png"), 2, "a.npy: --opening-deg: required for a frame without azimuth_deg"),
        (("own.npz", *SECTOR, "--out", "p.png"), 2, "own.npz: --opening-deg: cannot be used: the file itself holds"),
        (("missing.png", *SECTOR, "--out", "p.npz"), 1, "missing.png: no such file"),
        (("broken.png", *SECTOR, "--out", "p.npz"), 1, "broken.png: expected a PNG file, this is none"),
        (("own.npz", "missing.aris", "--out", "p.mcap"), 1, "missing.aris: no such file"),
        (("own.npz", "--out", "missing/p.mcap"), 2, "--out: 'missing/p.mcap' cannot be written: expected"),
        (("own.npz", "a.npy", "--out", "p.png"), 2, "--out: 'p.png' holds one frame: expected one FILE, got 2"),
    ],
)  # fmt: skip
def test_what_cannot_be_converted(complaint, fan, tmp_path, monkeypatch, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", np.full((20, 10), 0.5, np.float32))
    np.savez("own.npz", image=np.full((2, 2), 0.5), azimuth_deg=np.array([-1.0, 1]), range_edges_m=np.arange(1.0, 4))
    write_png("black.png", np.zeros((20, 10), np.uint8))
    write_png("tiny.png", np.full((2, 2), 200, np.uint8))
    write_png("speck.png", np.pad(np.full((20, 7), 200, np.uint8), 50))
    (tmp_path / "broken.png").write_bytes(b"no picture")
    before = set(os.listdir())
    given = [os.path.relpath(fan) if argument == "FAN" else argument for argument in arguments]
    assert words in complaint(code, "convert", *given)
    assert set(os.listdir()) == before


@pytest.mark.parametrize("ending", ["bag", "mcap"])
def test_frames_become_one_log(command, complaint, tmp_path, ending):
    pytest.importorskip("rosbags")
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, 4, 3), np.uint8)
    names, axes = [], {"azimuth_deg": np.array([-1.0, 0.0, 1.0]), "range_edges_m": np.linspace(1, 2, 5)}
    for number, image in enumerate(images):
        names.append(tmp_path / f"{number}.npz")
        np.savez(names[-1], image=image, **axes)
    out = tmp_path / f"log.{ending}"
    assert command("convert", *names, "--out", out) == (0, f"{out}: 3 frames\n", "")
    frames = read_frames(str(out))
    np.testing.assert_allclose([frame.image for frame in frames], images / 255, atol=1e-4)
    told = command("info", out)[1]
    assert "topic         /sonar_image\n" in told and "n_frames      3\n" in told
    write_png(tmp_path / "grey.png", images[0])
    said = complaint(2, "convert", names[0], tmp_path / "grey.png", "--out", tmp_path / f"b.{ending}")
    assert "grey.png" in said and not (tmp_path / f"b.{ending}").exists()


@pytest.mark.parametrize(("module", "read"), [("convert", one_frame), ("describe", describe)])
def test_a_file_that_gives_no_frame_is_an_error(monkeypatch, module, read):
    monkeypatch.setattr(sys.modules[f"sonarjax.io.{module}"], "iter_frames", lambda spec: iter(()))
    with pytest.raises(SonarjaxError, match="^log.mcap:6: expected a frame, the file gives none$"):
        read("log.mcap:6")


@pytest.mark.parametrize("command_line", [("info",), ("convert", "--out", "m.png")])
def test_a_frame_that_a_bag_only_counts_is_an_error(complaint, tmp_path, monkeypatch, command_line):
    pytest.importorskip("rosbags")
    monkeypatch.chdir(tmp_path)
    axes = {"azimuth_deg": [-1.0, 0.0, 1.0], "range_min_m": 1.0, "range_max_m": 2.0}
    write_bag("log", [Frame(np.zeros((4, 3), np.float32), None, "f", "f", axes)] * 5)
    stated = Path("log/metadata.yaml")
    stated.write_text(stated.read_text().replace("message_count: 5", "message_count: 8"))
    said = complaint(1, command_line[0], "log:6", *command_line[1:])
    assert said == "sonarjax: error: log:/sonar_image: frame 6: expected 0 to 4, the bag holds only 5\n"


@pytest.mark.parametrize("ending", ["bag", "mcap"])
def test_a_damaged_frame_is_left_out_of_a_log(command, tmp_path, ending):
    pytest.importorskip("rosbags")
    content = bytearray(recording(3))
    path, out = tmp_path / "three.aris", tmp_path / f"log.{ending}"
    at = 1024 + (1024 + 64 * 48) + 436
    content[at] = 77  # PingMode of frame 1
    path.write_bytes(content)
    code, said, err = command("convert", path, "--out", out)
    assert (code, said) == (1, f"{out}: 2 frames\n")
    assert err.startswith(f"sonarjax: error: {path}: frame 1: PingMode") and err.count("\n") == 1
    assert len(read_frames(out)) == 2
    code, said, err = command("convert", f"{path}:1", "--out", out)
    assert (code, said) == (1, "") and f"{out}: not written, because no frame can be read" in err
    assert len(read_frames(out)) == 2
