"""Where the pixels of a fan picture lie in the sonar's plane: `FanGeometry`, and the rule that finds it for a picture.

A fan picture shows the insonified sector from above: far is up, the sonar (the apex) is at the bottom of the picture or
below it, port is on the left, starboard on the right. Publishers resize such pictures, so rows and columns may have
different lengths in metres. Positions in a picture are in pixels from its upper left corner: the first pixel reaches
from 0 to 1, and its centre is at 0.5.

The rule: the pixels above black are the sector (`content_box`), and their bounding box is that of the sector. It is
2 · range_max · sin(opening / 2) wide (twice range_max from 180° on). Its upper edge is where the middle beam ends. Its
lower edge is where the outer beams begin (range_min · cos(opening / 2) in front of the sonar) or, from 180° on, where
they end. If beams reach farther to one side than to the other, the box is that of the real beams: see `fit_fan`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Real
from scipy import ndimage

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.npy import PIXEL_LIMIT

FAINT = 8 / 255
"""Share of full scale up to which a pixel may be the noise of a JPEG."""
JOINED = 5
"""Side of the square by which pixels are widened, so that black specks between them do not part a piece [pixels]."""
SMALL = 1 / 20
"""Share of the largest piece's pixels below which another piece of a picture is no part of the fan."""


class PictureBox(NamedTuple):
    """A rectangle in a picture; edges in pixels from the upper left corner."""

    top: float
    """Upper edge [pixels]."""
    bottom: float
    """Lower edge [pixels]."""
    left: float
    """Left edge [pixels]."""
    right: float
    """Right edge [pixels]."""


@dataclass(frozen=True)
class FanGeometry:
    """A sector and its position in a picture.

    Ranges are slant ranges. Azimuth grows to port and is 0 in the middle of the sector. A sonar whose beams reach
    farther to one side than to the other fills only a part of it.
    """

    opening: float
    """Full angle of the sector, between the outer edges of the two outer beams [rad]."""
    range_min: float
    """Range at which the sector begins [m]."""
    range_max: float
    """Range at which it ends [m]."""
    apex_row: float
    """Position of the sonar in rows from the picture's upper edge [pixels]; more than the picture's height if
    it is below.
    """
    apex_column: float
    """Position of the sonar in columns from the picture's left edge [pixels]."""
    row_m: float
    """Height of a pixel [m]."""
    column_m: float
    """Width of a pixel [m]."""

    def places(
        self, rows: Real[np.ndarray, "*grid"], columns: Real[np.ndarray, "*grid"]
    ) -> tuple[Float[np.ndarray, "*grid"], Float[np.ndarray, "*grid"]]:
        """Return the ranges and azimuths of positions in the picture.

        Args:
            rows, columns: Positions from the picture's upper left corner [pixels].

        Returns:
            Ranges [m] and azimuths [rad], of the shape of the positions.
        """
        forward = (self.apex_row - rows) * self.row_m
        lateral = (self.apex_column - columns) * self.column_m
        return np.hypot(forward, lateral), np.arctan2(lateral, forward)

    def pixels(
        self, ranges: Real[np.ndarray, "*grid"], azimuth: Real[np.ndarray, "*grid"]
    ) -> tuple[Float[np.ndarray, "*grid"], Float[np.ndarray, "*grid"]]:
        """Return the positions of points in the picture; the inverse of `places`.

        Args:
            ranges: Ranges of the points [m].
            azimuth: Their azimuths [rad].

        Returns:
            Rows and columns from the picture's upper left corner [pixels], of the shape of the points.
        """
        rows = self.apex_row - ranges * np.cos(azimuth) / self.row_m
        return rows, self.apex_column - ranges * np.sin(azimuth) / self.column_m

    def range_edges(self, bins: int) -> Float[np.ndarray, "range_edge"]:
        """Divide the sector into equal range bins.

        Args:
            bins: Number of range bins.

        Returns:
            Edges (range_edge,) of the bins, near to far [m].
        """
        return np.linspace(self.range_min, self.range_max, bins + 1)

    def azimuth(self, beams: int) -> Float[np.ndarray, "beam"]:
        """Divide the sector into equal beams.

        Args:
            beams: Number of beams.

        Returns:
            Beam centres (beam,), ascending from starboard to port [rad].
        """
        return even_beams(beams, self.opening)

    def polar_shape(self) -> tuple[int, int]:
        """Return the numbers of range bins and beams that keep the picture's resolution.

        There are as many bins as rows along the middle of the sector, and as many beams as columns along the arc at mid
        range. Farther away the picture is finer than the beams.

        Returns:
            Numbers of range bins and of beams, at least 1 each.
        """
        bins = (self.range_max - self.range_min) / self.row_m
        arc = self.opening * (self.range_max + self.range_min) / 2
        return max(round(bins), 1), max(round(arc / self.column_m), 1)


def even_beams(n_beams: int, field_of_view: float | int) -> Float[np.ndarray, "beam"]:
    """Centres (beam,) of equally wide beams whose outer edges span `field_of_view`, in the unit of that argument.

    >>> even_beams(4, 20.0).tolist()
    [-7.5, -2.5, 2.5, 7.5]
    """
    return (np.arange(n_beams) + 0.5 - n_beams / 2) * (field_of_view / n_beams)


def content_box(picture: Real[np.ndarray, "row column"]) -> PictureBox:
    """Find the bounding box of the fan in a picture.

    The fan is what lies above 0, without pieces that are small beside the largest one, such as a label. If there is
    black inside it, the picture may have been a JPEG, whose noise is above 0 around the fan too: then the fan is what
    lies above `FAINT` of full scale.

    Args:
        picture: Picture (row, column). Full scale is the largest number of an unsigned type; of another type it is 1,
            or the brightest pixel if that is brighter.

    Returns:
        The bounding box, along the outer edges of the pixels [pixels].

    Raises:
        SonarjaxError: No pixel is above 0.
    """
    picture = np.asarray(picture)
    if not (picture > 0).any():
        raise SonarjaxError("fan: expected pixels above 0, the picture is black")
    full = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else max(1.0, float(picture.max()))
    fan, bright = _large_pieces(picture > 0), picture > FAINT * full
    if bright.any() and (ndimage.binary_fill_holes(fan) != fan).any():
        fan = _large_pieces(bright)
    rows, columns = (np.flatnonzero(fan.any(axis)) for axis in (1, 0))
    return PictureBox(float(rows[0]), float(rows[-1] + 1), float(columns[0]), float(columns[-1] + 1))


def _large_pieces(mask: Bool[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """The pixels of a mask without its small pieces. Black specks, which speckle has, do not part a piece."""
    pieces, _ = ndimage.label(ndimage.maximum_filter(mask.astype(np.uint8), JOINED))
    sizes = np.bincount(pieces[mask])
    return mask & (sizes >= SMALL * sizes.max())[pieces]


def fit_fan(
    box: PictureBox,
    opening: float | int,
    range_min: float | int,
    range_max: float | int,
    apex_row: float | int | None = None,
    edges: tuple[float, float] | None = None,
) -> FanGeometry:
    """Find the geometry of a picture from the bounding box of its sector.

    Args:
        box: Bounding box of the sector in the picture.
        opening: Full angle of the sector [rad].
        range_min: Range at which the sector begins [m].
        range_max: Range at which it ends [m].
        apex_row: Row of the sonar, from the picture's upper edge [pixels]. None means that it follows from the box's
            lower edge (see the module's rule). If it is given, that edge is not used: the picture may be cut off below,
            or show the sonar at its own lower edge.
        edges: Azimuths [rad] of the starboard and the port edge of what the box holds, within the sector. None means
            all of the sector.

    Returns:
        The sector and its position in the picture.

    Raises:
        SonarjaxError: No sonar has such an opening or range window, the box is empty, or the apex is not below the
            box's top.
    """
    opening = _checked_opening(float(opening))
    extent = _extent(opening, float(range_min), float(range_max), edges)
    top, bottom = extent.top, extent.bottom
    if not (box.bottom > box.top and box.right > box.left):
        raise SonarjaxError(f"fan: expected a box of non-zero size, got {tuple(box)}")
    if apex_row is None:
        row_m = (top - bottom) / (box.bottom - box.top)
    elif apex_row > box.top:
        row_m = top / (apex_row - box.top)
    else:
        raise SonarjaxError(f"fan: apex: expected a row below the sector's top at {box.top:g}, got {apex_row:g}")
    column_m = (extent.port - extent.starboard) / (box.right - box.left)
    return FanGeometry(
        opening=opening,
        range_min=float(range_min),
        range_max=float(range_max),
        apex_row=box.top + top / row_m,
        apex_column=(box.left + box.right) / 2 + (extent.port + extent.starboard) / 2 / column_m,
        row_m=row_m,
        column_m=column_m,
    )


def fan_around(
    opening: float | int, range_min: float | int, range_max: float | int, pixel: float | int
) -> tuple[FanGeometry, tuple[int, int]]:
    """Plan a picture that just holds a sector.

    Complete pixels fill the sector's bounding box, so their height and width differ slightly.

    Args:
        opening: Full angle of the sector [rad].
        range_min: Range at which the sector begins [m].
        range_max: Range at which it ends [m].
        pixel: Approximate height and width of a pixel [m].

    Returns:
        Geometry of the picture, and its shape (rows, columns).

    Raises:
        SonarjaxError: As `fit_fan`, the pixel's size is not above 0, or the picture would have more than `PIXEL_LIMIT`
            pixels.
    """
    opening = _checked_opening(float(opening))
    extent = _extent(opening, float(range_min), float(range_max))
    if not pixel > 0:
        raise SonarjaxError(f"fan: pixel: expected a length above 0 m, got {pixel:g}")
    sides = extent.top - extent.bottom, extent.port - extent.starboard
    rows, columns = (max(round(length / pixel), 1) for length in sides)
    if rows * columns > PIXEL_LIMIT:
        raise SonarjaxError(f"fan: expected at most {PIXEL_LIMIT} pixels, got {rows} x {columns}")
    box = PictureBox(0.0, float(rows), 0.0, float(columns))
    return fit_fan(box, opening, range_min, range_max), (rows, columns)


class _Extent(NamedTuple):
    """A bounding box in the sonar's plane, which is at (0, 0): forward and to port [m]."""

    top: float
    bottom: float
    port: float
    starboard: float


def _checked_opening(opening: float) -> float:
    """The opening [rad]. That of a full circle may be larger by rounding, because it is a sum of beams."""
    if not 0 < opening <= 2 * math.pi * (1 + 1e-9):
        raise SonarjaxError(f"fan: opening: expected above 0 and up to 360 deg, got {math.degrees(opening):g}")
    return min(opening, 2 * math.pi)


def _extent(opening: float, range_min: float, range_max: float, edges: tuple[float, float] | None = None) -> _Extent:
    """Bounding box of a sector, or of its part between two azimuths [rad]."""
    if not 0 <= range_min < range_max < math.inf:
        raise SonarjaxError(f"fan: range: expected 0 <= minimum < maximum, got {range_min:g} to {range_max:g} m")
    low, high = (-opening / 2, opening / 2) if edges is None else edges
    angles = (low, high, *(angle for angle in (-math.pi / 2, 0.0, math.pi / 2) if low < angle < high))
    forward, lateral = (
        [radius * turned(angle) for radius in (range_min, range_max) for angle in angles]
        for turned in (math.cos, math.sin)
    )
    return _Extent(max(forward), min(forward), max(lateral), min(lateral))
