"""What commands' arguments have in common: the parser, numbers within limits, help."""

from __future__ import annotations

import argparse
import math
import re
from functools import partial
from typing import Any, NoReturn

from sonarjax.io import complain
from sonarjax.segment import DEFAULT_SEGMENTER, SEGMENTERS

FRAME_HELP = (
    ".npz (image, mask), .npy, .png, a recording .aris/.ddf/.raw/.oculus or a ROS bag .bag/.mcap/.db3 "
    "(all frames, or FILE:N for frame N, from 0; in a bag FILE:TOPIC:N)"
)
PICTURES = (".png", ".pdf", ".svg")
"""Endings of the pictures that `--png` may name: `save_figure` writes these formats."""
EXITS = "exit codes: 0 done; 1 a frame could not be read or used; 2 arguments, mesh, TOML or output could not be used"


class Parser(argparse.ArgumentParser):
    """argparse with one line for an error, and numbers such as -1e-3 taken as numbers."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        complain(f"{self.prog.removeprefix('sonarjax').strip()}: {message} (see {self.prog} --help)".lstrip(": "))
        raise SystemExit(2)


def add_mesh_options(command: argparse.ArgumentParser) -> None:
    """Add how the command's mesh files are read: `--unit-m`, `--stand` and `--mesh-tolerance`."""
    command.add_argument("--unit-m", metavar="M", type=number, help="the mesh file's unit [m], such as 0.001 for mm")
    command.add_argument("--stand", action="store_true", help="move the mesh to its origin and onto the floor")
    command.add_argument(
        "--mesh-tolerance", metavar="M", type=partial(limited, low=0.0, high=1.0),
        help="how far [m] the surface of a very fine mesh may move when its triangles are reduced (default: less than "
        "the sonar resolves; 0: do not reduce it)",
    )  # fmt: skip


def add_segmenter_option(command: argparse.ArgumentParser, what_none_does: str) -> None:
    """Add `--segmenter`; `what_none_does` tells what the command makes of a frame that is not segmented."""
    command.add_argument(
        "--segmenter", metavar="NAME", default=DEFAULT_SEGMENTER,
        help=f"{', '.join(SEGMENTERS)}; or a weights.safetensors from training; none {what_none_does} "
        "(default: %(default)s)",
    )  # fmt: skip


def number(text: str) -> float:
    """A length or an angle. Raises argparse.ArgumentTypeError, as all these types do, for anything else."""
    return limited(text, -1e6, 1e6)


def correlation(text: str) -> float:
    """A number from -1 to 1."""
    return limited(text, -1.0, 1.0)


def count(text: str, high: int = 65536, low: int = 1) -> int:
    """A whole number from `low` to `high`."""
    value = limited(text, float(low), float(high))
    if value != int(value):
        raise argparse.ArgumentTypeError(f"expected a whole number, got {text!r}")
    return int(value)


def limited(text: str, low: float, high: float) -> float:
    """A number from `low` to `high`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"expected a number from {low:g} to {high:g}, got {text!r}")
    return value
