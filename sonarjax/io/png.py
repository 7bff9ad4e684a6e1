"""Grey PNG bytes to an array. The header is checked against the pixel limit before a decoder sees the file."""

from __future__ import annotations

import io
import struct

import numpy as np
from jaxtyping import UInt
from PIL import Image

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.npy import PIXEL_LIMIT

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""PNG colour type -> samples for each pixel."""
DEFLATE_RATIO = 1032
"""Deflate cannot compress more than this. A picture larger than the file could hold is truncated or hostile."""


def png_size(data: bytes, name: str) -> tuple[int, int]:
    """Height and width of a PNG [pixels], from its first chunk.

    Raises:
        SonarjaxError: The magic number or header is wrong, there are more pixels than `PIXEL_LIMIT` or than the file
            can hold, or samples of colour or transparency have 16 bits, which the decoder would cut to 8.
    """
    if data[:8] != PNG_MAGIC:
        raise SonarjaxError(f"{name}: expected a PNG file, this is none")
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise SonarjaxError(f"{name}: expected a PNG file with its header")
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    if width == 0 or height == 0:
        raise SonarjaxError(f"{name}: size: expected at least 1 x 1 pixels, got {height} x {width}")
    if colour not in CHANNELS or depth not in (1, 2, 4, 8, 16):
        raise SonarjaxError(f"{name}: header: unknown colour type {colour} with {depth} bits")
    if depth == 16 and colour != 0:
        raise SonarjaxError(f"{name}: header: got 16-bit colour or transparency: save it as 16-bit grey")
    if width * height > PIXEL_LIMIT:
        raise SonarjaxError(f"{name}: size: expected at most {PIXEL_LIMIT} pixels, got {height} x {width}")
    if width * height * depth * CHANNELS[colour] // 8 > DEFLATE_RATIO * len(data):
        raise SonarjaxError(f"{name}: truncated: {len(data)} bytes cannot hold {height} x {width} pixels")
    return height, width


def _check_complete(data: bytes, name: str) -> None:
    """Follow the chunks to the end marker, because a decoder accepts a file that stops after its last pixel."""
    at = len(PNG_MAGIC)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if kind == b"IEND" and at <= len(data):
            return
    raise SonarjaxError(f"{name}: truncated: expected an IEND chunk at the end of the PNG")


def parse_png(data: bytes, name: str) -> UInt[np.ndarray, "range beam"]:
    """Grey values of a PNG as uint8 or uint16; its (row, column) are (range, beam).

    A colour picture is accepted if it is grey (equal channels) and opaque.

    Raises:
        SonarjaxError: `png_size` or the decoder refuses the file, there are several pictures (an animation), or the
            picture is not grey and opaque.
    """
    height, width = png_size(data, name)
    _check_complete(data, name)
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
            if picture.size != (width, height):  # a second header would bypass the limit
                raise ValueError("two headers")
            values = _decode(picture)
            transparent = values.ndim == 2 and "transparency" in picture.info
            pictures = getattr(picture, "n_frames", 1)
    except Exception as error:  # on corrupt chunks a decoder may raise nearly anything
        text = " ".join(str(error).split())[:120] or type(error).__name__
        raise SonarjaxError(f"{name}: cannot be decoded as PNG: {text}") from error
    if pictures > 1:
        raise SonarjaxError(f"{name}: expected a PNG of one picture, got an animation of {pictures}")
    if transparent:
        raise SonarjaxError(f"{name}: expected a grey, opaque picture, got one grey value that is transparent (tRNS)")
    if values.ndim == 3:
        grey = values[..., 0]
        if (values[..., :3] != grey[..., None]).any() or (values[..., 3:] != 255).any():
            raise SonarjaxError(f"{name}: expected a grey, opaque picture, got colour or transparency")
        values = np.ascontiguousarray(grey)
    return values


def _decode(picture: Image.Image) -> np.ndarray:
    """uint8 or uint16 (row, column) for grey pictures, otherwise uint8 (row, column, 4)."""
    if picture.mode in ("1", "L"):
        return np.asarray(picture.convert("L"))
    if picture.mode.startswith("I"):  # 16-bit grey, which some decoders return in a wider type
        return np.asarray(picture).astype(np.uint16)
    return np.asarray(picture.convert("RGBA"))
