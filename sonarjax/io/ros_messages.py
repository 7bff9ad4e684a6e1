"""`marine_acoustic_msgs/ProjectedSonarImage`: a ROS message to a frame, and a frame to a message. No bag is opened
here.

Conventions from the message's own comments: Z points along the middle of the fan and X up, so Y points to starboard;
beams lie in the Y-Z plane; `ranges` are the centres of the range bins. The message's comment calls the order of pixels
beam-major, but drivers and viewers store them range by range, beam after beam, and so does this file. It was not
checked on a bag from a real sonar.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float32

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.frame import UNEVEN, Frame, Geometry, evenly_spaced
from sonarjax.io.header import RANGE_LIMIT_M
from sonarjax.io.naming import named

MESSAGE = "ProjectedSonarImage"
PACKAGE = "marine_acoustic_msgs"
DEFINITIONS = {
    "PingInfo": "float32 frequency\nfloat32 sound_speed\nfloat32[] tx_beamwidths\nfloat32[] rx_beamwidths\n",
    "SonarImageData": "bool is_bigendian\n"
    + "".join(
        f"uint32 DTYPE_{name} = {number}\n"
        for number, name in enumerate(
            ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "UINT64", "INT64", "FLOAT32", "FLOAT64")
        )
    )
    + "uint32 dtype\nuint32 beam_count\nuint8[] data\n",
    MESSAGE: "std_msgs/Header header\nPingInfo ping_info\ngeometry_msgs/Vector3[] beam_directions\n"
    "float32[] ranges\nSonarImageData image\n",
}
"""Fields of the messages, for bags that do not carry their definitions and for bags that are written."""
DTYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
"""NumPy's name for each `dtype` number."""
OUT_OF_PLANE = math.radians(0.5)
"""Largest elevation at which a beam still counts as lying in the plane of the fan [rad]."""
WRITTEN = 65535
"""Frames are written as 16-bit numbers, with this value for 1."""


def is_sonar_image(msgtype: str) -> bool:
    """True if a message type is a projected sonar image, of this package or of its older name `acoustic_msgs`."""
    package, *_, message = msgtype.split("/")
    return message == MESSAGE and package.removeprefix("marine_") == "acoustic_msgs"


def message_frame(message: Any, name: str, stem: str, number: int) -> Frame:
    """Turn a message into a frame (range, beam).

    Unsigned integers are divided by their largest value. Signed integers must not be negative. Floating point must lie
    in [0, 1]. Beams are put in ascending azimuth (to port).

    Args:
        message: The message.
        name: Its source, for errors.
        stem: Stem for output files.
        number: Number of the frame.

    Raises:
        SonarjaxError: Sizes do not agree, beams leave the plane of the fan, ranges are uneven, the type does not exist,
            or values are out of range.
    """
    azimuth = _azimuth(name, message.beam_directions)
    near, far = _window(name, np.asarray(message.ranges, np.float64))
    image = _pixels(name, message.image, len(message.ranges), len(azimuth))
    order = np.argsort(azimuth)
    if np.any(np.diff(azimuth[order]) <= 0):
        raise SonarjaxError(f"{name}: beam_directions: expected a different azimuth for each beam")
    geometry: Geometry = {
        "azimuth_deg": np.degrees(azimuth[order]).round(6).tolist(),
        "range_min_m": near,
        "range_max_m": far,
        "n_ranges": image.shape[0],
    }
    info = message.ping_info
    for key, value, low, high in (
        ("sound_speed_m_s", info.sound_speed, 1000.0, 2000.0),
        ("frequency_hz", info.frequency, 1e4, 1e8),
    ):
        if math.isfinite(value) and low <= value <= high:  # a message has 0 if it is not known
            geometry[key] = float(value)
    stamp = message.header.stamp
    meta = {
        "format": f"{PACKAGE}/{MESSAGE}",
        "stored_scale": np.dtype(DTYPES[message.image.dtype]).name,
        "frame_id": message.header.frame_id,
        "time_s": stamp.sec + 1e-9 * stamp.nanosec,
        "time_ns": stamp.sec * 10**9 + stamp.nanosec,
    }
    frame = named(np.ascontiguousarray(image[:, order]), name, number, 1, geometry, meta)
    return Frame(frame.image, None, name, stem, geometry, meta | {"frame_index": number})


def frame_fields(frame: Frame, time_ns: int) -> SimpleNamespace:
    """The fields of a message for a frame (range, beam), as plain values from which any message class can be filled.

    Raises:
        SonarjaxError: The frame's geometry is not known or does not fit the image; a pixel was not measured, which a
            message cannot express, or is outside [0, 1]; or the range bins are fewer than two or could not be read back
            otherwise.
    """
    geometry = frame.geometry or {}
    for key in ("azimuth_deg", "range_min_m", "range_max_m"):
        if key not in geometry:
            raise SonarjaxError(f"{frame.source}: {key}: expected the sonar's geometry, which the frame does not hold")
    if frame.mask is not None and not frame.mask.all():
        raise SonarjaxError(f"{frame.source}: mask: expected a frame without unmeasured pixels")
    if not ((frame.image >= 0) & (frame.image <= 1)).all():  # also for NaN
        raise SonarjaxError(f"{frame.source}: image: expected values from 0 to 1")
    azimuth = np.radians(np.asarray(geometry["azimuth_deg"], np.float64))
    n_ranges, n_beams = frame.shape
    if azimuth.shape != (n_beams,):
        raise SonarjaxError(
            f"{frame.source}: azimuth_deg: expected {n_beams} numbers to fit the image, got {azimuth.size}"
        )
    step = (geometry["range_max_m"] - geometry["range_min_m"]) / n_ranges
    ranges = (geometry["range_min_m"] + step * (np.arange(n_ranges) + 0.5)).astype(np.float32)
    _window(frame.source, ranges.astype(np.float64))  # what could not be read back is not written
    return SimpleNamespace(
        time_ns=time_ns,
        frequency=float(geometry.get("frequency_hz", 0.0)),
        sound_speed=float(geometry.get("sound_speed_m_s", 0.0)),
        directions=np.stack([np.zeros(n_beams), -np.sin(azimuth), np.cos(azimuth)], axis=1),
        ranges=ranges,
        dtype=DTYPES.index("u2"),
        beam_count=n_beams,
        data=np.frombuffer(np.rint(frame.image * WRITTEN).astype("<u2").tobytes(), np.uint8),
    )


def _azimuth(name: str, directions: Any) -> np.ndarray:
    """Azimuths (beam,) [rad] of the directions, positive to port."""
    vectors = np.array([(v.x, v.y, v.z) for v in directions], np.float64).reshape(-1, 3)
    if not len(vectors):
        raise SonarjaxError(f"{name}: beam_directions: expected at least one beam")
    if not np.isfinite(vectors).all() or (np.linalg.norm(vectors, axis=1) < 1e-6).any():
        raise SonarjaxError(f"{name}: beam_directions: expected finite directions of non-zero length")
    x, y, z = vectors.T
    if np.abs(np.arctan2(x, np.hypot(y, z))).max() > OUT_OF_PLANE:
        raise SonarjaxError(f"{name}: beam_directions: expected beams in the Y-Z plane (X up), got one that leaves it")
    return np.arctan2(-y, z)


def _window(name: str, ranges: np.ndarray) -> tuple[float, float]:
    """Near and far edge [m] of range bins with these centres (range,)."""
    if len(ranges) < 2 or not np.isfinite(ranges).all() or ranges[-1] <= ranges[0] or abs(ranges[-1]) > RANGE_LIMIT_M:
        raise SonarjaxError(f"{name}: ranges: expected two or more ascending ranges of at most {RANGE_LIMIT_M:g} m")
    step = (ranges[-1] - ranges[0]) / (len(ranges) - 1)
    if not evenly_spaced(ranges):
        raise SonarjaxError(f"{name}: ranges: expected range bins of equal length")
    near = float(ranges[0] - step / 2)
    return max(near, 0.0) if near > -UNEVEN * step else _negative(name, near), float(ranges[-1] + step / 2)


def _negative(name: str, near: float) -> float:
    raise SonarjaxError(f"{name}: ranges: expected ranges of 0 m or more, got a bin that starts at {near:g} m")


def _pixels(name: str, image: Any, n_ranges: int, n_beams: int) -> Float32[np.ndarray, "range beam"]:
    if not 0 <= image.dtype < len(DTYPES):
        raise SonarjaxError(f"{name}: image.dtype: expected 0 to {len(DTYPES) - 1}, got {image.dtype}")
    if image.beam_count != n_beams:
        raise SonarjaxError(f"{name}: image.beam_count: expected {n_beams}, one per direction, got {image.beam_count}")
    stored = np.dtype((">" if image.is_bigendian else "<") + DTYPES[image.dtype])
    data = np.asarray(image.data, np.uint8)
    if data.size != n_ranges * n_beams * stored.itemsize:
        wanted = f"{n_ranges * n_beams * stored.itemsize} bytes for {n_ranges} x {n_beams} of {stored.name}"
        raise SonarjaxError(f"{name}: image.data: expected {wanted}, got {data.size}")
    values = data.view(stored).reshape(n_ranges, n_beams).astype(np.float64)
    if stored.kind != "f":
        values /= np.iinfo(stored).max
    if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0):
        raise SonarjaxError(f"{name}: image.data: expected finite values of 0 or more, at most 1 if floating point")
    return values.astype(np.float32)
