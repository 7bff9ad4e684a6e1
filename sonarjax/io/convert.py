"""`sonarjax convert`: a fan picture to a polar frame in an NPZ, a polar frame to a fan picture, frames to a ROS bag."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from sonarjax.io.atomic import write_npz, write_png
from sonarjax.io.console import complain
from sonarjax.io.errors import SonarjaxError, UnreadableError
from sonarjax.io.fan import fan_to_polar, nearest_range, polar_to_fan
from sonarjax.io.fan_geometry import FanGeometry, PictureBox, content_box, even_beams, fan_around, fit_fan
from sonarjax.io.frame import Frame
from sonarjax.io.given import is_number, shown
from sonarjax.io.header import RANGE_LIMIT_M
from sonarjax.io.load import iter_frames, iter_records, split_spec
from sonarjax.io.ros import write_bag

DARKEST = 1 / 255
"""Least value of a measured pixel in a fan picture. Black means not measured, and shows where the sector ends."""

STRETCHED = 0.02
"""Difference between height and width of a fan picture's pixels from which on a note tells of it [1]."""
SQUEEZED = 10.0
"""Ratio of height and width of a fan picture's pixels above which the fan cannot be the one that was told [1]."""
SMALLEST = 8
"""Fewest rows and columns of a fan [pixels]."""
FINE = 2
"""Pixels of a fan picture along the shortest side of the polar cells. One would lose speckle as fine as the cells."""
LARGE = 2**23
"""Pixels of a fan picture above which they are made longer, up to the length of a bin or of a beam at mid range."""


@dataclass(frozen=True)
class FanOptions:
    """What the command line says about a fan picture; None for what it does not say."""

    opening_deg: float | None = None
    """Full angle of the fan, to the outer edges of the outer beams [deg]."""
    range_min: float | None = None
    """Range at which the fan begins [m]."""
    range_max: float | None = None
    """Range at which it ends [m]."""
    beams: int | None = None
    """Beams of the polar frame (default: the columns along the fan's arc at mid range)."""
    bins: int | None = None
    """Range bins of the polar frame (default: the rows of the fan along its middle)."""
    apex: float | None = None
    """Row of the fan picture at which the sonar is [pixels] (default: found from where the outer beams begin)."""
    whole: bool = False
    """The picture reaches down to the sonar, which is at its lower edge, below the middle of the fan."""
    frame: bool = False
    """The fan touches all four edges of the picture, rather than those of the box that `content_box` finds. If its
    beams reach farther to one side, the edges are those of the sector about the middle, as a fan picture of ours has.
    """
    width: int | None = None
    """Columns of the fan picture to make; by default a pixel is half as long [m] as a bin, or half as long as a
    beam is wide at `nearest_range` if that is less. A picture that would have more than `LARGE` pixels has longer ones.
    """

    def __post_init__(self) -> None:
        """Raises SonarjaxError for a number of beams, bins or columns below 1, or an angle or length not finite."""
        for name in ("beams", "bins", "width"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise SonarjaxError(f"{_option(name)}: expected a number of 1 or more, got {getattr(self, name)}")
        for name in (*SECTOR, "apex"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and math.isfinite(value)):
                raise SonarjaxError(f"{_option(name)}: expected a finite number, got {shown(value)}")


@dataclass(frozen=True, eq=False)
class PolarAxes:
    """The beams and range bins of a sonar's frames."""

    azimuth: Float[np.ndarray, "beam"]
    """Beam centres (beam,) in ascending order [rad]."""
    range_edges: Float[np.ndarray, "range_edge"]
    """Edges (range_edge,) of the range bins in ascending order [m]."""

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (range, beam) of the frames."""
        return self.range_edges.size - 1, self.azimuth.size


FAN_OPTIONS = {
    "--opening-deg": ("D", "full angle of the fan, to the outer edges of the outer beams [deg] (default: --sonar's)"),
    "--range-min": ("M", "range at which the fan begins [m] (default: --sonar's)"),
    "--range-max": ("M", "range at which the fan ends [m] (default: --sonar's)"),
    "--bins": ("N", "to polar: range bins (default: rows of the fan along its middle)"),
    "--beams": ("N", "to polar: beams (default: columns along the fan's arc at mid range)"),
    "--apex": ("ROW", "to polar: row of the picture where the sonar is (default: found from the fan's lower edge)"),
    "--whole": (None, "to polar: the sonar is at the picture's lower edge (instead of --apex)"),
    "--frame": (
        None,
        "to polar: the fan touches all four edges of the picture (default: its edges are found from the pixels above "
        "black)",
    ),
    "--width": (
        "N",
        "to fan: columns of the picture (default: two pixels for each bin, or for each beam if that is finer)",
    ),
}
"""Command-line option for each field of FanOptions -> its argument (None for a switch) and its help text."""
SECTOR = ("opening_deg", "range_min", "range_max")
TO_POLAR = ("beams", "bins", "apex", "whole", "frame")
TO_FAN = ("width",)


def one_frame(spec: str) -> Frame:
    """Read the only frame of a file, or frame N of `path:N`.

    Args:
        spec: Name of the frame, as for `read_frames`.

    Returns:
        The frame (range, beam); for a fan picture its axes are (row, column).

    Raises:
        SonarjaxError: As `read_frames`, or the file holds several frames and `spec` does not say which.
    """
    frame = next(iter_frames(spec), None)
    if frame is None:
        raise SonarjaxError(f"{spec}: expected a frame, the file gives none")
    if frame.meta["n_frames"] > 1 and split_spec(spec).number is None:
        raise SonarjaxError(f"{spec}: expected one frame, the file holds {frame.meta['n_frames']}: give {spec}:N")
    return frame


def to_bag(
    specs: Sequence[str],
    out: str,
    options: FanOptions = FanOptions(),
    report: Callable[[SonarjaxError], object] | None = None,
) -> str:
    """Write all frames of several files as the sonar images of a ROS bag.

    Args:
        specs: Names of the frames (range, beam), as for `read_frames`.
        out: Bag to write, ending in .bag or .mcap.
        options: Must hold no option, because options are for fan pictures.
        report: Called with the error of each damaged frame of a recording, which is left out of the bag. None: a
            damaged frame is raised as an UnreadableError, and no bag is written.

    Returns:
        One line that says what was written.

    Raises:
        UnreadableError: A file cannot be read, see `read_frames`, or every frame is damaged. Then no bag is written.
        SonarjaxError: An option is given, or as `write_bag`.
    """
    for name in FanOptions.__dataclass_fields__:
        if _given(options, name):
            raise SonarjaxError(f"{_option(name)}: cannot be used with the bag {out!r} as --out")
    count = write_bag(out, _readable(specs, out, report))
    return f"{out}: {count} frame{'' if count == 1 else 's'}"


def _readable(specs: Sequence[str], out: str, report: Callable[[SonarjaxError], object] | None) -> Iterator[Frame]:
    read, damaged = 0, 0
    for spec in specs:
        try:
            for record in iter_records(spec):
                if isinstance(record, Frame):
                    read += 1
                    yield record
                elif report is None:
                    raise record
                else:
                    damaged += 1
                    report(record)
        except SonarjaxError as error:
            raise UnreadableError(str(error)) from error
    if damaged and not read:
        raise UnreadableError(f"{out}: not written, because no frame can be read")


def convert(frame: Frame, out: str, options: FanOptions = FanOptions(), axes: PolarAxes | None = None) -> str:
    """Convert a fan picture to a polar frame in an NPZ, or a polar frame to a fan picture in a PNG, and write it.

    A note on stderr tells of a fan picture whose pixels, as its fan was found, are not square, and of a polar frame
    whose mask is lost in the picture.

    Args:
        frame: Fan picture (row, column) if `out` ends in .npz, polar frame (range, beam) if it ends in .png.
        out: File to write; its ending says which conversion is wanted.
        options: What is known of the fan picture. A fan picture needs its opening and both ranges, and so does a polar
            frame without geometry, unless `axes` are given.
        axes: Beams and range bins of the polar frame. None divides the fan into equal beams, which are not those of a
            sonar with uneven beams.

    Returns:
        One line that says what was written, and where in a fan picture the fan and the sonar were found.

    Raises:
        SonarjaxError: `out` has another ending or cannot be written; an option is missing, is for the other direction,
            repeats what the file or `axes` hold or is out of range; the picture shows no fan or is a polar frame
            already; or a polar frame does not fit the axes.
    """
    ending = os.path.splitext(out)[1].lower()
    if ending not in (".npz", ".png"):
        raise SonarjaxError(
            f"--out: {out!r}: expected an ending .npz (a polar frame), .png (a fan picture), .bag or .mcap"
        )
    for name in TO_FAN if ending == ".npz" else TO_POLAR:
        if _given(options, name):
            other = "png" if ending == ".npz" else "npz"
            raise SonarjaxError(f"{_option(name)}: can only be used with a .{other} file as --out, got {out!r}")
    try:
        return (_to_polar if ending == ".npz" else _to_fan)(frame, out, options, axes)
    except SonarjaxError as error:  # add the file to a message about its fan or an option
        text = str(error)
        raise SonarjaxError(f"{frame.source}: {text}" if text.startswith(("fan: ", "--")) else text) from error


def _to_polar(picture: Frame, out: str, options: FanOptions, axes: PolarAxes | None) -> str:
    if picture.geometry is not None:
        raise SonarjaxError(f"{picture.source}: expected a fan picture to make a polar frame of, this is a polar frame")
    if options.whole and options.apex is not None:
        raise SonarjaxError("--apex: cannot be used with --whole, which says where the sonar is")
    opening_deg, near, far = _sector(_with_axes(options, axes), "a fan picture, unless --sonar is given")
    rows, columns = picture.shape
    bright = picture.image if picture.mask is None else np.where(picture.mask, picture.image, np.float32(0))
    box = PictureBox(0.0, float(rows), 0.0, float(columns)) if options.frame else content_box(bright)
    _check_size(box.bottom - box.top, box.right - box.left)
    apex = float(rows) if options.whole else options.apex
    geometry = fit_fan(box, math.radians(opening_deg), near, far, apex, _edges_in_box(options, axes))
    if axes is None:
        bins, beams = geometry.polar_shape()
        bins, beams = options.bins or bins, options.beams or beams
        axes = PolarAxes(geometry.azimuth(beams), geometry.range_edges(bins))
    if axes.range_edges[-1] > RANGE_LIMIT_M:  # our own reader would refuse it
        raise SonarjaxError(f"fan: range: expected at most {RANGE_LIMIT_M:g} m, got {axes.range_edges[-1]:g} m")
    image, mask = fan_to_polar(picture.image, geometry, axes.shape, 3, axes.azimuth, axes.range_edges, picture.mask)
    if not mask.any():
        raise SonarjaxError("fan: expected a fan that overlaps the picture, it lies outside")
    _check_pixels(geometry)
    write_npz(out, image=image, mask=mask, azimuth_deg=np.degrees(axes.azimuth), range_edges_m=axes.range_edges)
    if abs(geometry.row_m / geometry.column_m - 1) > STRETCHED:
        complain(
            f"{picture.source}: a pixel is {geometry.row_m:.4g} m high and {geometry.column_m:.4g} m wide: unless the "
            "picture was stretched, the fan is not where it was found, or not as --opening-deg and ranges say: see "
            "--apex, --whole and --frame",
            kind="note: ",
        )
    size = f"{axes.shape[0]} range bins x {axes.shape[1]} beams"
    place = f"the fan in rows {box.top:g} to {box.bottom:g} and columns {box.left:g} to {box.right:g}"
    measured = f"{mask.mean():.1%} of the pixels measured"
    told = _told(opening_deg, near, far)
    return f"{out}: {size}, {told}, {measured}; {place}, the sonar at row {geometry.apex_row:.1f}"


def _edges_in_box(options: FanOptions, axes: PolarAxes | None) -> tuple[float, float] | None:
    """Outer edges [rad] of the beams in the fan's box; None if the box is that of a sector about the middle."""
    if axes is None or options.opening_deg is not None or options.frame:
        return None
    return _outer_edges(axes.azimuth)


def _with_axes(options: FanOptions, axes: PolarAxes | None) -> FanOptions:
    """The options, with the sector of `axes` where they name none; `axes` and options must not repeat each other."""
    if axes is None:
        return options
    for name in ("beams", "bins"):
        if _given(options, name):
            raise SonarjaxError(f"{_option(name)}: cannot be used with --sonar, which holds this value")
    near, far = float(axes.range_edges[0]), float(axes.range_edges[-1])
    return replace(
        options,
        opening_deg=math.degrees(_opening(axes.azimuth, options)),
        range_min=near if options.range_min is None else options.range_min,
        range_max=far if options.range_max is None else options.range_max,
    )


def _to_fan(polar: Frame, out: str, options: FanOptions, axes: PolarAxes | None) -> str:
    azimuth, edges = _axes(polar, options, axes)
    opening, near, far = _opening(azimuth, options), float(edges[0]), float(edges[-1])
    if options.width is None:
        pixel = _pixel(opening, near, far, polar.shape)
    else:
        pixel = 2 * far * math.sin(min(opening, math.pi) / 2) / options.width
    geometry, shape = fan_around(opening, near, far, pixel)
    _check_size(*shape, " of the frame: give a larger --width")
    picture, seen = polar_to_fan(polar.image, azimuth, edges, geometry, shape, polar.mask)
    if not seen.any():
        raise SonarjaxError(
            f"{polar.source}: {_told(math.degrees(opening), near, far)}: expected a fan that shows its beams"
        )
    write_png(out, np.where(seen, np.maximum(picture, DARKEST), 0.0))
    _note_mask(polar)
    size = f"{shape[0]} x {shape[1]} pixels"
    return f"{out}: {size}, {_told(math.degrees(opening), near, far)}, {seen.mean():.1%} of the pixels measured"


def _note_mask(polar: Frame) -> None:
    """Tell what becomes of the mask, because the picture cannot."""
    if polar.mask is not None and not polar.mask.all():
        lost = f"{np.count_nonzero(~polar.mask)} of {polar.mask.size} pixels were not measured"
        complain(
            f"{polar.source}: mask: {lost}: a fan picture holds no mask, so they are black and come back as measured; "
            "to convert it back, give --frame, or its ranges may change",
            kind="note: ",
        )


def _pixel(opening: float, near: float, far: float, shape: tuple[int, int]) -> float:
    """Length of a fan picture's pixel [m]: as `FINE` wants it, longer in a large picture, but not longer than cells."""
    depth, width = (far - near) / shape[0], opening / shape[1]
    geometry, (rows, columns) = fan_around(opening, near, far, far)
    area = rows * geometry.row_m * columns * geometry.column_m
    fine = max(min(depth, nearest_range(near, far) * width) / FINE, math.sqrt(area / LARGE))
    return min(fine, depth, (far + near) / 2 * width)


def _check_size(rows: float | int, columns: float | int, hint: str = "") -> None:
    if min(rows, columns) < SMALLEST:
        least = f"{SMALLEST} x {SMALLEST} pixels"
        raise SonarjaxError(f"fan: picture: expected a fan of at least {least}, got {rows:g} x {columns:g}{hint}")


def _check_pixels(geometry: FanGeometry) -> None:
    high, wide = geometry.row_m, geometry.column_m
    if not 1 / SQUEEZED <= high / wide <= SQUEEZED:
        sector = _told(math.degrees(geometry.opening), geometry.range_min, geometry.range_max)
        raise SonarjaxError(
            f"fan: opening, range and apex: expected those of the fan in the picture, got {sector}: a pixel would be "
            f"{high:.4g} m high and {wide:.4g} m wide"
        )


def _axes(polar: Frame, options: FanOptions, axes: PolarAxes | None) -> tuple[np.ndarray, np.ndarray]:
    """Beam centres [rad] and range edges [m], from the file or else from `axes` or the options."""
    held, (bins, beams) = polar.geometry or {}, polar.shape
    in_file = {"azimuth_deg", "range_min_m", "range_max_m"} <= set(held)
    if axes is not None:
        return _axes_of_sonar(polar, options, axes, in_file)
    if not in_file:
        opening_deg, near, far = _sector(options, "a frame without azimuth_deg and range_edges_m")
        return even_beams(beams, math.radians(opening_deg)), np.linspace(near, far, bins + 1)
    for name in _told_by_beams(beams):
        if _given(options, name):
            raise SonarjaxError(f"{_option(name)}: cannot be used: the file itself holds this value")
    edges = np.linspace(held["range_min_m"], held["range_max_m"], bins + 1)
    return np.radians(held["azimuth_deg"]), edges


def _axes_of_sonar(polar: Frame, options: FanOptions, axes: PolarAxes, in_file: bool) -> tuple[np.ndarray, np.ndarray]:
    """As `_axes`, from `axes`, unless the file has its own (`in_file`) or an option says something else."""
    if in_file:
        raise SonarjaxError("--sonar: cannot be used: the file itself holds beams and ranges")
    for name in _told_by_beams(axes.azimuth.size):
        if _given(options, name):
            raise SonarjaxError(f"{_option(name)}: cannot be used with --sonar, which holds this value")
    if polar.shape != axes.shape:
        raise SonarjaxError(f"--sonar: expected a frame of shape {axes.shape} (range, beam), got {polar.shape}")
    return axes.azimuth, axes.range_edges


def _told_by_beams(beams: int) -> tuple[str, ...]:
    """Options of the sector that axes with so many beams make superfluous."""
    return SECTOR if beams > 1 else SECTOR[1:]


def _opening(azimuth: np.ndarray, options: FanOptions) -> float:
    """Full angle [rad] of a fan about the middle beam that holds all beams, the outer ones as wide as their spacing."""
    if options.opening_deg is not None:
        return math.radians(options.opening_deg)
    if azimuth.size == 1:
        raise SonarjaxError("--opening-deg: required for a frame of one beam, which does not tell the opening")
    return 2 * max(map(abs, _outer_edges(azimuth)))


def _outer_edges(azimuth: np.ndarray) -> tuple[float, float]:
    """Starboard and port edge [rad] of two or more beams, the outer ones as wide as their spacing."""
    starboard, port = 1.5 * azimuth[[0, -1]] - 0.5 * azimuth[[1, -2]]
    return float(starboard), float(port)


def _sector(options: FanOptions, what: str) -> tuple[float, float, float]:
    """Opening [deg], nearest and farthest range [m]; `what`, for the message, needs all three."""
    values = [getattr(options, name) for name in SECTOR]
    if None in values:
        raise SonarjaxError(f"{_option(SECTOR[values.index(None)])}: required for {what}")
    return values[0], values[1], values[2]


def _given(options: FanOptions, name: str) -> bool:
    """Whether an option was set; 0 is a value like any other."""
    value = getattr(options, name)
    return value is not None and value is not False


def _option(field: str) -> str:
    return "--" + field.replace("_", "-")


def _told(opening_deg: float, near: float, far: float) -> str:
    return f"opening {opening_deg:.4g} deg, range {near:.4g} to {far:.4g} m"
