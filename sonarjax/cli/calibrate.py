"""`sonarjax calibrate`: fit the sonar's geometry to frames of a known object."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from sonarjax.cli.arguments import EXITS, FRAME_HELP, PICTURES, add_mesh_options
from sonarjax.cli.frames import frames_for, start_jax
from sonarjax.cli.targets import load_mesh
from sonarjax.io import check_ending, check_outputs, complain, naming, say


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser(
        "calibrate", help="fit the sonar's geometry to frames of a known object", epilog=EXITS
    )
    command.set_defaults(run=run)
    command.add_argument("frames", metavar="FRAME", nargs="+", help=FRAME_HELP)
    command.add_argument("--target", metavar="MESH", required=True, help="the object in the frames, at unknown poses")
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the nominal sonar, where the fit starts")
    command.add_argument("--out", metavar="FITTED.toml", required=True, help="output file: the fitted sonar")
    command.add_argument(
        "--free", metavar="NAMES", default="tilt,height", type=lambda text: tuple(text.split(",")),
        help="what to fit, separated by commas: tilt, roll, height, elevation_aperture, range_offset, range_scale, "
        "azimuth_scale, beam_bend, beam_skew or highlight_max_incidence (default: %(default)s)",
    )  # fmt: skip
    command.add_argument("--present", action="store_true", help="every frame shows the target, so use all of them")
    command.add_argument(
        "--png", metavar="P", help="picture of some frames, before and after the fit, .png, .pdf or .svg"
    )
    add_mesh_options(command)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code: 1 if a frame was left out because it could not be used.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    check_outputs({"--out": args.out, "--png": args.png}, (*args.frames, args.target, args.sonar))
    check_ending("--png", args.png, PICTURES)
    start_jax()
    from sonarjax.calibrate import calibrate, check_free, compare_templates, describe_calibration
    from sonarjax.cpu import usual_engine
    from sonarjax.sonar import Sonar

    check_free(args.free)
    sonar = Sonar.from_toml(args.sonar)
    mesh = load_mesh(args.target, sonar, args, above_floor=True)
    frames, code = [], 0
    for name, frame in frames_for(sonar, args.frames, args.sonar):
        if isinstance(frame, Exception):
            complain(naming(name, frame))
            code = 1
        else:
            frames.append(frame)
    if not frames:
        return code
    images, masks = [frame.image for frame in frames], [frame.mask for frame in frames]
    found = calibrate(
        images, mesh, sonar, free=args.free, masks=masks, present=args.present, engine=usual_engine(),
        progress=partial(complain, kind=""),
    )  # fmt: skip
    try:  # the fit took minutes: said before a file may fail, and written even if stdout fails
        say(describe_calibration(found, sonar, [frame.source for frame in frames]))
    finally:
        found.sonar.to_toml(args.out)
        if args.png is not None:
            from sonarjax.plot import plot_calibration, save_figure

            save_figure(plot_calibration(*compare_templates(found, images, mesh, sonar), sonar), args.png)
    return code
