"""Pairs as a folder of PNG files with a manifest, for other tools; also the form for folders of real pairs.

Each line of `manifest.jsonl` is a JSON object whose `image` and `labels` name two grey PNGs of equal shape in the
folder. Labels are stored as grey that people can see: 0 shadow, 128 background, 255 highlight. What made the pairs
(`number`, `key`, `settings`) is added if it is known. A reader needs only the names.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from sonarjax.crops import PATCH
from sonarjax.data.draws import key_numbers
from sonarjax.data.pairs import Pairs, PairSettings
from sonarjax.io import SonarjaxError, read_bytes, write_png, write_text
from sonarjax.io.files import reason
from sonarjax.io.given import check_kind, image_array, is_whole, number_array, shown
from sonarjax.io.outputs import check_folder
from sonarjax.io.png import parse_png

MANIFEST = "manifest.jsonl"
STORED = np.array([128, 255, 0], np.uint8)
"""Grey value in a file for background, highlight and shadow."""
ROUNDING = 1e-5
"""By how much a resampled image may leave [0, 1]."""


def export_pairs(
    pairs: Pairs,
    folder: str | os.PathLike[str],
    *,
    key: Array | None = None,
    settings: PairSettings | None = None,
    first: int = 0,
) -> None:
    """Write pairs as PNG files with a manifest; `import_pairs` reads them back unchanged.

    The manifest is written last, so a folder that has one is complete.

    Args:
        pairs: The pairs.
        folder: Where to write; made if it is missing.
        key, settings: As given to `make_pairs`, kept in the manifest; None leaves them out.
        first: As given to `make_pairs`: number of the first pair in the manifest.

    Raises:
        SonarjaxError: The pairs are no pairs: images are not in [0, 1], labels are not 0, 1 and 2, or their shapes
            differ; another argument is of another kind; `folder` is empty; or something cannot be written.
    """
    images, labels = _arrays(pairs)
    check_folder(folder, "folder")
    origin = _origin(key, settings)
    if not (is_whole(first) and first >= 0):
        raise SonarjaxError(f"first: expected a whole number of 0 or more, got {shown(first)}")
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SonarjaxError(f"{target}: cannot create the folder: {reason(error)}") from error
    with contextlib.suppress(OSError):
        (target / MANIFEST).unlink()  # left by an earlier export
    lines = []
    for index, (image, label) in enumerate(zip(images, labels, strict=True)):
        names = {"image": f"image_{index:05d}.png", "labels": f"labels_{index:05d}.png"}
        write_png(target / names["image"], image)
        write_png(target / names["labels"], STORED[label])
        lines.append(json.dumps(names | {"number": int(first) + index} | origin))
    write_text(target / MANIFEST, "\n".join(lines) + "\n")


def _arrays(pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Images and labels (pair, range, beam) of pairs, once they are checked."""
    check_kind(pairs, Pairs, "pairs")
    images, labels = image_array(pairs.image, "pairs: image"), number_array(pairs.labels, "pairs: labels")
    if images.ndim != 3 or images.shape != labels.shape:
        got = f"{images.shape} and {labels.shape}"
        raise SonarjaxError(f"pairs: expected images and labels (pair, range, beam) of the same shape, got {got}")
    if images.dtype != np.uint8:
        if not ((images >= -ROUNDING) & (images <= 1 + ROUNDING)).all():
            raise SonarjaxError("pairs: image: expected values in [0, 1]")
        images = images.clip(0.0, 1.0)
    integers = labels.dtype.kind in "iu"
    if not (integers and ((labels >= 0) & (labels < len(STORED))).all()):
        got = f"{labels.min()} to {labels.max()}" if integers else str(labels.dtype)
        raise SonarjaxError(f"pairs: labels: expected whole numbers from 0 to {len(STORED) - 1}, got {got}")
    return images, labels


def _origin(key: Array | None, settings: PairSettings | None) -> dict[str, Any]:
    """What the manifest says of what made the pairs."""
    origin: dict[str, Any] = {}
    if settings is not None:
        check_kind(settings, PairSettings, "settings")
        origin["settings"] = dataclasses.asdict(settings)
    if key is not None:
        origin["key"] = key_numbers(key).tolist()
    return origin


def import_pairs(folder: str | os.PathLike[str]) -> Pairs:
    """Read the pairs of a folder that has a manifest.

    Each line of `manifest.jsonl` is a JSON object with two keys, `image` and `labels`: the names of two PNG files in
    the folder, such as {"image": "a.png", "labels": "a_labels.png"}. Both pictures are grey and of equal shape, with
    near ranges at the top and port on the right. A label picture has three grey values: 0 shadow, 128 background, 255
    highlight. Other keys are ignored. Pictures of another size are resampled to 128 × 128 (labels to the nearest).

    Args:
        folder: The folder, as `export_pairs` writes it, or made by hand.

    Returns:
        Images and labels (pair, 128, 128), in the order of the manifest.

    Raises:
        SonarjaxError: The manifest or a picture is missing or cannot be used, or a label picture has other grey values.
            The message names the line.
    """
    source = Path(folder)
    manifest = source / MANIFEST
    if source.exists() and not source.is_dir():
        raise SonarjaxError(f"{source}: expected a folder of pairs, this is a file")
    text = read_bytes(manifest).decode("utf-8", "replace")
    lines = [(f"{manifest}:{number}", line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise SonarjaxError(f"{manifest}: expected one JSON object on each line, the file has none")
    pairs = [_read_pair(source, *_names(line, where), where) for where, line in lines]
    return Pairs(*(jnp.asarray(np.stack(part)) for part in zip(*pairs, strict=True)))


def _names(line: str, where: str) -> tuple[str, str]:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise SonarjaxError(f"{where}: expected a JSON object: {' '.join(str(error).split())}") from error
    if not isinstance(entry, dict):
        raise SonarjaxError(f"{where}: expected a JSON object, got {type(entry).__name__}")
    for field in ("image", "labels"):
        if not isinstance(entry.get(field), str):
            raise SonarjaxError(f"{where}: {field}: expected a file name")
        path = Path(entry[field])
        if path.is_absolute() or ".." in path.parts:
            raise SonarjaxError(f"{where}: {field}: expected a file inside the folder, got {entry[field]!r}")
    return entry["image"], entry["labels"]


def _read_pair(
    source: Path, image_name: str, labels_name: str, where: str
) -> tuple[Float[np.ndarray, "range beam"], UInt8[np.ndarray, "range beam"]]:
    image, stored = (parse_png(read_bytes(source / n), str(source / n)) for n in (image_name, labels_name))
    if image.shape != stored.shape:
        raise SonarjaxError(f"{where}: image and labels differ in shape: {image.shape} and {stored.shape}")
    labels = np.full(stored.shape, len(STORED), np.uint8)
    for label, grey in enumerate(STORED):
        labels[stored == grey] = label
    if (labels == len(STORED)).any():
        raise SonarjaxError(f"{source / labels_name}: expected grey values 0, 128 and 255 only")
    grey_image = image.astype(np.float32) / np.float32(np.iinfo(image.dtype).max)
    return _fitted(grey_image, labels)


def _fitted(image: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image and labels resampled to the usual size."""
    if image.shape == PATCH:
        return image, labels
    resized = np.asarray(jax.image.resize(image, PATCH, "linear", antialias=True))
    rows, columns = ((np.arange(n) + 0.5) * have / n for n, have in zip(PATCH, labels.shape, strict=True))
    return np.clip(resized, 0.0, 1.0), labels[np.ix_(rows.astype(int), columns.astype(int))]
