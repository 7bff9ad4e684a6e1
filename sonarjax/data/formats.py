"""One frame of a data set as files: PNG, NPZ, COCO and YOLO, and the line that describes it.

A box is [left, top, width, height] in pixels, beams and range bins from the near starboard corner on, or None where
nothing of the class is seen. COCO and YOLO have two categories for each mesh, its highlight and its shadow.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from sonarjax.data.folder import STORED
from sonarjax.io.atomic import zip_arrays

CLASSES = ("highlight", "shadow")
"""Of an object's pixels; the first is label 1, the second label 2."""
Files = dict[str, bytes]


class Item(NamedTuple):
    """One frame, and what is in it."""

    number: int
    """Its number in the data set."""
    image: UInt8[np.ndarray, "range beam"]
    """What a device stores."""
    labels: UInt8[np.ndarray, "range beam"]
    """0 background, 1 highlight, 2 shadow."""
    instances: UInt8[np.ndarray, "range beam"]
    """Which object's highlight or shadow it is, from 1 on."""
    meshes: list[int]
    """Number of each object's mesh."""
    poses: list[list[float]]
    """x [m], y [m] and yaw [rad] of each."""


class Axes(NamedTuple):
    """What the pixels of all frames mean, and what objects are called."""

    azimuth_deg: np.ndarray
    """Beam centres (beam,) [deg]."""
    range_edges_m: np.ndarray
    """Range bin edges (edge,) [m]."""
    names: tuple[str, ...]
    """Names of the meshes."""


def mask_of(item: Item, instance: int, label: int) -> Bool[np.ndarray, "range beam"]:
    """The pixels (range, beam) of class `label` of the object `instance` (from 1 on) that are seen."""
    return (item.instances == instance) & (item.labels == label)


def box_of(mask: Bool[np.ndarray, "range beam"]) -> list[int] | None:
    """[left, top, width, height] [pixels] around a mask (range, beam), None around nothing."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    left, top = int(columns[0]), int(rows[0])
    return [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1]


def run_lengths(mask: Bool[np.ndarray, "range beam"]) -> dict[str, Any]:
    """A mask (range, beam) as COCO's uncompressed run lengths: down the columns, beginning with what is not set."""
    flat = np.concatenate([[False], mask.ravel(order="F")])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    return {"size": list(mask.shape), "counts": np.diff([0, *changes, mask.size]).tolist()}


def describe_objects(item: Item, axes: Axes) -> list[dict[str, Any]]:
    """Each object's name, pose [m, deg], and the box and number of pixels of its highlight and of its shadow."""
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
    """A float32 in as few digits as tell it apart."""
    return float(f"{value:.7g}")


def category(mesh: int, label: int) -> int:
    """COCO's number of a mesh's highlight (label 1) or shadow (2), from 1 on."""
    return len(CLASSES) * mesh + label


def category_names(names: Sequence[str]) -> list[str]:
    """Names of all categories in their order."""
    return [f"{name} {kind}" for name in names for kind in CLASSES]


def _seen(item: Item) -> Iterator[tuple[int, int, np.ndarray, list[int]]]:
    """Instance, category, mask (range, beam) and box of all that is seen of each object."""
    for instance, mesh in enumerate(item.meshes, 1):
        for label in range(1, len(CLASSES) + 1):
            mask = mask_of(item, instance, label)
            if (box := box_of(mask)) is not None:
                yield instance, category(mesh, label), mask, box


def png_bytes(image: UInt8[np.ndarray, "row column *channel"]) -> bytes:
    """A picture (row, column), grey, or (row, column, 3) in colour, as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, format="PNG")
    return buffer.getvalue()


def _png(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """Image, labels (0 shadow, 128 background, 255 highlight, as `import_pairs` reads them) and instances."""
    stem = f"{item.number:08d}.png"
    pictures = {"image": item.image, "labels": STORED[item.labels], "instances": item.instances}
    names = {"image": f"images/{stem}", "labels": f"labels/{stem}", "instances": f"instances/{stem}"}
    return {names[key]: png_bytes(picture) for key, picture in pictures.items()}, dict(names)


def _npz(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """All arrays in one file, whose `image` can be recognized; `boxes` are -1 where nothing is seen."""
    count = len(item.meshes)
    masks = {
        name: np.array([mask_of(item, k, label) for k in range(1, count + 1)])
        for label, name in enumerate(CLASSES, 1)
    }  # fmt: skip
    boxes = [[box_of(masks[name][k]) or [-1] * 4 for name in CLASSES] for k in range(count)]
    buffer = io.BytesIO()
    arrays = {
        "image": item.image, "labels": item.labels, "instances": item.instances,
        "highlight_masks": masks["highlight"], "shadow_masks": masks["shadow"], "boxes": np.array(boxes, np.int32),
        "mesh": np.array(item.meshes, np.int32), "pose": np.array(item.poses, np.float32),
        "azimuth_deg": axes.azimuth_deg, "range_edges_m": axes.range_edges_m,
    }  # fmt: skip
    zip_arrays(buffer, arrays)
    name = f"frames/{item.number:08d}.npz"
    return {name: buffer.getvalue()}, {"frame": name}


def _coco(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """The image; annotations wait in the line for the one file that COCO wants."""
    name = f"images/{item.number:08d}.png"
    annotations = []
    for instance, number, mask, box in _seen(item):
        annotations.append({
            "image_id": item.number + 1, "category_id": number, "instance": instance, "bbox": box,
            "area": int(mask.sum()), "iscrowd": 0, "segmentation": run_lengths(mask),
        })  # fmt: skip
    return {name: png_bytes(item.image)}, {"image": name, "annotations": annotations}


def _yolo(item: Item, axes: Axes) -> tuple[Files, dict[str, Any]]:
    """The image, and a text file with a line for each box: category from 0 on, middle and size as shares."""
    height, width = item.image.shape
    lines = []
    for _, number, _, (left, top, columns, rows) in _seen(item):
        middle = (left + columns / 2) / width, (top + rows / 2) / height
        numbers = *middle, columns / width, rows / height
        lines.append(f"{number - 1} {' '.join(f'{v:.6f}' for v in numbers)}\n")
    names = {"image": f"images/{item.number:08d}.png", "boxes": f"labels/{item.number:08d}.txt"}
    return {names["image"]: png_bytes(item.image), names["boxes"]: "".join(lines).encode()}, dict(names)


FORMATS: dict[str, Callable[[Item, Axes], tuple[Files, dict[str, Any]]]] = {
    "png": _png, "npz": _npz, "coco": _coco, "yolo": _yolo
}  # fmt: skip
"""What makes a frame's files by name, and the names that its line of the manifest has for them."""
