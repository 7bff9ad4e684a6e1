"""Corrupted files: 21,000 of them over all loaders give frames or SonarjaxError, and no big allocation.

Each example of Hypothesis gives two corrupted files: bytes overwritten, and the same cut short.
"""

import math
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sonarjax.io import SonarjaxError, parse_aris, parse_didson, parse_oculus, parse_toml, read_frames
from sonarjax.io.images import parse_npy_frame, parse_npz_frame, parse_png_frame

QUIET = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
WORDS = [struct.pack("<I", n) for n in (0, 1, 2, 255, 2**15, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1)]
WORDS += [struct.pack("<f", x) for x in (math.nan, math.inf, -math.inf, 1e30, -1e30, 0.0)]
WORDS += [struct.pack("<d", x) for x in (math.nan, 1e300)] + [b"\0", b"\xff", b"(", b"'", b"9", b"\n"]

EDITS = st.lists(
    st.tuples(st.integers(0, 2**16), st.sampled_from(WORDS) | st.binary(min_size=1, max_size=8)), min_size=1, max_size=3
)
CUTS = st.integers(0, 2**16)


def fuzzed(max_examples):
    """A slow test of `edits` (where, what) and `cut` (a length), both taken modulo the size of the file."""
    config = settings(
        max_examples=max_examples, deadline=None, derandomize=True, database=None, suppress_health_check=QUIET
    )
    return lambda test: pytest.mark.slow(config(given(edits=EDITS, cut=CUTS)(test)))


def corrupt(content, edits, cut, header=None):
    """`content` with bytes overwritten in its first `header` bytes, perhaps cut short."""
    damaged = bytearray(content)
    for where, what in edits:
        at = where % (header or len(content))
        damaged[at : at + len(what)] = what[: len(damaged) - at]
    return bytes(damaged if cut is None else damaged[: cut % len(damaged)])


def survive_both(parser, content, edits, cut, header=None):
    """`survive` for the content with its bytes overwritten, and for the same cut short."""
    survive(parser, corrupt(content, edits, None, header))
    survive(parser, corrupt(content, edits, cut, header))


def survive(parser, content):
    """Frames that keep the contract, or the package's own error in one line."""
    try:
        frames = list(parser(content, "fuzz.bin"))
    except SonarjaxError as error:
        assert str(error).startswith("fuzz.bin: ") and "\n" not in str(error)
        return
    for frame in frames:
        assert frame.image.dtype == np.float32 and frame.image.ndim == 2 and frame.image.size
        assert frame.image.min() >= 0.0 and frame.image.max() <= 1.0
        if frame.geometry is not None:
            assert len(frame.geometry["azimuth_deg"]) == frame.shape[1]
            assert 0.0 <= frame.geometry["range_min_m"] < frame.geometry["range_max_m"] < math.inf


@pytest.fixture(scope="module")
def valid(make):
    """A small valid file of each format."""
    grey = make.ramp(6, 5)
    return {
        "aris": make.aris(n_frames=2, n_ranges=4, ping_mode=1),
        "didson": make.didson(n_frames=1, n_beams=48),
        "oculus": make.oculus(),
        "npy": make.npy(grey),
        "npz": make.npz(image=grey / np.float32(255), mask=grey > 3),
        "png": make.png(grey),
    }


PARSERS = {
    "aris": parse_aris, "didson": parse_didson, "oculus": parse_oculus, "npy": parse_npy_frame, "npz": parse_npz_frame,
    "png": parse_png_frame,
}  # fmt: skip


@pytest.mark.parametrize("kind", PARSERS)
def test_some_damaged_files(valid, kind, rng):
    """What the slow tests do at length, for a few files."""
    for _ in range(60):
        edits = [(int(rng.integers(2**16)), WORDS[rng.integers(len(WORDS))]) for _ in range(2)]
        survive_both(PARSERS[kind], valid[kind], edits, int(rng.integers(2**16)))


@fuzzed(1750)
def test_aris(valid, edits, cut):
    survive_both(parse_aris, valid["aris"], edits, cut)


@fuzzed(1500)
def test_didson(valid, edits, cut):
    survive_both(parse_didson, valid["didson"], edits, cut, header=768)


@fuzzed(1750)
def test_oculus(valid, edits, cut):
    survive_both(parse_oculus, valid["oculus"], edits, cut)


@fuzzed(1500)
def test_npy(valid, edits, cut):
    survive_both(parse_npy_frame, valid["npy"], edits, cut, header=128)


@fuzzed(1250)
def test_npz(valid, edits, cut):
    survive_both(parse_npz_frame, valid["npz"], edits, cut)


@fuzzed(750)
def test_npz_members(make, valid, edits, cut):
    """Damage inside the archive, under a check sum that is right."""
    for length in (None, cut):
        survive(parse_npz_frame, make.npz(image=corrupt(valid["npy"], edits, length, header=128), mask=valid["npy"]))


@fuzzed(750)
def test_png(valid, edits, cut):
    survive_both(parse_png_frame, valid["png"], edits, cut)


@fuzzed(750)
def test_png_headers(valid, edits, cut):
    """Damage in the header chunk, under a check sum that is right."""
    body = corrupt(valid["png"][16:29], edits, None)
    chunk = b"IHDR" + body + struct.pack(">I", zlib.crc32(b"IHDR" + body))
    content = valid["png"][:12] + chunk + valid["png"][33:]
    survive(parse_png_frame, content)
    survive(parse_png_frame, content[: 33 + cut % len(content)])


@fuzzed(500)
def test_toml(edits, cut):
    for length in (None, cut):
        content = corrupt(b'preset = "didson-hf"\nazimuth_deg = [1, 2.5]\n[floor]\nx_m = 1e3\n', edits, length)
        try:
            assert isinstance(parse_toml(content, "fuzz.bin"), dict)
        except SonarjaxError as error:
            assert str(error).startswith("fuzz.bin: ") and "\n" not in str(error)


@fuzzed(100)
def test_from_the_disk(valid, tmp_path, edits, cut):
    for kind, ending in (("aris", "aris"), ("didson", "ddf"), ("oculus", "raw"), ("npz", "npz"), ("png", "png")):
        path = tmp_path / f"fuzz.{ending}"
        path.write_bytes(corrupt(valid[kind], edits, cut))
        try:
            read_frames(path)
        except SonarjaxError as error:
            assert str(error).startswith(str(path))


def peak_bytes(parser, content):
    """The most memory held at once to read the content: the less of two tries, as caches fill in the first."""

    def once():
        tracemalloc.start()
        try:
            survive(parser, content)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    return min(once(), once())


def hostile(content, spans, step):
    """Every field of the headers set to each large number in turn."""
    for at in (at for span in spans for at in range(*span, step)):
        for what in (b"\xff\xff\xff\xff", struct.pack("<I", 60000), struct.pack("<I", 2**24)):
            yield corrupt(content, [(at, what)], None)


HEADERS = [
    ("aris", parse_aris, [(0, 16), (1024, 1024 + 520)], 4),
    ("oculus", parse_oculus, [(0, 124)], 2),
    ("didson", parse_didson, [(0, 48), (512, 512 + 200)], 4),
    ("npy", parse_npy_frame, [(0, 128)], 2),
]


@pytest.mark.parametrize(
    ("kind", "parser", "spans", "step"),
    [pytest.param(*row, id=row[0], marks=pytest.mark.slow if row[0] in ("aris", "oculus") else ()) for row in HEADERS],
)
def test_no_allocation_that_only_a_header_asks_for(valid, kind, parser, spans, step):
    # float32 out of bytes is 4 x; a check makes a boolean of it; some kB of names and tables.
    limit = 9 * len(valid[kind]) + 400_000
    assert max(peak_bytes(parser, content) for content in hostile(valid[kind], spans, step)) < limit


def test_a_hostile_npz_stays_small(make):
    """50 MB of zeros behind a header that asks for little, and a header that asks for much with nothing behind it."""
    little = make.npy_header("{'descr': '|u1', 'fortran_order': False, 'shape': (3, 4)}") + bytes(50_000_000)
    much = make.npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (8000, 8000)}")
    for content in (make.npz(image=little), make.npz(image=much)):
        assert peak_bytes(parse_npz_frame, content) < 2_000_000
