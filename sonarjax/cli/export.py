"""`sonarjax export`: write the segmenter's network to an ONNX file."""

from __future__ import annotations

import argparse
from typing import Any

from sonarjax.cli.arguments import EXITS
from sonarjax.cli.frames import start_jax
from sonarjax.io import SonarjaxError, check_outputs, say
from sonarjax.segment import DEFAULT_SEGMENTER, SEGMENTERS


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("export", help="write the segmenter's network to an ONNX file", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument(
        "--onnx", metavar="FILE.onnx", required=True,
        help="output file: the network from a 128 x 128 crop to its semantic map; metadata describe input and output",
    )  # fmt: skip
    command.add_argument(
        "--segmenter", metavar="NAME", default=DEFAULT_SEGMENTER,
        help="pix2pix (the shipped network) or a weights.safetensors from training (default: %(default)s)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    check_outputs({"--onnx": args.onnx}, (args.segmenter,))
    if not args.onnx.lower().endswith(".onnx"):
        raise SonarjaxError(f"--onnx: expected a name that ends in .onnx, got {args.onnx!r}")
    if args.segmenter not in SEGMENTERS and not args.segmenter.endswith(".safetensors"):
        raise SonarjaxError(f"--segmenter: expected pix2pix or a .safetensors file, got {args.segmenter!r}")
    start_jax()
    from sonarjax.segment import export_onnx, load_segmenter

    export_onnx(args.onnx, load_segmenter(args.segmenter))
    say(f"{args.onnx}: image (batch, 128, 128) -> semantic (batch, 128, 128)")
    return 0
