"""`make_dataset`: write a folder of simulated frames with their labels, boxes and poses, for training other networks.

Frames are made in chunks. The files of a chunk are written first, and then its part of the manifest. The part marks the
chunk as done: a restarted run makes only the chunks without a part, or of which something is missing or damaged.
Several processes can make different shards in the same folder. Once all parts exist, the manifest, annotations and card
are made from them, line by line. Files that are as they should be are not written again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from sonarjax.data.card import card_text, contact_sheet, summarised
from sonarjax.data.draws import key_numbers
from sonarjax.data.folder import MANIFEST
from sonarjax.data.formats import (
    CLASSES,
    FORMATS,
    Axes,
    Files,
    Item,
    category,
    category_names,
    describe_objects,
    paths_of,
    short,
    yaml_text,
)
from sonarjax.data.frames import CHUNK, Drawn, FrameSettings, draw_chunk
from sonarjax.data.layout import Limits, placement_limits
from sonarjax.engine import PLAIN, Engine
from sonarjax.io import SonarjaxError, make_folder, write_atomic, write_text
from sonarjax.io.given import check_kind, is_text, is_whole, shown
from sonarjax.io.outputs import check_folder
from sonarjax.render import check_fits
from sonarjax.render.simulate import check_sonar_alone
from sonarjax.scene import Mesh, stack_meshes
from sonarjax.scene.standing import check_over_origin
from sonarjax.sensor import SensorModel
from sonarjax.sonar import Sonar, range_edges_of

SETTINGS, PARTS, SHEET, CARD = "dataset.json", "parts", "contact_sheet.png", "README.md"
VERSION = 4
"""Version of the folder's layout and of the way in which a frame is drawn from its number."""
MOST_FRAMES = 2**31
ABANDONED_S = 3600
"""Age from which on a temporary file beside the manifest is taken for one of a process that was killed [s]."""
SENSOR_FIELDS = tuple(field.name for field in dataclasses.fields(SensorModel))
Lines = list[dict[str, Any]]


class Plan(NamedTuple):
    """Everything that a frame depends on, except its number."""

    meshes: Mesh
    """The meshes as one batch."""
    sonar: Sonar
    """The sonar that images them."""
    limits: Limits
    """Where objects may stand."""
    axes: Axes
    """Azimuths and ranges of the pixels, and names of the meshes."""
    key: np.ndarray
    """Data of the JAX key."""
    frames: int
    """Number of frames."""
    format: str
    """One of `FORMATS`."""
    settings: FrameSettings
    """How frames are made."""


class Part(NamedTuple):
    """A chunk of frames, ready to be written."""

    chunk: int
    """Number of the chunk."""
    files: Files
    """Contents of the files, by their path in the folder."""
    lines: Lines
    """One record for each frame: its number, file names, objects and sensor parameters."""


def _write(content: bytes, file: BinaryIO) -> None:
    file.write(content)


def make_dataset(
    meshes: Mapping[str, Mesh],
    sonar: Sonar,
    folder: str | os.PathLike[str],
    count: int,
    *,
    key: Array,
    format: str = "png",
    settings: FrameSettings = FrameSettings(),
    shard: tuple[int, int] = (1, 1),
    license: str = "",
    engine: Engine = PLAIN,
    progress: Callable[[int], object] | None = None,
) -> bool:
    """Write a data set of simulated frames to a folder, or continue one that was interrupted.

    With all else the same, frame k depends only on `key` and k. An interrupted run can therefore be continued, and
    shards together give the same files as a single run. On CPUs of the same kind, files are identical byte for byte.

    Args:
        meshes: The meshes, by name, each around its origin; their lowest points at z = 0, if they are to stand on the
            floor (`Mesh.standing`).
        sonar: The sonar.
        folder: Where to write; must be missing, empty (but for hidden files), or hold a part of the same data set.
        count: Number of frames in the whole data set.
        key: JAX key from which everything random is drawn.
        format: One of `FORMATS`.
        settings: How frames are made.
        shard: (i, n) to make only the i-th of n parts of the data set, counted from 1.
        license: Licence to state in the data set's card.
        engine: What makes the chunks.
        progress: Called with a number of frames whenever that many more are done; includes frames that an earlier run
            made.

    Returns:
        True if the data set is complete, False if chunks of other shards are missing.

    Raises:
        SonarjaxError: A setting is not allowed, `folder` is empty, a mesh is larger than the view or beside its origin,
            the sonar sees no floor or its platform is out of view, or the folder holds something other than a part of
            the same data set.
    """
    _check(meshes, sonar, count, format, settings, shard, license)
    check_kind(engine, Engine, "engine")
    check_folder(folder, "folder")
    plan = _plan(meshes, sonar, int(count), key, format, settings)
    target = Path(folder)
    facts = _facts(plan, meshes, license)
    _take_up(target, facts)
    if not (target / "sonar.toml").exists():
        sonar.to_toml(target / "sonar.toml")
    mine = range(shard[0] - 1, _chunks(count), shard[1])
    told = progress or (lambda frames: None)
    for part in engine.stream(draw_part, plan, _missing(target, mine, plan, told)):
        for name, content in part.files.items():
            write_atomic(target / name, partial(_write, content))
        write_text(_part(target, part.chunk), "".join(json.dumps(line) + "\n" for line in part.lines))
        told(len(part.lines))
    if not _others_are_done(target, mine, plan):
        return False
    _delete_left(target, plan.format, alone=shard[1] == 1)
    _finish(target, plan, facts)
    return True


def draw_part(plan: Plan, chunk: int, engine: Engine) -> Part:
    """Draw the frames of a chunk and turn them into files and manifest records.

    Raises:
        SonarjaxError: As `draw_chunk`.
    """
    drawn = draw_chunk(plan.meshes, plan.sonar, plan.limits, chunk, plan.settings, engine, key=plan.key)
    files, lines, items = Files(), Lines(), []
    for at, number in enumerate(_numbers(chunk, plan.frames)):
        items.append(_item(drawn, at, number))
        own, names = FORMATS[plan.format](items[-1], plan.axes)
        files |= own
        sensor = {name: short(float(v)) for name, v in zip(SENSOR_FIELDS, drawn.sensor[at], strict=True)}
        objects = describe_objects(items[-1], plan.axes)
        lines.append({"number": number} | names | {"objects": objects, "sensor": sensor})
    if chunk == 0:
        files[SHEET] = contact_sheet(items)
    return Part(chunk, files, lines)


def _item(drawn: Drawn, at: int, number: int) -> Item:
    there = int(drawn.there[at].sum())
    pictures = drawn.image[at], drawn.labels[at], drawn.instances[at]
    return Item(number, *pictures, drawn.mesh[at][:there].tolist(), drawn.pose[at][:there].tolist())


def _check(meshes: Any, sonar: Any, count: Any, format: Any, settings: Any, shard: Any, license: Any) -> None:
    """Raise a SonarjaxError for an argument of another kind than expected, or out of its range."""
    if not isinstance(meshes, Mapping):
        raise SonarjaxError(
            f"meshes: expected a mapping from names to meshes, such as {{'box': mesh}}, got {shown(meshes)}"
        )
    if not meshes:
        raise SonarjaxError("meshes: expected at least one")
    for name, mesh in meshes.items():
        if not is_text(name):
            raise SonarjaxError(f"meshes: expected names as keys, got {shown(name)}")
        check_kind(mesh, Mesh, f"meshes[{name!r}]")
    check_sonar_alone(sonar)
    if not (is_whole(count) and 1 <= count <= MOST_FRAMES):
        raise SonarjaxError(f"count: expected a whole number from 1 to {MOST_FRAMES}, got {shown(count)}")
    if not (isinstance(format, str) and format in FORMATS):
        raise SonarjaxError(f"format: expected one of {', '.join(FORMATS)}, got {shown(format)}")
    check_kind(settings, FrameSettings, "settings")
    pair = isinstance(shard, tuple | list) and len(shard) == 2 and all(map(is_whole, shard))
    if not (pair and 1 <= shard[0] <= shard[1]):
        raise SonarjaxError(f"shard: expected (i, n) with i from 1 to n, got {shard if pair else shown(shard)}")
    if not is_text(license):
        raise SonarjaxError(f"license: expected a text, got {shown(license)}")


def _plan(
    meshes: Mapping[str, Mesh], sonar: Sonar, count: int, key: Array, format: str, settings: FrameSettings
) -> Plan:
    for name, mesh in meshes.items():
        check_fits(mesh, sonar, name)
        check_over_origin(mesh, name)
    azimuth = np.degrees(np.asarray(sonar.azimuth, np.float64))
    axes = Axes(azimuth, range_edges_of(sonar), tuple(meshes))
    data = key_numbers(key)
    plain = jax.tree.map(lambda v: np.asarray(v, np.float32), sonar)
    return Plan(
        stack_meshes(list(meshes.values())), plain, placement_limits(sonar), axes, data, count, format, settings
    )


def _facts(plan: Plan, meshes: Mapping[str, Mesh], license: str) -> dict[str, Any]:
    """The content of the folder's settings file. Two runs for which it is equal make the same files."""
    known = [
        {"name": name, "triangles": _triangles(mesh), "sha256": _digest(_arrays(mesh))} for name, mesh in meshes.items()
    ]
    return {
        "version": VERSION, "format": plan.format, "count": plan.frames, "key": plan.key.tolist(), "meshes": known,
        "sonar": _digest([*jax.tree.leaves(plan.sonar), np.asarray(plan.sonar.shape)]),
        "settings": dataclasses.asdict(plan.settings), "license": license,
    }  # fmt: skip


def _arrays(mesh: Mesh) -> list[Any]:
    """What of a mesh the frames depend on."""
    return [mesh.vertices, mesh.faces] + ([] if mesh.reflectivity is None else [mesh.reflectivity])


def _triangles(mesh: Mesh) -> int:
    faces = np.asarray(mesh.faces)
    return int((faces[:, 0] != faces[:, 1]).sum())


def _digest(arrays: Iterable[Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def _take_up(target: Path, facts: dict[str, Any]) -> None:
    """Prepare the folder of a new data set, or check that an existing folder holds the same data set.

    Raises:
        SonarjaxError: It holds something else.
    """
    if target.exists() and not target.is_dir():
        raise SonarjaxError(f"{target}: expected a folder, this is a file")
    path = target / SETTINGS
    if not path.exists():
        make_folder(str(target))
        left = any(not name.startswith(".") for name in os.listdir(target))
        if left and not path.exists():  # another shard may have written its settings meanwhile
            raise SonarjaxError(f"{target}: expected an empty folder, or one with the same data set")
        if not left:
            # Before the subfolders: a process that is killed in between leaves a data set that can be continued.
            write_text(path, json.dumps(facts, indent=1) + "\n")
    _check_settings(target, path, facts)
    for name in _FOLDERS[facts["format"]]:
        make_folder(str(target / name))


def _check_settings(target: Path, path: Path, facts: dict[str, Any]) -> None:
    """Raise a SonarjaxError unless the data set's settings, in the file `path`, are these."""
    try:
        old = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SonarjaxError(f"{path}: expected the settings of a data set: {error}") from error
    for name, value in facts.items():
        if not isinstance(old, dict) or old.get(name) != value:
            was = old.get(name) if isinstance(old, dict) else None
            raise SonarjaxError(
                f"{target}: holds another data set, made with {name} {json.dumps(was)}, now {json.dumps(value)}: "
                "expected another folder, or the same settings to continue"
            )


_FOLDERS = {
    "png": (PARTS, "images", "labels", "instances"), "npz": (PARTS, "frames"), "coco": (PARTS, "images"),
    "yolo": (PARTS, "images", "labels"),
}  # fmt: skip


def _chunks(count: int) -> int:
    return -(-count // CHUNK)


def _part(target: Path, chunk: int) -> Path:
    return target / PARTS / f"{chunk:08d}.jsonl"


def _numbers(chunk: int, count: int) -> range:
    """Numbers of a chunk's frames."""
    return range(chunk * CHUNK, min((chunk + 1) * CHUNK, count))


def _missing(target: Path, chunks: range, plan: Plan, told: Callable[[int], object]) -> Iterator[int]:
    """Yield the chunks that are not done yet; report the frames of those that are to `told`."""
    for chunk in chunks:
        if _is_done(target, chunk, plan):
            told(len(_numbers(chunk, plan.frames)))
        else:
            yield chunk


def _others_are_done(target: Path, mine: range, plan: Plan) -> bool:
    """Whether the chunks of other shards than `mine` are done."""
    chunks = range(_chunks(plan.frames))
    if not all(_part(target, chunk).exists() for chunk in chunks):  # sooner told than whether all are intact
        return False
    return all(chunk in mine or _is_done(target, chunk, plan) for chunk in chunks)


def _is_done(target: Path, chunk: int, plan: Plan) -> bool:
    """Whether a chunk's part holds a record of each of its frames, and all their files are there, no picture empty."""
    try:
        lines = [json.loads(line) for line in _part(target, chunk).read_text(encoding="utf-8").splitlines()]
        complete = [line["number"] for line in lines] == list(_numbers(chunk, plan.frames))
        needed = {"objects", "sensor"} | ({"annotations"} if plan.format == "coco" else set())
        for line in lines if complete else ():
            paths = paths_of(plan.format, line["number"])
            complete &= needed <= line.keys() and all(line[name] == path for name, path in paths.items())
            complete &= all(_is_written(target / path) for path in paths.values())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return False  # there is none, or it is damaged
    return complete and (chunk > 0 or (target / SHEET).is_file())


def _is_written(file: Path) -> bool:
    """Whether a file is there and not empty. YOLO's text is empty for a frame that shows no object."""
    return file.is_file() and (file.suffix == ".txt" or file.stat().st_size > 0)


def _lines(target: Path, count: int) -> Iterator[dict[str, Any]]:
    """Yield the records of all frames in order, reading one at a time."""
    for chunk in range(_chunks(count)):
        with open(_part(target, chunk), encoding="utf-8") as file:
            for line in file:
                yield json.loads(line)


def _delete_left(target: Path, format: str, alone: bool) -> None:
    """Delete temporary files of interrupted processes, once all frames exist.

    No process writes frames any more. But unless there is a single shard, another one may be writing the manifest.
    """
    for folder in (target, *(target / name for name in _FOLDERS[format])):
        for left in folder.glob(".sonarjax-*.tmp"):
            with contextlib.suppress(OSError):
                if alone or folder != target or time.time() - left.stat().st_mtime > ABANDONED_S:
                    left.unlink()


def _finish(target: Path, plan: Plan, facts: dict[str, Any]) -> None:
    """Write the manifest, annotations and card from all parts. A card that exists is the user's, who may change it."""
    _write_lines(target / MANIFEST, lambda: _manifest(target, plan.frames))
    if plan.format == "coco":
        _write_lines(target / "annotations.json", lambda: _coco(target, plan))
    if plan.format == "yolo":
        names = "".join(f"  {k}: {yaml_text(name)}\n" for k, name in enumerate(category_names(plan.axes.names)))
        # `path` is left out: readers resolve it from their working directory, and without it use this file's folder.
        _write_if_missing(target / "data.yaml", lambda: f"train: images\nval: images\nnames:\n{names}")
    _write_if_missing(target / CARD, lambda: card_text(facts, summarised(_lines(target, plan.frames)), plan.axes))


def _write_if_missing(path: Path, text: Callable[[], str]) -> None:
    if not path.exists():
        write_text(path, text())


def _write_lines(path: Path, lines: Callable[[], Iterator[str]]) -> None:
    """Write lines to a file, unless it holds them already."""
    if not _holds(path, lines):
        write_atomic(path, lambda file: file.writelines(line.encode() for line in lines()))


def _holds(path: Path, lines: Callable[[], Iterator[str]]) -> bool:
    try:
        with open(path, "rb") as file:
            same = all(file.read(len(line)) == line for line in map(str.encode, lines()))
            return same and not file.read(1)
    except OSError:
        return False


def _manifest(target: Path, count: int) -> Iterator[str]:
    """Yield the manifest line by line."""
    for line in _lines(target, count):
        line.pop("annotations", None)
        yield json.dumps(line) + "\n"


def _coco(target: Path, plan: Plan) -> Iterator[str]:
    """Yield annotations.json piece by piece; an annotation's id is computed from its frame, object and class."""
    height, width = plan.sonar.shape
    categories = [
        {"id": category(mesh, label), "name": f"{name} {kind}", "supercategory": name}
        for mesh, name in enumerate(plan.axes.names)
        for label, kind in enumerate(CLASSES, 1)
    ]
    yield f'{{"info": {json.dumps({"description": "made by sonarjax dataset"})},\n'
    yield f'"categories": {json.dumps(categories)},\n"images": ['
    for line in _lines(target, plan.frames):
        image = {"id": line["number"] + 1, "file_name": line["image"], "width": width, "height": height}
        yield f"{',' if line['number'] else ''}\n{json.dumps(image)}"
    yield '],\n"annotations": ['
    between = ""
    for line in _lines(target, plan.frames):
        for entry in line["annotations"]:
            place = (line["number"] * plan.settings.scenes + entry["instance"] - 1) * len(CLASSES)
            number = place + (entry["category_id"] - 1) % len(CLASSES) + 1
            yield f"{between}\n{json.dumps({'id': number} | entry)}"
            between = ","
    yield "]}\n"
