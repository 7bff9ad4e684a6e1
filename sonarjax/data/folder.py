"""Pairs as a folder of PNG files with a manifest, for other tools, and folders of real pairs in the same form.

`manifest.jsonl` has one JSON object a line: `image` and `labels` name two grey PNGs of one shape beside it. Labels are
stored as grey, 0 shadow, 128 background, 255 highlight, so that people can look at them. What made the pairs
(`number`, `key`, `settings`) stands beside the names where it is known; a reader needs only the names.
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
from sonarjax.data.pairs import Pairs, PairSettings
from sonarjax.io import SonarjaxError, read_bytes, write_png, write_text
from sonarjax.io.files import reason
from sonarjax.io.png import parse_png

MANIFEST = "manifest.jsonl"
STORED = np.array([128, 255, 0], np.uint8)
"""Grey value in a file of background, highlight and shadow."""


def export_pairs(
    pairs: Pairs,
    folder: str | os.PathLike[str],
    *,
    key: Array | None = None,
    settings: PairSettings | None = None,
    first: int = 0,
) -> None:
    """Write pairs as PNGs with a manifest into `folder`, made if missing; `import_pairs` reads them back unchanged.

    `key`, `settings` and `first`, those of `make_pairs`, are kept in the manifest. The manifest is written last: a
    folder with one is complete. Raises SonarjaxError when something cannot be written.
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SonarjaxError(f"{target}: cannot be made a folder: {reason(error)}") from error
    origin: dict[str, Any] = {} if settings is None else {"settings": dataclasses.asdict(settings)}
    if key is not None:
        origin["key"] = np.asarray(jax.random.key_data(key)).tolist()
    with contextlib.suppress(OSError):
        (target / MANIFEST).unlink()  # of an older export
    lines = []
    for index, (image, labels) in enumerate(zip(np.asarray(pairs.image), np.asarray(pairs.labels), strict=True)):
        names = {"image": f"image_{index:05d}.png", "labels": f"labels_{index:05d}.png"}
        write_png(target / names["image"], image)
        write_png(target / names["labels"], STORED[labels])
        lines.append(json.dumps(names | {"number": first + index} | origin))
    write_text(target / MANIFEST, "\n".join(lines) + "\n")


def import_pairs(folder: str | os.PathLike[str]) -> Pairs:
    """The pairs (pair, 128, 128) of a folder that has a manifest, in its order.

    Patches of another size are resampled to 128 × 128 (labels to the nearest). Raises SonarjaxError, naming the line,
    for a manifest or a picture that is missing or cannot be used, and for a label image with other grey values.
    """
    source = Path(folder)
    manifest = source / MANIFEST
    if source.exists() and not source.is_dir():
        raise SonarjaxError(f"{source}: expected a folder of pairs, this is a file")
    text = read_bytes(manifest).decode("utf-8", "replace")
    lines = [(f"{manifest}:{number}", line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise SonarjaxError(f"{manifest}: expected one JSON object a line, it has none")
    pairs = [_read_pair(source, *_names(line, where), where) for where, line in lines]
    return Pairs(*(jnp.asarray(np.stack(part)) for part in zip(*pairs, strict=True)))


def _names(line: str, where: str) -> tuple[str, str]:
    try:
        entry = json.loads(line)
    except ValueError as error:
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
    """Both as patches of the usual size."""
    if image.shape == PATCH:
        return image, labels
    resized = np.asarray(jax.image.resize(image, PATCH, "linear", antialias=True))
    rows, columns = ((np.arange(n) + 0.5) * have / n for n, have in zip(PATCH, labels.shape, strict=True))
    return np.clip(resized, 0.0, 1.0), labels[np.ix_(rows.astype(int), columns.astype(int))]
