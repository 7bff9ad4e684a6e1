"""Plain images (PNG, NPY, NPZ) as frames, with every check on type, size and values that a frame must pass.

An NPZ holds `image`, optionally `mask` (true where measured), and optionally `azimuth_deg` and `range_edges_m`, as
`sonarjax render` writes them. Where it was not measured, a float image may hold anything, such as NaN. At most
`PIXEL_LIMIT` pixels are unpacked, whatever a header asks for.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float32

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.frame import Frame, Geometry, evenly_spaced
from sonarjax.io.header import RANGE_LIMIT_M
from sonarjax.io.naming import frame_numbers, named
from sonarjax.io.npy import NpzArchive, parse_npy
from sonarjax.io.png import parse_png

ROUNDING = 1e-6
"""Floats up to this far outside [0, 1] are put down to float32 rounding and clipped."""


def unit_image(
    values: np.ndarray, name: str, mask: Bool[np.ndarray, "range beam"] | None = None
) -> Float32[np.ndarray, "range beam"]:
    """An image (range, beam) as float32 in [0, 1]: uint8 and uint16 divided by their maximum, floats unchanged.

    Other integers are refused: they come from arithmetic, and divided by their maximum the image would be black.

    Args:
        values: Stored image (range, beam), not empty.
        name: Its file, for messages.
        mask: True where a pixel was measured (range, beam); None means everywhere.

    Returns:
        The image (range, beam). Floats that are NaN, infinite or outside [0, 1] where `mask` is false become 0.

    Raises:
        SonarjaxError: The type is not a number, or an integer other than uint8 and uint16; or floats are NaN, infinite
            or outside [0, 1] by more than rounding where `mask` is true.
    """
    if values.dtype.kind in "iu":
        return _unit_integers(values, name)
    if values.dtype.kind not in "bf":
        raise SonarjaxError(f"{name}: image: dtype: expected integer or float, got {values.dtype}")
    if mask is not None:
        usable = (values >= -ROUNDING) & (values <= 1 + ROUNDING)
        values = np.where(mask | usable, values, values.dtype.type(0))
    if not np.isfinite(values).all():
        where = "" if mask is None else " where the mask is true"
        raise SonarjaxError(f"{name}: image: expected finite values{where}, got NaN or infinity")
    low, high = float(values.min()), float(values.max())
    if low < -ROUNDING or high > 1.0 + ROUNDING:
        raise SonarjaxError(f"{name}: image: expected floats in [0, 1], got {low:g} to {high:g}")
    return np.clip(values.astype(np.float32), 0.0, 1.0)


def _unit_integers(values: np.ndarray, name: str) -> Float32[np.ndarray, "range beam"]:
    if values.dtype.kind != "u" or values.dtype.itemsize > 2:
        hint = "convert it to the type whose maximum is white"
        raise SonarjaxError(f"{name}: image: dtype: expected uint8, uint16 or float, got {values.dtype}: {hint}")
    return values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)


def bool_mask(values: np.ndarray, shape: tuple[int, int], name: str) -> Bool[np.ndarray, "range beam"]:
    """A mask (range, beam) of booleans, or of numbers that are all 0 or 1.

    Raises SonarjaxError for another shape than the image's, other values, or a mask that is nowhere true.
    """
    if values.shape != shape:
        raise SonarjaxError(f"{name}: mask: expected the image's shape {shape}, got {values.shape}")
    if values.dtype.kind not in "biuf" or not ((values == 0) | (values == 1)).all():
        raise SonarjaxError(f"{name}: mask: expected booleans (true where measured), got other {values.dtype} values")
    if not values.any():
        raise SonarjaxError(f"{name}: mask: expected at least one measured pixel, the mask is false everywhere")
    return np.ascontiguousarray(values != 0)


def parse_png_frame(data: bytes, name: str, index: int | None = None) -> Iterator[Frame]:
    """Yield the frame of a grey PNG, a polar image with the near row first.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the name of the frame.
        index: Number of the frame, which can only be 0; None means the same.

    Yields:
        The only frame (range, beam).

    Raises:
        SonarjaxError: The PNG cannot be decoded, is animated, is not grey and opaque, or has more than `PIXEL_LIMIT`
            pixels; or the index is not 0.
    """
    yield _single(parse_png(data, name), name, index, "PNG")


def parse_npy_frame(data: bytes, name: str, index: int | None = None) -> Iterator[Frame]:
    """Yield the frame of an NPY.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the name of the frame.
        index: Number of the frame, which can only be 0; None means the same.

    Yields:
        The only frame (range, beam).

    Raises:
        SonarjaxError: The NPY cannot be read, its array cannot be used as an image, or the index is not 0.
    """
    yield _single(parse_npy(data, name, "image"), name, index, "NPY")


def parse_npz_frame(data: bytes, name: str, index: int | None = None) -> Iterator[Frame]:
    """Yield the frame of an NPZ: its `image`, and its `mask` and geometry if present.

    Args:
        data: Content of the file.
        name: Its path, for messages and for the name of the frame.
        index: Number of the frame, which can only be 0; None means the same.

    Yields:
        The only frame (range, beam).

    Raises:
        SonarjaxError: The NPZ cannot be read or has no `image`; an array cannot be used, or does not fit the image; or
            the index is not 0.
    """
    archive = NpzArchive(data, name)
    values = archive.array("image")
    mask = archive.array("mask") if "mask" in archive.keys else None
    yield _single(values, name, index, "NPZ", mask, archive)


def _single(
    values: np.ndarray,
    name: str,
    index: int | None,
    kind: str,
    mask: np.ndarray | None = None,
    archive: NpzArchive | None = None,
) -> Frame:
    frame_numbers(name, 1, index)
    if values.ndim != 2 or values.size == 0:
        raise SonarjaxError(f"{name}: image: expected a shape (range, beam) that is not empty, got {values.shape}")
    checked = None if mask is None else bool_mask(mask, values.shape, name)
    image = unit_image(values, name, checked)
    geometry = None if archive is None else _geometry(archive, image.shape)
    scale = f"{values.dtype}" + (", divided by its maximum" if values.dtype.kind in "iu" else "")
    return named(image, name, 0, 1, geometry, {"format": kind, "stored_scale": scale}, checked)


def _geometry(archive: NpzArchive, shape: tuple[int, int]) -> Geometry | None:
    """Geometry [m, deg] of an NPZ that `sonarjax render` wrote; None if it has none."""
    if not {"azimuth_deg", "range_edges_m"} <= set(archive.keys):
        return None
    azimuth = _ascending(archive, "azimuth_deg", shape[1], -180.0, 180.0)
    edges = _ascending(archive, "range_edges_m", shape[0] + 1, 0.0, RANGE_LIMIT_M)
    if not evenly_spaced(edges):
        raise SonarjaxError(f"{archive.name}: range_edges_m: expected range bins of equal length")
    return {
        "azimuth_deg": azimuth,
        "range_min_m": edges[0],
        "range_max_m": edges[-1],
        "n_ranges": shape[0],
    }


def _ascending(archive: NpzArchive, key: str, length: int, least: float, most: float) -> list[float]:
    values = archive.array(key)
    if values.shape != (length,):
        raise SonarjaxError(f"{archive.name}: {key}: expected {length} numbers to fit the image, got {values.shape}")
    numbers = values.astype(np.float64)
    if not np.isfinite(numbers).all() or (np.diff(numbers) <= 0).any():
        raise SonarjaxError(f"{archive.name}: {key}: expected finite numbers in ascending order")
    if numbers[0] < least or numbers[-1] > most:
        got = f"{numbers[0]:g} to {numbers[-1]:g}"
        raise SonarjaxError(f"{archive.name}: {key}: expected numbers from {least:g} to {most:g}, got {got}")
    return numbers.tolist()
