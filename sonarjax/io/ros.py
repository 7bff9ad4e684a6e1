"""Bags of ROS 1 (`.bag`) and ROS 2 (`.mcap`, `.db3`, a bag's folder), read and written without ROS by `rosbags`.

Frames come from topics with `marine_acoustic_msgs/ProjectedSonarImage`. A message is unpacked only when it is reached,
so a long log takes no more memory than a short one.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sonarjax.io.bag_messages import Lost, bag_messages
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import reason
from sonarjax.io.frame import Frame
from sonarjax.io.given import check_kind, is_number, shown
from sonarjax.io.header import TIME_LIMIT_NS
from sonarjax.io.recording import Record
from sonarjax.io.ros_messages import DEFINITIONS, MESSAGE, PACKAGE, frame_fields, is_sonar_image, message_frame

BAGS = (".bag", ".mcap", ".db3")
"""Endings of bags that are a single file."""
TOPIC = "/sonar_image"
"""Topic to which frames are written."""
STEP_NS = 100_000_000
"""Time between written frames without a time of their own, a tenth of a second [ns]."""


def is_bag(path: str) -> bool:
    """True if a path has the ending of a bag, or is a folder with the metadata of a ROS 2 bag."""
    return os.path.splitext(path)[1].lower() in BAGS or os.path.isfile(os.path.join(path, "metadata.yaml"))


def bag_topics(path: str) -> dict[str, int]:
    """Count the sonar images of a bag by topic.

    Args:
        path: The bag.

    Returns:
        Topic with sonar images -> number of its messages.

    Raises:
        SonarjaxError: The file is missing or not a bag, or `rosbags` is not installed.
    """
    with _opened(path) as reader:
        return _counts(reader)


def bag_records(path: str, topic: str | None = None, index: int | None = None) -> Iterator[Record]:
    """Yield the sonar images of a bag in order of time, or only image `index`; an unreadable image as its error.

    Without `topic`, the bag must have exactly one topic of sonar images. If the bag is damaged inside, an error is
    yielded for each image that is lost, or one for all after the damage (see `bag_messages`). An image is missing only
    if the bag ends before it, because the number that the bag states may be wrong.

    Raises:
        SonarjaxError: The file is missing or not a bag, `rosbags` is not installed, or the topic or image does not
            exist, or the topic is empty.
    """
    with _opened(path) as reader:
        counts = _counts(reader)
        chosen = _chosen(path, counts, topic)
        held = 0
        wanted = [c for c in reader.connections if c.topic == chosen and is_sonar_image(c.msgtype)]
        for found in bag_messages(reader, wanted):
            held = found.number + 1
            gone = isinstance(found, Lost) and found.last
            if index is not None and found.number != index and not gone:
                continue
            if isinstance(found, Lost):
                told = "the bag cannot be read from here on" if gone else "the bag is damaged here"
                yield SonarjaxError(f"{path}:{chosen}:{found.number}: {told}: {reason(found.error)}")
            else:
                yield _record(reader, path, found.connection, found.raw, found.number, counts[chosen])
            if index is not None:
                return
        if held == 0:
            raise SonarjaxError(f"{path}:{chosen}: expected sonar images, the topic has none")
        if index is not None:
            raise SonarjaxError(f"{path}:{chosen}: frame {index}: expected 0 to {held - 1}, the bag holds only {held}")


def write_bag(path: str | os.PathLike[str], frames: Iterable[Frame], topic: str = TOPIC) -> int:
    """Write frames as the sonar images of a ROS bag.

    Values are rounded to 16 bits. A frame's time is `time_ns` [ns] of its `meta`, or else `time_s` [s], both since
    1970. A frame without either comes 0.1 s after the latest before it; the first such frame of all has the time 0.

    Args:
        path: A file ending in .bag (ROS 1) or .mcap (ROS 2), or the new folder of a ROS 2 bag. If it is a link, the bag
            that it points to is written, and the link is kept.
        frames: Frames (range, beam), with their geometry.
        topic: Topic to which they are written.

    Returns:
        The number of frames.

    Raises:
        SonarjaxError: The folder exists, the path cannot be written or ends in .db3, `rosbags` is not installed, a
            frame's geometry is not known or does not fit its image, its time cannot be expressed, a frame has pixels
            that were not measured or are outside [0, 1], or the topic has no name. Then nothing is left behind, and
            what was there before is kept.
    """
    name, target = os.fspath(path), Path(os.path.realpath(path))  # write what a link points to, and keep the link
    ending = os.path.splitext(name)[1].lower()
    if ending == ".db3":
        raise SonarjaxError(f"{name}: expected a name that ends in .bag or .mcap, or that of a new folder")
    if not isinstance(frames, Iterable):
        raise SonarjaxError(f"frames: expected frames one after another, such as a list, got {shown(frames)}")
    if not isinstance(topic, str) or not topic.strip("/ "):
        raise SonarjaxError(f"topic: expected a name such as {TOPIC!r}, got {shown(topic)}")
    if ending not in (".bag", ".mcap") and target.exists():
        raise SonarjaxError(f"{name}: expected a folder that does not exist yet")
    if not target.parent.is_dir():
        raise SonarjaxError(f"{name}: cannot be written: no such folder {os.path.dirname(name)}")
    aside = target.with_name(f".sonarjax-{secrets.token_hex(6)}.tmp")
    partial = aside / target.name  # the file inside a ROS 2 bag's folder is named after the folder
    try:
        aside.mkdir()
        count = _write(partial, frames, topic, ending == ".bag")
        os.replace(next(partial.glob("*.mcap")) if ending == ".mcap" else partial, target)
    except OSError as error:
        raise SonarjaxError(f"{name}: cannot be written: {reason(error)}") from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return count


def _write(path: Path, frames: Iterable[Frame], topic: str, ros1: bool) -> int:
    writer, store = _writer(path, ros1)
    msgtype, count, latest = f"{PACKAGE}/msg/{MESSAGE}", 0, -STEP_NS
    with writer:
        connection = writer.add_connection(topic, msgtype, typestore=store)
        serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        for frame in frames:
            check_kind(frame, Frame, f"frames[{count}]")
            stated = _stated_ns(frame)
            time_ns = latest + STEP_NS if stated is None else stated
            latest = max(latest, time_ns)
            writer.write(connection, time_ns, serialize(_message(store, frame, time_ns, count, ros1), msgtype))
            count += 1
    return count


def _stated_ns(frame: Frame) -> int | None:
    """The time of a frame [ns]; None if it has none. Raises SonarjaxError for one that a message cannot express."""
    for key, unit in (("time_ns", 1), ("time_s", 10**9)):
        value = frame.meta.get(key)
        if value is None:
            continue
        if not is_number(value) or not 0 <= float(value) * unit < TIME_LIMIT_NS:
            expected = f"expected a number from 0 to {TIME_LIMIT_NS / unit:g}"
            raise SonarjaxError(f"{frame.source}: {key}: {expected}, got {shown(value)}")
        return int(value) if unit == 1 else round(float(value) * unit)
    return None


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """rosbags' reader of a bag; its many kinds of failure become one error that names the file."""
    if not os.path.exists(path):
        raise SonarjaxError(f"{path}: no such file")
    rosbags = _rosbags()
    try:
        reader = rosbags.highlevel.AnyReader([Path(path)], default_typestore=_typestore(False))
        reader.open()
    except Exception as error:  # on a damaged file rosbags raises whatever its parts raise
        raise SonarjaxError(f"{path}: cannot be read as a bag: {reason(error)}") from error
    try:
        yield reader
    finally:
        reader.close()


def _record(reader: Any, path: str, connection: Any, raw: Any, number: int, count: int) -> Record:
    source = f"{path}:{connection.topic}:{number}"
    stem = f"{Path(path).stem}{connection.topic.replace('/', '_')}_{number}"
    try:
        message = reader.deserialize(raw, connection.msgtype)
        frame = message_frame(message, source, stem, number)
    except SonarjaxError as error:
        return error
    except Exception as error:  # on a damaged message rosbags raises whatever its parts raise
        return SonarjaxError(f"{source}: expected a {MESSAGE}: {reason(error)}")
    frame.meta.update(topic=connection.topic, n_frames=count)
    return frame


def _counts(reader: Any) -> dict[str, int]:
    counts: dict[str, int] = {}
    for connection in reader.connections:
        if is_sonar_image(connection.msgtype):
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
    return counts


def _chosen(path: str, counts: dict[str, int], topic: str | None) -> str:
    if topic in counts:
        return topic
    there = ", ".join(sorted(counts)) or "none"
    if topic is not None or len(counts) != 1:
        asked = "one topic of sonar images" if topic is None else f"a topic of sonar images, not {topic!r}"
        raise SonarjaxError(f"{path}: topic: expected {asked}; the bag has {there} (write {path}:TOPIC)")
    return next(iter(counts))


def _rosbags() -> SimpleNamespace:
    """The parts of rosbags, an optional dependency. Raises SonarjaxError if it is not installed."""
    try:
        from rosbags import highlevel, rosbag1, rosbag2, typesys
    except ImportError as error:
        raise SonarjaxError("rosbags: bags need this package: pip install 'sonarjax[ros]'") from error
    return SimpleNamespace(highlevel=highlevel, rosbag1=rosbag1, rosbag2=rosbag2, typesys=typesys)


def _typestore(ros1: bool) -> Any:
    """rosbags' types, with the sonar's messages added under both of their names."""
    typesys = _rosbags().typesys
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE)
    for package in (PACKAGE, PACKAGE.removeprefix("marine_")):
        for name, text in DEFINITIONS.items():
            store.register(typesys.get_types_from_msg(text, f"{package}/msg/{name}"))
    return store


def _writer(path: Path, ros1: bool) -> tuple[Any, Any]:
    store = _typestore(ros1)
    if ros1:
        return _rosbags().rosbag1.Writer(path), store
    rosbag2 = _rosbags().rosbag2
    return rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP), store


def _message(store: Any, frame: Frame, time_ns: int, number: int, ros1: bool) -> Any:
    fields, types = frame_fields(frame, time_ns), store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    header = {"stamp": stamp, "frame_id": str(frame.meta.get("frame_id", "sonar"))}
    if ros1:
        header["seq"] = number
    empty = fields.ranges[:0]
    return types[f"{PACKAGE}/msg/{MESSAGE}"](
        header=types["std_msgs/msg/Header"](**header),
        ping_info=types[f"{PACKAGE}/msg/PingInfo"](
            frequency=fields.frequency, sound_speed=fields.sound_speed, tx_beamwidths=empty, rx_beamwidths=empty
        ),
        beam_directions=[types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z) for x, y, z in fields.directions.tolist()],
        ranges=fields.ranges,
        image=types[f"{PACKAGE}/msg/SonarImageData"](
            is_bigendian=False, dtype=fields.dtype, beam_count=fields.beam_count, data=fields.data
        ),
    )
