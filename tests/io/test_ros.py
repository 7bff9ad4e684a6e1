"""Bags of ROS: those that rosbags wrote are read as the message's comments say, and what is written comes back."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sonarjax.io import Frame, SonarjaxError, bag_topics, describe, iter_records, read_frames, write_bag
from sonarjax.io.bag_messages import _after_chunk

TEXTS = {
    "PingInfo": "float32 frequency\nfloat32 sound_speed\nfloat32[] tx_beamwidths\nfloat32[] rx_beamwidths",
    "SonarImageData": "bool is_bigendian\nuint32 dtype\nuint32 beam_count\nuint8[] data",
    "ProjectedSonarImage": "std_msgs/Header header\nPingInfo ping_info\ngeometry_msgs/Vector3[] beam_directions\n"
    "float32[] ranges\nSonarImageData image",
}
TYPE = "marine_acoustic_msgs/msg/ProjectedSonarImage"
STARBOARD_FIRST = np.radians([20.0, 5.0, -15.0])
"""Angles of the test's three beams, to starboard (towards Y) [rad]."""
RANGES = np.array([1.05, 1.15, 1.25, 1.35], np.float32)


def store(ros1: bool):
    made = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in TEXTS.items():
        made.register(get_types_from_msg(text, f"marine_acoustic_msgs/msg/{name}"))
    return made


def pixels(number: int) -> np.ndarray:
    return (np.arange(12).reshape(4, 3) * 20 + number).astype(np.uint8)


def message(made, number: int, ros1: bool, **changed):
    types = made.types
    header = {"stamp": types["builtin_interfaces/msg/Time"](sec=5 + number, nanosec=250_000_000), "frame_id": "sonar"}
    directions = changed.get("directions", [(0.0, math.sin(a), math.cos(a)) for a in STARBOARD_FIRST])
    data = np.asarray(changed.get("data", pixels(number)))
    return types[TYPE](
        header=types["std_msgs/msg/Header"](**header, **({"seq": number} if ros1 else {})),
        ping_info=types["marine_acoustic_msgs/msg/PingInfo"](
            frequency=1.2e6, sound_speed=1490.0, tx_beamwidths=RANGES[:0], rx_beamwidths=RANGES[:0]
        ),
        beam_directions=[types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z) for x, y, z in directions],
        ranges=np.asarray(changed.get("ranges", RANGES), np.float32),
        image=types["marine_acoustic_msgs/msg/SonarImageData"](
            is_bigendian=changed.get("big", False), dtype=changed.get("dtype", 0), beam_count=changed.get("beams", 3),
            data=np.frombuffer(data.tobytes(), np.uint8),
        ),
    )  # fmt: skip


def bag(path: Path, messages: list[dict], topics: tuple[str, ...] = ("/sonar",)) -> str:
    """A bag with these messages under each topic; a message {"raw": bytes} is written as it is."""
    ros1 = path.suffix == ".bag"
    made = store(ros1)
    plugin = StoragePlugin.SQLITE3 if path.name.startswith("db3") else StoragePlugin.MCAP
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, TYPE, typestore=made)
            pack = made.serialize_ros1 if ros1 else made.serialize_cdr
            for number, changed in enumerate(messages):
                raw = changed.get("raw") or pack(message(made, number, ros1, **changed), TYPE)
                writer.write(connection, number * 10**8, raw)
    return str(path)


@pytest.mark.parametrize("name", ["a.bag", "mcap", "db3"])
def test_frames_of_a_bag(tmp_path, name):
    path = bag(tmp_path / name, [{}, {}, {}])
    frames = read_frames(path)
    assert [frame.source for frame in frames] == [f"{path}:/sonar:{number}" for number in range(3)]
    for number, frame in enumerate(frames):
        # Y is starboard and azimuth grows to port: the stored order, starboard first, is already ascending.
        np.testing.assert_allclose(frame.image * 255, pixels(number), atol=1e-4)
        np.testing.assert_allclose(frame.geometry["azimuth_deg"], [-20.0, -5.0, 15.0])
        assert frame.geometry["range_min_m"] == pytest.approx(1.0) and frame.geometry["range_max_m"] == pytest.approx(
            1.4
        )
        assert frame.geometry["n_ranges"] == 4 and frame.meta["time_s"] == 5.25 + number
        assert frame.geometry["sound_speed_m_s"] == 1490.0 and frame.geometry["frequency_hz"] == pytest.approx(1.2e6)
    assert (
        read_frames(f"{path}:/sonar:1")[0].meta["frame_index"] == read_frames(f"{path}:1")[0].meta["frame_index"] == 1
    )
    assert bag_topics(path) == {"/sonar": 3} and "3 beams" in describe(path)


def test_a_single_mcap_file_and_stems(tmp_path):
    folder = bag(tmp_path / "run", [{}, {}], topics=("/left/sonar",))
    (file,) = Path(folder).glob("*.mcap")
    frames = read_frames(str(file))
    assert [frame.stem for frame in frames] == [f"{file.stem}_left_sonar_{number}" for number in range(2)]


def test_beams_from_port_to_starboard_are_turned_round(tmp_path):
    directions = [(0.0, math.sin(a), math.cos(a)) for a in STARBOARD_FIRST[::-1]]
    (frame,) = read_frames(bag(tmp_path / "a.bag", [{"directions": directions}]))
    np.testing.assert_allclose(frame.image * 255, pixels(0)[:, ::-1], atol=1e-4)
    assert frame.geometry["azimuth_deg"] == sorted(frame.geometry["azimuth_deg"])


@pytest.mark.parametrize(
    ("dtype", "number", "big", "scale"),
    [(">u2", 2, True, 65535), ("<u4", 4, False, 2**32 - 1), ("<i2", 3, False, 32767), ("<f4", 8, False, 1.0)],
)
def test_other_types_of_pixels(tmp_path, dtype, number, big, scale):
    values = np.linspace(0, scale, 12).reshape(4, 3).astype(dtype)
    (frame,) = read_frames(bag(tmp_path / "a.bag", [{"data": values, "dtype": number, "big": big}]))
    np.testing.assert_allclose(frame.image, np.linspace(0, 1, 12).reshape(4, 3), atol=1e-4)


BAD = [
    ({"directions": []}, "beam_directions: expected at least one beam"),
    ({"directions": [(0.3, 0.1, 1.0)] * 3}, "beam_directions: expected beams in the Y-Z plane"),
    ({"directions": [(0.0, 0.0, 0.0)] * 3}, "beam_directions: expected finite directions"),
    ({"directions": [(0.0, 0.1, 1.0)] * 3}, "beam_directions: expected a different azimuth"),
    ({"ranges": [1.0, 1.1, 1.3, 1.4]}, "ranges: expected range bins of equal length"),
    ({"ranges": [4.0, 3.0, 2.0, 1.0]}, "ranges: expected two or more ascending ranges"),
    ({"ranges": [-0.5, 0.5, 1.5, 2.5]}, "ranges: expected ranges of 0 m or more"),
    ({"ranges": [1.0]}, "ranges: expected two or more ascending ranges"),
    ({"dtype": 10}, "image.dtype: expected 0 to 9, got 10"),
    ({"beams": 4}, "image.beam_count: expected 3, one per direction, got 4"),
    ({"data": np.zeros(11, np.uint8)}, "image.data: expected 12 bytes for 4 x 3 of uint8, got 11"),
    ({"data": np.full(12, -1, np.int8), "dtype": 1}, "image.data: expected finite values"),
    ({"data": np.full(12, np.nan, "f4"), "dtype": 8}, "image.data: expected finite values"),
    ({"data": np.full(12, 1.5, "f4"), "dtype": 8}, "image.data: expected finite values"),
    ({"raw": b"\x00\x01\x02"}, "expected a ProjectedSonarImage"),
]


def test_a_bad_message_is_one_clear_error_and_costs_no_other(tmp_path):
    path = bag(tmp_path / "a.bag", [{}, *[changed for changed, _ in BAD], {}])
    first, *errors, last = iter_records(path)
    assert isinstance(first, Frame) and isinstance(last, Frame)
    for number, (error, (_, said)) in enumerate(zip(errors, BAD, strict=True), start=1):
        assert isinstance(error, SonarjaxError), BAD[number - 1]
        assert str(error).startswith(f"{path}:/sonar:{number}: {said}") and "\n" not in str(error)


def test_what_cannot_be_found(tmp_path):
    path = bag(tmp_path / "a.bag", [{}], topics=("/port", "/starboard"))
    for spec, said in [
        (path, f"{path}: topic: expected one topic of sonar images; the bag has /port, /starboard"),
        (f"{path}:/other", f"{path}: topic: expected a topic of sonar images, not '/other'; the bag has /port"),
        (f"{path}:other:0", f"{path}: topic: expected a topic of sonar images, not 'other'; the bag has /port"),
        (f"{path}:/port:1", f"{path}:/port: frame 1: expected 0 to 0, the bag holds only 1"),
        (f"{path}:/port:-1", f"{path}:/port: frame -1: expected 0 to 0"),
        (str(tmp_path / "none.mcap"), f"{tmp_path / 'none.mcap'}: no such file"),
    ]:
        with pytest.raises(SonarjaxError) as caught:
            read_frames(spec)
        assert str(caught.value).startswith(said)
    assert len(read_frames(f"{path}:/starboard")) == 1


def test_the_size_of_a_folder_is_that_of_its_files(tmp_path):
    write_bag(tmp_path / "run", [flat()])
    size = sum(file.stat().st_size for file in (tmp_path / "run").iterdir())
    assert f" {size} bytes\n" in describe(tmp_path / "run")


@pytest.mark.parametrize("name", ["ts.mcap", "ts"])
def test_a_topic_without_a_slash_can_be_named(tmp_path, name):
    path = tmp_path / name
    write_bag(path, [flat(), flat()], "image")
    assert len(read_frames(f"{path}:image")) == 2
    (frame,) = read_frames(f"{path}:image:1")
    assert frame.source == f"{path}:image:1"


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "run"])
def test_a_topic_without_images(tmp_path, name):
    path = str(tmp_path / name)
    assert write_bag(path, []) == 0
    with pytest.raises(SonarjaxError, match=f"{path}:/sonar_image: expected sonar images, the topic has none"):
        read_frames(path)


@pytest.mark.parametrize("name", ["run", "a.mcap"])
@pytest.mark.parametrize("stated", [0, 2, 8])
def test_a_bag_that_states_a_wrong_number_of_images(tmp_path, name, stated):
    path = tmp_path / name
    write_bag(path, [flat()] * 5)
    file, form = (path / "metadata.yaml", "message_count: %d") if path.is_dir() else (path, "\n\0\0\0\1\0%c" + "\0" * 7)
    content = file.read_bytes()
    file.write_bytes(content.replace((form % 5).encode(), (form % stated).encode()))
    assert file.read_bytes() != content and bag_topics(str(path)) == {"/sonar_image": stated}
    assert len(read_frames(path)) == 5 and read_frames(f"{path}:4")[0].source == f"{path}:/sonar_image:4"
    for index in (5, 6):
        said = f"{path}:/sonar_image: frame {index}: expected 0 to 4, the bag holds only 5"
        for read in (read_frames, describe):
            with pytest.raises(SonarjaxError, match=said):
                read(f"{path}:{index}")


@pytest.mark.parametrize("ending", [".bag", ".mcap", ".db3"])
def test_what_is_no_bag(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    for content in (b"", b"nothing of the kind" * 50):
        path.write_bytes(content)
        with pytest.raises(SonarjaxError) as caught:
            read_frames(str(path))
        assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.bag", "run"])
def test_a_damaged_bag_never_ends_in_a_foreign_error(tmp_path, name):
    path = Path(bag(tmp_path / name, [{}] * 4))
    file = path if path.is_file() else next(path.glob("*.mcap"))
    whole = file.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(whole[: rng.integers(1, len(whole))] if rng.random() < 0.3 else whole)
        for at in rng.integers(0, len(content), 5):
            content[at] = rng.integers(256)
        file.write_bytes(content)
        try:
            records = list(iter_records(str(path)))
        except SonarjaxError as error:
            records = [error]
        assert all("\n" not in str(record) for record in records if isinstance(record, SonarjaxError))


def in_chunks(path: Path, count: int) -> str:
    """A bag of several chunks, of frames that are as large as a sonar's."""
    directions = [(0.0, math.sin(a), math.cos(a)) for a in np.linspace(0.3, -0.3, 200)]
    ranges, image = np.arange(1000, dtype=np.float32) * 0.01 + 1, np.zeros((1000, 200), np.uint8)
    changed = {"directions": directions, "ranges": ranges, "beams": 200}
    return bag(path, [changed | {"data": image + number} for number in range(count)])


def outcome(path: str) -> tuple[list[int], list[str]]:
    """The number of each frame that is read, as its pixels have it, and the errors."""
    read, errors = [], []
    for record in iter_records(path):
        if isinstance(record, SonarjaxError):
            errors.append(str(record))
        else:
            assert record.source.endswith(f":{round(record.image[0, 0] * 255)}")
            read.append(round(record.image[0, 0] * 255))
    return read, errors


def damage(path: str, numbers: tuple[int, ...]) -> None:
    """Write another kind of record into the headers of these messages of a ROS 1 bag."""
    content = bytearray(Path(path).read_bytes())
    kinds = [found.end() - 1 for found in re.finditer(b"op=\x02", content)]
    for number in numbers:
        content[kinds[number]] = 99
    Path(path).write_bytes(content)


def test_a_damaged_record_of_a_ros_1_bag_costs_that_record(tmp_path):
    path = in_chunks(tmp_path / "a.bag", 12)
    damage(path, (0, 4, 5, 11))
    read, errors = outcome(path)
    assert read == [1, 2, 3, 6, 7, 8, 9, 10]
    said = [error.partition(" here")[0] for error in errors]
    assert said == [f"{path}:/sonar:{k}: the bag is damaged" for k in (0, 4, 5, 11)]
    assert outcome(f"{path}:/sonar:9") == ([9], [])
    assert outcome(f"{path}:/sonar:4") == ([], [errors[1]])


def test_messages_of_one_time_are_read_once(tmp_path, monkeypatch):
    """All have the same time, and the second is damaged."""
    monkeypatch.setattr(Writer1, "write", lambda self, one, _, raw, write=Writer1.write: write(self, one, 7, raw))
    path = in_chunks(tmp_path / "a.bag", 8)
    damage(path, (1,))
    read, errors = outcome(path)
    assert read == [0, 2, 3, 4, 5, 6, 7] and len(errors) == 1


def test_a_damaged_chunk_of_a_compressed_ros_1_bag_costs_its_frames(tmp_path, monkeypatch):
    def compressed(path, plain=Writer1):
        writer = plain(path)
        writer.set_compression(writer.CompressionFormat.LZ4)
        return writer

    monkeypatch.setitem(globals(), "Writer1", compressed)
    noise = np.random.default_rng(0).integers(256, size=(30, 200, 200), dtype=np.uint8)
    directions = [(0.0, math.sin(a), math.cos(a)) for a in np.linspace(0.3, -0.3, 200)]
    shape = {"directions": directions, "ranges": np.arange(200, dtype=np.float32) * 0.01 + 1, "beams": 200}
    noise[:, 0, 0] = np.arange(30)
    path = bag(tmp_path / "a.bag", [shape | {"data": image} for image in noise])
    content = bytearray(Path(path).read_bytes())
    start = [found.start() for found in re.finditer(b"\x04\x22\x4d\x18", content)][1]  # of LZ4's second frame
    content[start] = 0
    Path(path).write_bytes(content)
    read, errors = outcome(path)
    lost = sorted(set(range(30)) - set(read))
    assert [int(error.split("/sonar:")[1].partition(":")[0]) for error in errors] == lost
    assert lost == list(range(lost[0], lost[-1] + 1)) and 0 < lost[0] < lost[-1]


def test_a_damaged_record_of_an_mcap_file_costs_its_chunk(tmp_path):
    path = in_chunks(tmp_path / "mcap", 24)
    file = next(Path(path).glob("*.mcap"))
    with AnyReader([Path(path)]) as reader:
        size = 22 + len(next(reader.messages())[2])
        chunks = reader.readers[0].storage.storages[0].chunks
        first, second, *_ = (sum(chunk.channel_count.values()) for chunk in chunks)
    content = bytearray(file.read_bytes())
    head = b"\x05" + size.to_bytes(8, "little")
    length = [found.start() + 1 for found in re.finditer(re.escape(head), content)][first + 1]
    content[length : length + 8] = b"\xff" * 8
    file.write_bytes(content)
    read, errors = outcome(path)
    lost = range(first, first + second)
    assert read == [k for k in range(24) if k not in lost] and read[-1] == 23
    assert [error.partition(" here")[0] for error in errors] == [f"{path}:/sonar:{k}: the bag is damaged" for k in lost]
    assert outcome(str(file))[0] == read  # without its folder
    assert outcome(f"{path}:/sonar:23") == ([23], [])
    assert outcome(f"{path}:/sonar:{first + 1}") == ([], [errors[1]])


def test_chunks_are_skipped_only_where_a_time_separates_them():
    assert _after_chunk([(0, 9, 3), (10, 19, 4), (20, 29, 5)], 4) == (7, 20, 0)
    assert _after_chunk([(0, 10, 3), (10, 19, 4), (20, 29, 5), (29, 35, 1)], 4) == (7, 20, 0)
    assert _after_chunk([(0, 9, 3), (10, 19, 4)], 5) == (7, None, 0)
    assert _after_chunk([(0, 12, 3), (10, 19, 4), (20, 29, 5)], 4) is None
    assert _after_chunk([(0, 9, 3), (10, 20, 4), (20, 29, 5)], 4) is None
    assert _after_chunk([(10, 19, 4), (0, 9, 3)], 0) is None  # files that are listed out of order
    assert _after_chunk([(0, 9, 10**12), (10, 19, 4)], 0) is None  # an index that is damaged itself
    assert _after_chunk([], 0) is None


@pytest.mark.parametrize("name", ["out.bag", "out", "out.mcap"])
def test_written_frames_come_back(tmp_path, name):
    azimuth = [-14.2, -6.0, 1.5, 13.0]  # a table that is not even
    rng = np.random.default_rng(1)
    geometry = {"azimuth_deg": azimuth, "range_min_m": 0.75, "range_max_m": 5.75, "n_ranges": 50, "frequency_hz": 1.8e6}
    frames = [
        Frame(rng.random((50, 4)).astype(np.float32), None, "f", "f", geometry, {"time_s": 100.5 + k}) for k in range(3)
    ]
    path = tmp_path / name
    assert write_bag(path, iter(frames), "/didson") == 3
    for written, found in zip(frames, read_frames(f"{path}:/didson"), strict=True):
        np.testing.assert_allclose(found.image, written.image, atol=0.51 / 65535)
        np.testing.assert_allclose(found.geometry["azimuth_deg"], azimuth, atol=1e-6)
        assert found.geometry["range_min_m"] == pytest.approx(0.75, abs=1e-6)
        assert found.geometry["range_max_m"] == pytest.approx(5.75, abs=1e-6)
        assert found.meta["time_s"] == pytest.approx(written.meta["time_s"])
    with AnyReader([path]) as reader:  # as someone without this package reads it
        connection, stamp, raw = next(reader.messages())
        seen = reader.deserialize(raw, connection.msgtype)
        assert connection.msgtype == TYPE and stamp == 100_500_000_000
        first = seen.beam_directions[0]
        assert first.x == 0 and math.degrees(math.atan2(first.y, first.z)) == pytest.approx(14.2)  # Y is starboard
        assert seen.ranges[0] == pytest.approx(0.8)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    if path.is_dir():
        with pytest.raises(SonarjaxError, match="expected a folder that does not exist yet"):
            write_bag(path, frames)
    else:  # another bag takes its place; one that cannot be written leaves it as it was
        assert write_bag(path, frames[:1]) == 1 and len(read_frames(str(path))) == 1
        with pytest.raises(SonarjaxError, match="expected the sonar's geometry"):
            write_bag(path, [Frame(frames[0].image, None, "f", "f")])
        assert len(read_frames(str(path))) == 1


GEOMETRY = {"azimuth_deg": [0.0, 1.0], "range_min_m": 0.0, "range_max_m": 1.0}


def flat(value: float = 0.5, **meta) -> Frame:
    return Frame(np.full((3, 2), value, np.float32), None, "f", "f", GEOMETRY, meta)


def test_a_written_folder_can_be_copied_file_by_file(tmp_path):
    for place in ("one", "two"):
        (tmp_path / place).mkdir()
        write_bag(tmp_path / place / "run", [flat()])
    one, two = ({file.name: file.read_bytes() for file in (tmp_path / p / "run").iterdir()} for p in ("one", "two"))
    assert sorted(one) == ["metadata.yaml", "run.mcap"] and one == two


def test_what_is_written_to_a_link_goes_where_it_points(tmp_path):
    (tmp_path / "store").mkdir()
    link = tmp_path / "log.mcap"
    link.symlink_to("store/kept.mcap")
    for count in (1, 2):
        write_bag(link, [flat()] * count)
        assert link.is_symlink() and len(read_frames(tmp_path / "store" / "kept.mcap")) == count
    assert [entry.name for entry in (tmp_path / "store").iterdir()] == ["kept.mcap"]


@pytest.mark.parametrize("name", ["a.bag", "a.mcap"])
def test_written_frames_keep_their_times_and_their_order(tmp_path, name):
    exact = 1_371_198_079_122_519_001  # more digits than a float holds
    frames = [flat(0.1), flat(0.2), flat(0.3, time_ns=exact), flat(0.4, time_s=2.5), flat(0.5)]
    write_bag(tmp_path / name, frames)
    read = read_frames(tmp_path / name)
    assert [frame.meta["time_ns"] for frame in read] == [0, 10**8, 25 * 10**8, exact, exact + 10**8]
    np.testing.assert_allclose([frame.image[0, 0] for frame in read], [0.1, 0.2, 0.4, 0.3, 0.5], atol=1e-4)
    write_bag(tmp_path / f"again{name}", read)
    assert [frame.meta["time_ns"] for frame in read_frames(tmp_path / f"again{name}")][-2] == exact


@pytest.mark.parametrize(("ending", "key"), [("aris", "time_us"), ("ddf", "time")])
def test_times_of_a_recording_are_kept_in_a_bag(make, saved, tmp_path, ending, key):
    path = saved(f"a.{ending}", make.aris() if ending == "aris" else make.didson())
    recorded = read_frames(path)
    assert all(key in frame.meta for frame in recorded)
    write_bag(tmp_path / "a.mcap", recorded)
    times = [frame.meta["time_ns"] for frame in read_frames(tmp_path / "a.mcap")]
    assert times == [frame.meta["time_ns"] for frame in recorded]
    assert times[0] == (10**18 if ending == "aris" else 1_243_859_415_500_000_000)


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([flat(), flat(time_s=-1.0)], "f: time_s: expected a number from 0 to 2.14748e+09, got -1.0"),
        ([flat(time_ns=-1)], "f: time_ns: expected a number from 0"),
        ([flat(time_s=1e300)], "f: time_s: expected a number from 0"),
        ([flat(time_s="noon")], "f: time_s: expected a number from 0 to 2.14748e+09, got 'noon'"),
        ([Frame(np.zeros((3, 5), np.float32), None, "f", "f", GEOMETRY)], "f: azimuth_deg: expected 5 numbers"),
        ([Frame(np.zeros((1, 2), np.float32), None, "f", "f", GEOMETRY)], "f: ranges: expected two or more ascending"),
        ([Frame(np.full((2, 2), 1.5, np.float32), None, "f", "f", GEOMETRY)], "f: image: expected values from 0 to 1"),
        ([Frame(np.full((2, 2), np.nan, np.float32), None, "f", "f", GEOMETRY)], "f: image: expected values from 0"),
    ],
)
def test_what_cannot_be_put_into_a_message(tmp_path, frames, said):
    for name in ("a.bag", "run"):
        with pytest.raises(SonarjaxError) as caught:
            write_bag(tmp_path / name, frames)
        assert str(caught.value).startswith(said) and "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_frame_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    image = np.zeros((2, 2), np.float32)
    with pytest.raises(SonarjaxError, match="f: azimuth_deg: expected the sonar's geometry"):
        write_bag(tmp_path / "a.bag", [Frame(image, None, "f", "f")])
    geometry = {"azimuth_deg": [0.0, 1.0], "range_min_m": 0.0, "range_max_m": 1.0}
    with pytest.raises(SonarjaxError, match="f: mask: expected a frame without unmeasured pixels"):
        write_bag(tmp_path / "b", [Frame(image, np.zeros((2, 2), bool), "f", "f", geometry)])
    with pytest.raises(SonarjaxError, match="cannot be written"):
        write_bag(tmp_path / "missing" / "folder.bag", [])
    with pytest.raises(SonarjaxError, match="e.db3: expected a name that ends in .bag or .mcap"):
        write_bag(tmp_path / "e.db3", [])
    for topic in ("", "/"):
        with pytest.raises(SonarjaxError, match="topic: expected a name such as '/sonar_image', got"):
            write_bag(tmp_path / "f.bag", [flat()], topic)
    assert list(tmp_path.iterdir()) == []
