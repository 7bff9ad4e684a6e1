"""A description of a file, as text: what `sonarjax info FILE` prints."""

from __future__ import annotations

import os
from typing import Any

from sonarjax.io.errors import SonarjaxError
from sonarjax.io.files import read_bytes
from sonarjax.io.frame import Frame
from sonarjax.io.load import iter_frames, split_spec
from sonarjax.io.npy import NpzArchive
from sonarjax.io.safetensors import read_safetensors
from sonarjax.io.toml import read_toml


def describe(spec: str | os.PathLike[str]) -> str:
    """Describe a frame file, sonar recording, `sonar.toml` or weights file as text.

    Of a recording, the first frame is described, or frame N of `path:N`. Of weights, the text says how they were
    trained. Of an NPZ without a frame, it lists the arrays.

    Args:
        spec: Path of the file, or the name of a frame as for `read_frames`.

    Returns:
        Lines of a name and its value, in two columns.

    Raises:
        SonarjaxError: The file cannot be read.
    """
    path, index, _ = split_spec(spec)
    ending = os.path.splitext(path)[1].lower()
    if ending == ".toml":
        return _text({"file": path, "format": "TOML", **_tables(read_toml(path))})
    if ending == ".safetensors":
        arrays, about = read_safetensors(path)
        held = f"{len(arrays)}, together {sum(array.size for array in arrays.values())} numbers"
        return _text({"file": path, "format": "safetensors", "arrays": held, **_tables(about)})
    if ending != ".npz":
        return _text(_first(spec, path, index))
    listed = _arrays(NpzArchive(read_bytes(path), path))
    if "array image" not in listed:  # labels or a template bank: the arrays are still worth listing
        return _text({"file": path, "format": "NPZ without a frame", **listed})
    return _text({**_first(spec, path, index), **listed})


def _first(spec: str | os.PathLike[str], path: str, index: int | None) -> dict[str, Any]:
    frame = next(iter_frames(spec), None)
    if frame is None:
        raise SonarjaxError(f"{os.fspath(spec)}: expected a frame, the file gives none")
    inside = [entry.path for entry in os.scandir(path)] if os.path.isdir(path) else [path]  # the folder of a bag
    size = sum(os.path.getsize(file) for file in inside)
    return {"file": path, "size": f"{size} bytes", "frame": index or 0, **_frame(frame)}


def _frame(frame: Frame) -> dict[str, Any]:
    image = frame.image
    measured = image if frame.mask is None else image[frame.mask]
    lines: dict[str, Any] = {
        "image": f"{image.shape[0]} range bins x {image.shape[1]} beams, "
        f"values {measured.min():.3f} to {measured.max():.3f}, mean {measured.mean():.3f}",
        "mask": "none" if frame.mask is None else f"{frame.mask.mean():.1%} of the pixels measured",
    }
    return lines | (_geometry(frame.geometry) if frame.geometry else {"geometry": "not in the file"}) | frame.meta


def _geometry(geometry: dict[str, Any]) -> dict[str, Any]:
    azimuth = geometry["azimuth_deg"]
    shown = {key: value for key, value in geometry.items() if key != "azimuth_deg"}
    return {"azimuth_deg": f"{len(azimuth)} beams, {azimuth[0]:.3f} to {azimuth[-1]:.3f}", **shown}


def _arrays(archive: NpzArchive) -> dict[str, Any]:
    return {f"array {' '.join(key.split())}": _array(archive, key) for key in archive.keys}


def _array(archive: NpzArchive, key: str) -> str:
    try:
        header = archive.header(key)
    except SonarjaxError as error:
        return str(error).removeprefix(f"{archive.name}: {key}: ")
    return f"{header.dtype} {header.shape}"


def _tables(document: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested tables to dotted keys."""
    lines: dict[str, Any] = {}
    for key, value in document.items():
        if isinstance(value, dict):
            lines |= _tables(value, f"{prefix}{key}.")
        else:
            lines[prefix + key] = value
    return lines


def _text(lines: dict[str, Any]) -> str:
    width = max(len(key) for key in lines)
    return "\n".join(f"{key:<{width}}  {_value(value)}" for key, value in lines.items())


def _value(value: Any) -> str:
    if isinstance(value, list) and len(value) > 6:
        return f"{len(value)} values, {_value(value[0])} to {_value(value[-1])}"
    return f"{value:.6g}" if isinstance(value, float) else " ".join(str(value).split())
