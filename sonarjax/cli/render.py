"""`sonarjax render`: simulate the frame of a mesh."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import Any

from sonarjax.cli.arguments import EXITS, PICTURES, add_mesh_options, count, number
from sonarjax.cli.frames import start_jax
from sonarjax.cli.targets import load_mesh
from sonarjax.io import check_ending, check_outputs, complain

MAX_SUB_BEAMS = 64


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser("render", help="simulate the frame of a mesh", epilog=EXITS)
    command.set_defaults(run=run)
    command.add_argument("mesh", metavar="MESH", help="surface in any format that trimesh reads (STL, OBJ, PLY, ...)")
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the sonar and its geometry")
    command.add_argument("--x", metavar="M", required=True, type=number, help="forward position of the mesh [m]")
    command.add_argument("--y", metavar="M", required=True, type=number, help="position of the mesh to port [m]")
    command.add_argument(
        "--yaw-deg", metavar="D", required=True, type=number, help="yaw of the mesh, counter-clockwise from above [deg]"
    )
    command.add_argument(
        "--out", metavar="FRAME.npz", required=True,
        help="output file: image (semantic), intensity, highlight, shadow, labels, azimuth_deg, range_edges_m",
    )  # fmt: skip
    command.add_argument(
        "--png", metavar="P",
        help="picture of polar and fan views with axes, .png, .pdf or .svg (other commands read FRAME.npz, not this)",
    )  # fmt: skip
    add_mesh_options(command)
    command.add_argument(
        "--sub-beams", metavar="N", type=partial(count, high=MAX_SUB_BEAMS),
        help=f"number of parts of a beam in azimuth, 1 to {MAX_SUB_BEAMS} (default: 2)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    check_outputs({"--out": args.out, "--png": args.png}, (args.mesh, args.sonar))
    check_ending("--out", args.out, (".npz",))
    check_ending("--png", args.png, PICTURES)
    start_jax()
    from sonarjax.render import RenderQuality, render, why_unseen, write_frame
    from sonarjax.scene import Pose
    from sonarjax.sonar import Sonar

    sonar = Sonar.from_toml(args.sonar)
    mesh = load_mesh(args.mesh, sonar, args)
    quality = RenderQuality() if args.sub_beams is None else RenderQuality(sub_beams=args.sub_beams)
    pose = Pose(x=args.x, y=args.y, yaw=math.radians(args.yaw_deg))
    frame = render(mesh, pose, sonar, quality=quality)
    write_frame(args.out, frame, sonar)
    if args.png is not None:
        from sonarjax.plot import plot_frame, save_figure

        save_figure(plot_frame(frame, sonar), args.png)
    if not frame.labels().any():
        why = why_unseen(frame, mesh, pose)
        complain(f"{args.mesh}: not to be seen at x {args.x:g} m, y {args.y:g} m: {why}", "note: ")
    return 0
