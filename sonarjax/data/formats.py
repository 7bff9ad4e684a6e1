"""Encode one frame of a data set as PNG, NPZ, COCO or YOLO files, and describe its objects for the manifest.

A box is [left, top, width, height] in pixels: left and width in beams, top and height in range bins, counted from the
near starboard corner. It is None if nothing of the class is seen. COCO and YOLO have two categories for each mesh: its
highlight and its shadow.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from sonarjax.data.folder import STORED
from sonarjax.io.atomic import zip_arrays

CLASSES = ("highlight", "shadow")
"""The classes of an object's pixels: label 1 is the first, label 2 the second."""
PATHS = {
    "png": {"image": "images/{:08d}.png", "labels": "labels/{:08d}.png", "instances": "instances/{:08d}.png"},
    "npz": {"frame": "frames/{:08d}.npz"},
    "coco": {"image": "images/{:08d}.png"},
    "yolo": {"image": "images/{:08d}.png", "boxes": "labels/{:08d}.txt"},
}
"""Files of a frame by format: what its manifest record calls each, and its path, given the frame's number."""
Files = dict[str, bytes]


class Item(NamedTuple):
    """One frame with its labels and objects."""

    number: int
    """Number of the frame in the data set."""
    image: UInt8[np.ndarray, "range beam"]
    """Image as a device stores it."""
    labels: UInt8[np.ndarray, "range beam"]
    """0 background, 1 highlight, 2 shadow."""
    instances: UInt8[np.ndarray, "range beam"]
    """Number of the object that the highlight or shadow belongs to, from 1 on; 0 for background."""
    meshes: list[int]
    """Index of each object's mesh."""
    poses: list[list[float]]
    """x [m], y [m] and yaw [rad] of each object."""


class Axes(NamedTuple):
    """Azimuths and ranges of the pixels, which all frames share, and the names of the meshes."""

    azimuth_deg: np.ndarray
    """Beam centres (beam,) [deg]."""
    range_edges_m: np.ndarray
    """Range bin edges (edge,) [m]."""
    names: tuple[str, ...]
    """Names of the meshes."""


def paths_of(format: str, number: int) -> dict[str, str]:
    """Paths in the folder of the files of frame `number`, by what its manifest record calls them."""
    return {name: path.format(number) for name, path in PATHS[format].items()}


def mask_of(item: Item, instance: int, label: int) -> Bool[np.ndarray, "range beam"]:
    """Mask (range, beam) of the visible pixels of class `label` that belong to object `instance` (from 1 on)."""
    return (item.instances == instance) & (item.labels == label)


def box_of(mask: Bool[np.ndarray, "range beam"]) -> list[int] | None:
    """Bounding box [left, top, width, height] [pixels] of a mask (range, beam); None if the mask is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    left, top = int(columns[0]), int(rows[0])
    return [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1]


def run_lengths(mask: Bool[np.ndarray, "range beam"]) -> dict[str, Any]:
    """Encode a mask (range, beam) as COCO's uncompressed run lengths.

    Pixels are taken column by column. The first run counts unset pixels.
    """
    flat = np.concatenate([[False], mask.ravel(order="F")])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    return {"size": list(mask.shape), "counts": np.diff([0, *changes, mask.size]).tolist()}


def describe_objects(item: Item, axes: Axes) -> list[dict[str, Any]]:
    """List each object's name and pose [m, deg], and the box and pixel count of its highlight and of its shadow."""
    found = []
    for instance, (mesh, (x, y, yaw)) in enumerate(zip(item.meshes, item.poses, strict=True), 1):
        entry = {"instance": instance, "mesh": axes.names[mesh]}
        entry |= {"x_m": short(x), "y_m": short(y), "yaw_deg": short(math.degrees(yaw))}
        for label, name in enumerate(CLASSES, 1):
            mask = mask_of(item, instance, label)
            entry[name] = {"box": box_of(mask), "pixels": int(mask.sum())}
        found.append(entry)
    return found


def short(value: float) -> float:
    """Round a float32 value to 7 significant digits, about its precision, so that it is short when written in JSON."""
    return float(f"{value:.7g}")


def category(mesh: int, label: int) -> int:
    """COCO category id, from 1 on, of the highlight (label 1) or shadow (label 2) of a mesh."""
    return len(CLASSES) * mesh + label


def category_names(names: Sequence[str]) -> list[str]:
    """Names of all categories, in the order of their ids, for the mesh names `names`."""
    return [f"{name} {kind}" for name in names for kind in CLASSES]


def yaml_text(text: str) -> str:
    """A text as YAML, in quotes.

    JSON's escapes are YAML's too, but for characters beyond 16 bits: JSON makes two of each, and YAML reads these as
    two. So they stand as they are, in UTF-8.
    """
    return '"' + "".join(one if ord(one) > 0xFFFF else json.dumps(one)[1:-1] for one in text) + '"'


def _seen(item: Item) -> Iterator[tuple[int, int, np.ndarray, list[int]]]:
    """Yield instance, category, mask (range, beam) and box of each object's highlight and shadow, where visible."""
    for instance, mesh in enumerate(item.meshes, 1):
        for label in range(1, len(CLASSES) + 1):
            mask = mask_of(item, instance, label)
            if (box := box_of(mask)) is not None:
                yield instance, category(mesh, label), mask, box


def png_bytes(image: UInt8[np.ndarray, "row column *channel"]) -> bytes:
    """Encode a picture as PNG: grey (row, column) or colour (row, column, 3)."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, format="PNG")
    return buffer.getvalue()


def _png(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """PNG files of the image, the labels and the instances.

    Labels are stored as 0 shadow, 128 background and 255 highlight, as `import_pairs` reads them.
    """
    pictures = {"image": item.image, "labels": STORED[item.labels], "instances": item.instances}
    names = paths_of("png", item.number)
    return {names[key]: png_bytes(picture) for key, picture in pictures.items()}, dict(names)


def _npz(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """One NPZ file with all arrays, also those of no object; `boxes` is -1 where nothing is seen.

    The file can be given to recognition as a frame, because it has an `image`.
    """
    count = len(item.meshes)
    masks = {
        name: np.array([mask_of(item, k, label) for k in range(1, count + 1)], bool).reshape(count, *item.labels.shape)
        for label, name in enumerate(CLASSES, 1)
    }  # fmt: skip
    boxes = [[box_of(masks[name][k]) or [-1] * 4 for name in CLASSES] for k in range(count)]
    buffer = io.BytesIO()
    arrays = {
        "image": item.image, "labels": item.labels, "instances": item.instances,
        "highlight_masks": masks["highlight"], "shadow_masks": masks["shadow"],
        "boxes": np.array(boxes, np.int32).reshape(count, len(CLASSES), 4),
        "mesh": np.array(item.meshes, np.int32), "pose": np.array(item.poses, np.float32).reshape(count, 3),
        "azimuth_deg": axes.azimuth_deg, "range_edges_m": axes.range_edges_m,
    }  # fmt: skip
    zip_arrays(buffer, arrays)
    names = paths_of("npz", item.number)
    return {names["frame"]: buffer.getvalue()}, dict(names)


def _coco(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """The image as PNG. The annotations go into the frame's record, and later into one file for all frames."""
    names, annotations = paths_of("coco", item.number), []
    for instance, number, mask, box in _seen(item):
        annotations.append({
            "image_id": item.number + 1, "category_id": number, "instance": instance, "bbox": box,
            "area": int(mask.sum()), "iscrowd": 0, "segmentation": run_lengths(mask),
        })  # fmt: skip
    return {names["image"]: png_bytes(item.image)}, names | {"annotations": annotations}


def _yolo(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """The image, and a text file with a line for each box: category from 0 on, then centre and size.

    Centre and size are shares of the image's width and height.
    """
    height, width = item.image.shape
    lines = []
    for _, number, _, (left, top, columns, rows) in _seen(item):
        middle = (left + columns / 2) / width, (top + rows / 2) / height
        numbers = *middle, columns / width, rows / height
        lines.append(f"{number - 1} {' '.join(f'{v:.6f}' for v in numbers)}\n")
    names = paths_of("yolo", item.number)
    return {names["image"]: png_bytes(item.image), names["boxes"]: "".join(lines).encode()}, dict(names)


FORMATS: dict[str, Callable[[Item, Axes], tuple[Files, dict[str, Any]]]] = {
    "png": _png, "npz": _npz, "coco": _coco, "yolo": _yolo
}  # fmt: skip
"""Encoders by format. Each returns a frame's files by name, and the entries that its manifest record gets for them."""
