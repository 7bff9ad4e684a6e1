"""Fan pictures to polar images and back, by interpolation, or by averaging where the target is much coarser.

Polar images follow the package's convention: axis 0 is range, near first, axis 1 the beam in ascending azimuth, so
column 0 is starboard-most. `FanGeometry` says where a picture's pixels lie. Between pixels both directions interpolate:
with `order` 3 by a cubic spline (the default, which keeps speckle), with 1 linearly (never brighter or darker than the
pixels around), with 0 by the nearest pixel, so that labels stay labels. A pixel that was not measured (black corners, a
mask) takes the value of the nearest measured one, so that edges neither darken nor ring. What a mask leaves out
does not shrink: a pixel or polar cell counts as measured only if its centre was.

A pixel of a picture that covers several polar cells takes the mean of that many points in it. A polar cell takes the
picture's value at its centre: a picture of a sonar's own cells passes through it there, and a mean over the cell would
mix its neighbours in. Only if every cell is more than `SHOWN` pixels long and wide do they take the mean of their
points, because such cells are coarser than what the picture shows, and one point of each would keep its noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Real, Shaped
from scipy import ndimage

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.fan_geometry import FanGeometry
from sonarjax.io.given import is_whole, number_array, several, shown
from sonarjax.io.npy import PIXEL_LIMIT

LEAST_WEIGHT = 0.01
"""Least share of a cell's interpolation weight that must fall on measured pixels."""
NEAREST_RANGE = 1 / 8
"""Share of the largest range. Nearer than that, beams become ever narrower, and not every one in a pixel is sampled."""
SHOWN = 4
"""A picture shows single polar cells if the shortest side of the smallest is at most this many pixels long. Longer
cells are averaged.
"""
MOST_PARTS = 64
"""Most points along one side of a cell that are averaged."""

Order = Literal[0, 1, 3]
Places = Iterator[tuple[np.ndarray, np.ndarray]]


def fan_to_polar(
    picture: Shaped[np.ndarray, "row column"],
    geometry: FanGeometry,
    shape: tuple[int, int] | None = None,
    order: Order = 3,
    azimuth: Real[np.ndarray, "beam"] | None = None,
    range_edges: Real[np.ndarray, "range_edge"] | None = None,
    mask: Bool[np.ndarray, "row column"] | None = None,
) -> tuple[Shaped[np.ndarray, "range beam"], Bool[np.ndarray, "range beam"]]:
    """Turn a fan picture (row, column) into a polar image (range, beam).

    Args:
        picture: Fan picture (row, column).
        geometry: Where its pixels lie.
        shape: Numbers of range bins and beams; None means as many as `range_edges` and `azimuth` have, or else
            `geometry.polar_shape()`.
        order: Interpolation: 3 for a cubic spline, 1 for linear, 0 for the nearest pixel (labels).
        azimuth: Beam centres (beam,) in ascending order [rad]; None divides the sector evenly.
        range_edges: Edges (range_edge,) of the range bins in ascending order [m]; None divides the sector evenly.
        mask: True where the picture was measured (row, column); None means in all of the sector.

    Returns:
        Image (range, beam) and mask (range, beam). The mask is true where the picture shows the cell; elsewhere the
        image is 0. The image is float32, on the picture's own scale and within its values; with `order` 0 it has the
        picture's type.

    Raises:
        SonarjaxError: The picture or shape is empty, or is not of two axes; a measured pixel of the sector or an axis
            is not finite; the mask does not fit the picture; an axis does not ascend or does not fit `shape`; `order`
            is another number; or there are more than `PIXEL_LIMIT` cells.
    """
    picture = _image("picture", picture, order)
    azimuth, range_edges = _axis("azimuth", azimuth), _axis("range_edges", range_edges)
    bins, beams = _checked(_polar_shape(geometry, azimuth, range_edges) if shape is None else shape)
    azimuth = geometry.azimuth(beams) if azimuth is None else azimuth
    range_edges = geometry.range_edges(bins) if range_edges is None else range_edges
    _check_axis("azimuth", azimuth, beams)
    _check_axis("range_edges", range_edges, bins + 1)
    edges = range_edges, _beam_edges(azimuth, geometry.opening)
    parts = (1, 1) if order == 0 else _parts_of_cell(geometry, *edges)
    measured = _measured(mask, picture.shape)
    inside = measured & _inside(geometry, picture.shape)
    cells = _cells(azimuth, edges)
    image, seen = _sample(picture, inside, _places_in_picture(geometry, cells, parts), (bins, beams), order)
    if mask is not None:
        seen &= _at_centres(measured, _places_in_picture(geometry, cells, (1, 1)))
    return np.where(seen, image, image.dtype.type(0)), seen


def polar_to_fan(
    image: Shaped[np.ndarray, "range beam"],
    azimuth: Real[np.ndarray, "beam"],
    range_edges: Real[np.ndarray, "range_edge"],
    geometry: FanGeometry,
    shape: tuple[int, int],
    mask: Bool[np.ndarray, "range beam"] | None = None,
    order: Order = 3,
) -> tuple[Shaped[np.ndarray, "row column"], Bool[np.ndarray, "row column"]]:
    """Turn a polar image (range, beam) into a fan picture (row, column).

    It also brings a polar map, such as labels, back to the picture that `fan_to_polar` took: give that picture's
    geometry and shape.

    Args:
        image: Polar image (range, beam).
        azimuth: Beam centres (beam,) in ascending order [rad].
        range_edges: Edges (range_edge,) of the range bins in ascending order [m].
        geometry: Where the picture's pixels lie.
        shape: Rows and columns of the picture.
        mask: True where the image was measured (range, beam); None means everywhere.
        order: Interpolation: 3 for a cubic spline, 1 for linear, 0 for the nearest pixel (labels).

    Returns:
        Picture (row, column) and mask (row, column). The mask is true where a pixel's centre lies in the measured
        sector; elsewhere the picture is 0. The types are as in `fan_to_polar`.

    Raises:
        SonarjaxError: The image is empty or not of two axes; a measured pixel or an axis is not finite; axes or mask do
            not fit the image; an axis does not ascend; `order` is another number; the shape is empty; or there are more
            than `PIXEL_LIMIT` pixels.
    """
    image, rows, columns = _image("image", image, order), *_checked(shape)
    azimuth, range_edges = _axis("azimuth", azimuth), _axis("range_edges", range_edges)
    _check_axis("azimuth", azimuth, image.shape[1])
    _check_axis("range_edges", range_edges, image.shape[0] + 1)
    measured = _measured(mask, image.shape)
    edges = range_edges, _beam_edges(azimuth, geometry.opening)
    parts = (1, 1) if order == 0 else _parts_of_pixel(geometry, *edges)
    cells = _cells(azimuth, edges)
    picture, seen = _sample(image, measured, _places_in_image(geometry, shape, cells, parts), (rows, columns), order)
    seen &= _covered(*geometry.places(*_centres(shape)), edges)
    if mask is not None:
        seen &= _at_centres(measured, _places_in_image(geometry, shape, cells, (1, 1)))
    return np.where(seen, picture, picture.dtype.type(0)), seen


def _measured(mask: Any, shape: tuple[int, ...]) -> Bool[np.ndarray, "row column"]:
    """The mask of an image of this shape; true everywhere if there is none."""
    if mask is None:
        return np.ones(shape, bool)
    measured = np.asarray(number_array(mask, "fan: mask"), bool)
    if measured.shape != shape:
        raise SonarjaxError(f"fan: mask: expected the image's shape {shape}, got {measured.shape}")
    return measured


def _at_centres(measured: np.ndarray, places: Places) -> np.ndarray:
    """Whether the middle of each cell, the first of its `places`, lies in a measured pixel."""
    rows, columns = (np.floor(at + 0.5).astype(int) for at in next(places))
    return measured[np.clip(rows, 0, measured.shape[0] - 1), np.clip(columns, 0, measured.shape[1] - 1)]


def _sample(
    source: np.ndarray, measured: np.ndarray, places: Places, shape: tuple[int, int], order: Order
) -> tuple[np.ndarray, np.ndarray]:
    """For each cell of `shape`, the mean of `source` over `places`, and whether it is known.

    Every item of `places` holds a (row, column) for each cell. A cell is known if a measured pixel is close enough.
    """
    if not np.isfinite(source[measured]).all():
        raise SonarjaxError("fan: expected finite values in all pixels that were measured")
    values = source if order == 0 else source.astype(np.float32)
    if not measured.any():
        return np.zeros(shape, values.dtype), np.zeros(shape, bool)
    known = measured.astype(np.float32)
    values = _filled(values, measured)
    low, high = values.min(), values.max()  # a spline can overshoot
    if order == 3:
        values = ndimage.spline_filter(values, order, output=np.float32, mode="mirror")
    total, weight, count = np.zeros(shape, values.dtype), np.zeros(shape, np.float32), 0
    for rows, columns in places:
        weight += ndimage.map_coordinates(known, [rows, columns], order=min(order, 1), mode="grid-constant")
        at = [np.clip(rows, 0, source.shape[0] - 1), np.clip(columns, 0, source.shape[1] - 1)]
        total += _interpolated(values, at, order)
        count += 1
    mean = total if order == 0 else np.clip(total / np.float32(count), low, high)
    seen = weight > LEAST_WEIGHT * count
    return np.where(seen, mean, values.dtype.type(0)), seen


def _interpolated(values: np.ndarray, at: list[np.ndarray], order: Order) -> np.ndarray:
    """The values, splines' coefficients for `order` 3, at rows and columns within them."""
    if order == 0:  # of any type, as scipy's are not
        return values[tuple(np.floor(place + 0.5).astype(int) for place in at)]
    return ndimage.map_coordinates(values, at, order=order, mode="mirror", prefilter=False)


def _filled(values: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Give every pixel that was not measured the value of the nearest measured one."""
    if measured.all():
        return values
    nearest = ndimage.distance_transform_edt(~measured, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def _polar_shape(geometry: FanGeometry, azimuth: np.ndarray | None, range_edges: np.ndarray | None) -> tuple[int, int]:
    """Numbers of range bins and beams: those of the axes, where they are given, or else the picture's own."""
    bins, beams = geometry.polar_shape()
    return bins if range_edges is None else range_edges.size - 1, beams if azimuth is None else azimuth.size


class _Cells(NamedTuple):
    """Cells along one axis of a polar image. The centre of a beam need not lie midway between its edges."""

    centres: np.ndarray
    """Centre of each cell (cell,), in ascending order."""
    edges: np.ndarray
    """Edges between them and at both ends (cell + 1,)."""

    def parts(self, count: int) -> Float[np.ndarray, "part cell"]:
        """Middles (part, cell) of the equal parts of each cell, or its centre if it is one part."""
        return self.centres[None] if count == 1 else _middles(self.edges, count)

    def number(self, values: np.ndarray) -> np.ndarray:
        """Number of the cell in which each value lies, with a fraction that is 0 at the cell's centre."""
        known = np.empty(2 * self.centres.size + 1)
        known[::2], known[1::2] = self.edges, self.centres
        return np.interp(values, known, np.arange(known.size) / 2 - 0.5)


def _cells(azimuth: np.ndarray, edges: tuple[np.ndarray, np.ndarray]) -> tuple[_Cells, _Cells]:
    """Range bins, and beams with their centres (beam,) [rad], between `edges` [m, rad]."""
    return _Cells(_middles(edges[0], 1)[0], edges[0]), _Cells(azimuth, edges[1])


def _places_in_picture(geometry: FanGeometry, cells: tuple[_Cells, _Cells], parts: tuple[int, int]) -> Places:
    """Rows and columns, from the first pixel's centre, of the first part of every polar cell, then of each
    further part.
    """
    ranges, angles = (one.parts(count) for one, count in zip(cells, parts, strict=True))
    for at_ranges in ranges:
        for at_angles in angles:
            rows, columns = geometry.pixels(*np.meshgrid(at_ranges, at_angles, indexing="ij"))
            yield rows - 0.5, columns - 0.5


def _middles(edges: np.ndarray, parts: int) -> Float[np.ndarray, "part cell"]:
    """Middles (part, cell) of the equal parts of each cell between `edges`."""
    share = (np.arange(parts)[:, None] + 0.5) / parts
    return edges[:-1] + share * np.diff(edges)


def _places_in_image(
    geometry: FanGeometry, shape: tuple[int, int], cells: tuple[_Cells, _Cells], parts: tuple[int, int]
) -> Places:
    """Bins and beams, from the first cell's centre, of the first part of every pixel, then of each further part."""
    for i in range(parts[0]):
        for j in range(parts[1]):
            ranges, angles = geometry.places(*_centres(shape, (i + 0.5) / parts[0], (j + 0.5) / parts[1]))
            yield cells[0].number(ranges), cells[1].number(angles)


def _centres(shape: tuple[int, int], down: float = 0.5, right: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a point in every pixel: its centre, or the shares `down` and `right` of its size."""
    rows, columns = np.meshgrid(np.arange(shape[0]) + down, np.arange(shape[1]) + right, indexing="ij")
    return rows, columns


def _covered(
    ranges: Float[np.ndarray, "*grid"], angles: Float[np.ndarray, "*grid"], edges: tuple[np.ndarray, np.ndarray]
) -> Bool[np.ndarray, "*grid"]:
    """Which points lie between the outermost edges of the range bins [m] and of the beams [rad]."""
    (near, far), (starboard, port) = edges[0][[0, -1]], edges[1][[0, -1]]
    return (near <= ranges) & (ranges <= far) & (starboard <= angles) & (angles <= port)


def _inside(geometry: FanGeometry, shape: tuple[int, int]) -> Bool[np.ndarray, "row column"]:
    """Which pixels have their centre in the sector."""
    half = geometry.opening / 2
    edges = np.array([geometry.range_min, geometry.range_max]), np.array([-half, half])
    return _covered(*geometry.places(*_centres(shape)), edges)


def _parts_of_cell(geometry: FanGeometry, range_edges: np.ndarray, beam_edges: np.ndarray) -> tuple[int, int]:
    """Points to average in a polar cell along range and across it: its pixels if it is coarse, or else its centre."""
    angles = np.array([0.0, min(geometry.opening, np.pi) / 2])
    along = np.hypot(np.cos(angles) / geometry.row_m, np.sin(angles) / geometry.column_m).max()
    across = np.hypot(np.sin(angles) / geometry.row_m, np.cos(angles) / geometry.column_m).max()
    depth, width = float(np.diff(range_edges).max()), float(range_edges[-1]) * float(np.diff(beam_edges).max())
    least = float(np.diff(range_edges).min())
    narrow = nearest_range(range_edges[0], range_edges[-1]) * float(np.diff(beam_edges).min())
    coarse = min(_parts(least * along), _parts(narrow * across)) > SHOWN
    return (_parts(depth * along), _parts(width * across)) if coarse else (1, 1)


def _parts_of_pixel(geometry: FanGeometry, range_edges: np.ndarray, beam_edges: np.ndarray) -> tuple[int, int]:
    """How many polar cells a pixel covers, down and across."""
    near = nearest_range(range_edges[0], range_edges[-1])
    depth, width = float(np.diff(range_edges).min()), near * float(np.diff(beam_edges).min())
    sine = abs(np.sin(min(geometry.opening, np.pi) / 2))
    down = geometry.row_m * max(1 / depth, sine / width)
    across = geometry.column_m * max(1 / width, sine / depth)
    return _parts(down), _parts(across)


def nearest_range(near: float, far: float) -> float:
    """Range [m] at which beams are taken to be narrowest: `near`, but no less than `NEAREST_RANGE` of `far`."""
    return max(float(near), NEAREST_RANGE * float(far))


def _parts(covered: float) -> int:
    return min(max(round(covered), 1), MOST_PARTS)


def _beam_edges(azimuth: np.ndarray, opening: float) -> Float[np.ndarray, "beam_edge"]:
    """Edges of beams [rad]: midway between centres, the outer two as far from theirs; a single beam fills all."""
    centres = np.asarray(azimuth, np.float64)
    if centres.size == 1:
        return centres + np.array([-opening / 2, opening / 2])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([2 * centres[:1] - middle[:1], middle, 2 * centres[-1:] - middle[-1:]])


def _image(name: str, values: Any, order: int) -> np.ndarray:
    """The values as an array of two axes, which may be interpolated with this order."""
    if order not in (0, 1, 3):
        raise SonarjaxError(f"fan: order: expected 0, 1 or 3, got {shown(order)}")
    array = number_array(values, f"fan: {name}")
    if array.ndim != 2:
        raise SonarjaxError(f"fan: {name}: expected one grey image of two axes, got shape {array.shape}")
    _checked(array.shape)
    return array


def _axis(name: str, values: Any) -> Any:
    """The values as float64; None stays None."""
    return None if values is None else np.asarray(number_array(values, f"fan: {name}"), np.float64)


def _check_axis(name: str, values: np.ndarray, length: int) -> None:
    if values.shape != (length,) or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
        raise SonarjaxError(f"fan: {name}: expected {length} finite numbers in ascending order to fit the image")


def _checked(shape: tuple[int, ...]) -> tuple[int, int]:
    if len(several(shape) or ()) != 2 or not all(map(is_whole, shape)):
        raise SonarjaxError(f"fan: shape: expected two whole numbers, got {shown(shape)}")
    rows, columns = shape
    if rows < 1 or columns < 1 or rows * columns > PIXEL_LIMIT:
        raise SonarjaxError(f"fan: shape: expected 1 x 1 to {PIXEL_LIMIT} pixels in total, got {rows} x {columns}")
    return rows, columns
