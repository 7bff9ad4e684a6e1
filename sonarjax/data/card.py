"""Write the card (README.md) of a data set: its contents, how it was made, and a contact sheet of its first frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from sonarjax.data.formats import CLASSES, Axes, Item, png_bytes
from sonarjax.data.frames import CHUNK

SHOWN, ACROSS = 8, 4
"""Number of frames on the contact sheet, and number of frames in a row."""
LEAST_PIXELS = 256
"""A picture is enlarged by whole factors until each side has at least this many pixels."""
COLORS = np.array(
    [[230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178], [213, 94, 0], [204, 121, 167]]
)
"""Colours given to the objects in turn, from the palette of Okabe and Ito, which colour-blind people can tell apart."""
SHADE = 0.45
"""Brightness of an object's shadow, as a share of that of its highlight."""
UNSTATED = "none was named for this data set; the licence of each mesh still applies to the frames that show it"
CONTENTS = {
    "png": "`images/` holds the frames. `labels/` holds their label maps: 0 shadow, 128 background, 255 highlight. "
    "`instances/` says which object a pixel belongs to: 0 background, k the highlight or shadow of object k",
    "npz": "`frames/` holds an NPZ file for each frame: `image`, `labels` (0 background, 1 highlight, 2 shadow), "
    "`instances`, `highlight_masks` and `shadow_masks` (object, range, beam), `boxes` (object, "
    "highlight and shadow, 4), `mesh`, `pose` (x [m], y [m], yaw [rad]), `azimuth_deg`, `range_edges_m`",
    "coco": "`images/` holds the frames. `annotations.json` is in COCO's format, with one annotation for an object's "
    "highlight and one for its shadow: box and mask (run lengths). Both have the object's number as `instance`",
    "yolo": "`images/` holds the frames. `labels/` has a text file for each frame, with one line for each box: "
    "category, then centre and size as shares of the image. `data.yaml` names the categories. The frames "
    "are not split: `train` and `val` name the same folder until you change that",
}


class Summary:
    """Counts and value ranges over all frames, which are added one by one."""

    def __init__(self) -> None:
        """Start without any frame."""
        self.frames = 0
        self.objects: dict[str, dict[str, int]] = {}
        self.in_frame: dict[int, int] = {}
        self.ranges: dict[str, list[float]] = {}

    def add(self, line: dict[str, Any]) -> None:
        """Add one frame, given its record from the manifest."""
        self.frames += 1
        count = len(line["objects"])
        self.in_frame[count] = self.in_frame.get(count, 0) + 1
        for entry in line["objects"]:
            own = self.objects.setdefault(entry["mesh"], {"placed": 0} | dict.fromkeys(CLASSES, 0))
            own["placed"] += 1
            for name in CLASSES:
                own[name] += entry[name]["box"] is not None
            for name in ("x_m", "y_m", "yaw_deg"):
                self._reach(name, entry[name])
        for name, value in line["sensor"].items():
            self._reach(name, value)

    def _reach(self, name: str, value: float) -> None:
        reach = self.ranges.setdefault(name, [value, value])
        reach[0], reach[1] = min(reach[0], value), max(reach[1], value)


def summarised(lines: Iterable[dict[str, Any]]) -> Summary:
    """Counts and value ranges over the frames whose records in the manifest are `lines`."""
    summary = Summary()
    for line in lines:
        summary.add(line)
    return summary


def card_text(facts: dict[str, Any], summary: Summary, axes: Axes) -> str:
    """Text of a data set's README.md; `facts` is the content of its settings file."""
    settings = facts["settings"]
    shape = len(axes.range_edges_m) - 1, len(axes.azimuth_deg)
    counts = [
        f"| {name} | {own['placed']} | {own['highlight']} | {own['shadow']} |"
        for name, own in sorted(summary.objects.items())
    ]
    numbers = ", ".join(f"{frames} with {count}" for count, frames in sorted(summary.in_frame.items()))
    reached = [f"| {name} | {low:.4g} | {high:.4g} |" for name, (low, high) in summary.ranges.items()]
    made = [
        f"- Key {facts['key']}, {settings['sensor']} sensor at severity {settings['severity']:g}, up to "
        f"{settings['scenes']} objects in a frame, {settings['quality']['sub_beams']} sub-beams in a "
        f"beam, {settings['quality']['elevations']} elevation cells.",
        *(f"- Mesh {one['name']}: {one['triangles']} triangles, SHA-256 starts with {one['sha256']}." for one in
          facts["meshes"]),
        "- The sonar is in `sonar.toml`; each frame's objects, poses, boxes and sensor parameters are in "
        "`manifest.jsonl`.",
    ]  # fmt: skip
    return "\n".join([
        "# Simulated sonar frames", "",
        f"{summary.frames} frames of {shape[0]} range bins by {shape[1]} beams ({numbers} objects), format "
        f"{facts['format']}. Made by `sonarjax dataset`: all of them are simulated.", "",
        "![The first frames and their objects](contact_sheet.png)", "",
        "Each frame is shown twice. In the second picture each object has a colour: bright for its highlight, dark for "
        "its shadow.", "",
        f"Licence: {facts['license'] or UNSTATED}.", "",
        "## Files", "", CONTENTS[facts["format"]] + ".", "",
        "Row 0 is the nearest range bin, column 0 the starboard-most beam. A pixel has the class that covers most of "
        "it, and belongs to the object with the largest share of that class. Floor outside the vertical aperture is "
        "background. Boxes are [left, top, width, height] in pixels.", "",
        "## Counts", "", "| mesh | placed | highlight seen | shadow seen |", "| --- | --- | --- | --- |", *counts, "",
        "## Settings", "", *made, "",
        "## Ranges", "", "Smallest and largest value over all frames: poses, then fields of the sensor model.", "",
        "| what | smallest | largest |", "| --- | --- | --- |", *reached, "",
        "With the same meshes, sonar and settings, frame k depends only on the key and on k. Frames are made in chunks "
        f"of {CHUNK}; `parts/` keeps the manifest lines of each chunk.", "",
    ])  # fmt: skip


def contact_sheet(items: Sequence[Item]) -> bytes:
    """PNG of up to `SHOWN` frames, each beside a copy with coloured objects; near ranges at the bottom, port left."""
    tiles = [_tile(item) for item in items[:SHOWN]]
    blank = np.full_like(tiles[0], 255)
    tiles += [blank] * (-len(tiles) % min(ACROSS, len(tiles)))
    across = min(ACROSS, len(tiles))
    sheet = np.vstack([np.hstack(tiles[k : k + across]) for k in range(0, len(tiles), across)])
    return png_bytes(sheet)


def _tile(item: Item) -> UInt8[np.ndarray, "row column 3"]:
    """A frame and its copy with coloured objects, side by side, each with a white margin."""
    grey = np.repeat(item.image[..., None], 3, axis=2)
    colour = COLORS[(item.instances.astype(int) - 1) % len(COLORS)]
    shade = np.where(item.labels == 2, SHADE, 1.0)[..., None]
    shown = np.where((item.instances > 0)[..., None], colour * shade, grey).astype(np.uint8)
    scale = [max(1, -(-LEAST_PIXELS // side)) for side in grey.shape[:2]]
    parts = [np.kron(part[::-1, ::-1], np.ones((*scale, 1), np.uint8)) for part in (grey, shown)]
    return np.hstack([np.pad(part, ((3, 3), (3, 3), (0, 0)), constant_values=255) for part in parts])
