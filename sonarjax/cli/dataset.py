"""`sonarjax dataset`: simulate frames with labels, instance masks, boxes and poses, in common data set formats."""

from __future__ import annotations

import argparse
import re
import sys
from functools import partial
from typing import Any

from sonarjax.cli.arguments import add_mesh_options, count, limited
from sonarjax.cli.frames import CLUSTER_HELP, engine_of, start_jax
from sonarjax.cli.targets import load_mesh, mesh_files
from sonarjax.data import FORMATS, SENSORS
from sonarjax.io import say


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser(
        "dataset", help="simulated frames with masks, boxes and poses",
        epilog="the same command goes on where a run was cut off; exit codes: 0 done; 2 input that cannot be used",
    )  # fmt: skip
    command.set_defaults(run=run)
    command.add_argument(
        "meshes", metavar="MESH", nargs="+", help="surfaces that trimesh reads, or folders of them; a name each"
    )
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the sonar and its geometry")
    command.add_argument(
        "--count", metavar="N", required=True, type=partial(count, high=2**31), help="number of frames"
    )
    command.add_argument("--out", metavar="DIR", required=True, help="folder, made if missing; README.md describes it")
    command.add_argument("--format", choices=FORMATS, default="png", help="default: %(default)s")
    command.add_argument(
        "--scenes", metavar="K", type=partial(count, high=32), default=1, help="1 to K objects a frame (default: 1)"
    )
    command.add_argument(
        "--sensor", choices=SENSORS, default="drawn",
        help="one device, one drawn for each frame, or drawn from wider ranges (default: %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--severity", metavar="S", type=partial(limited, low=0.0, high=10.0), default=1.0,
        help="noise: 0 none, 1 as hard as the paper's frames (default)",
    )  # fmt: skip
    command.add_argument("--seed", metavar="S", type=partial(count, low=0, high=2**31), default=0, help="default: 0")
    command.add_argument(
        "--shard", metavar="I/N", type=_shard, default=(1, 1), help="make part I of N; all go to the same folder"
    )
    command.add_argument("--license", metavar="TEXT", default="", help="licence line of the data set's README.md")
    command.add_argument("--cluster", metavar="WHERE", help=CLUSTER_HELP)
    add_mesh_options(command)


def _shard(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9][0-9]{0,6})/([1-9][0-9]{0,6})", text)
    if match is None or int(match[1]) > int(match[2]):
        raise argparse.ArgumentTypeError(f"expected I/N with I from 1 to N, such as 2/8, got {text!r}")
    return int(match[1]), int(match[2])


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code.

    Raises:
        SonarjaxError: The input cannot be used.
    """
    start_jax()
    import jax
    from tqdm import tqdm

    from sonarjax.data import FrameSettings, make_dataset
    from sonarjax.sonar import Sonar

    sonar = Sonar.from_toml(args.sonar)
    meshes = {name: load_mesh(path, sonar, args) for name, path in mesh_files(args.meshes, "MESH").items()}
    settings = FrameSettings(args.scenes, args.sensor, args.severity)
    with (
        engine_of(args.cluster) as engine,
        tqdm(total=args.count, unit="frame", file=sys.stderr, disable=not sys.stderr.isatty()) as bar,
    ):
        complete = make_dataset(
            meshes, sonar, args.out, args.count, key=jax.random.key(args.seed), format=args.format,
            settings=settings, shard=args.shard, license=args.license, engine=engine, progress=bar.update,
        )  # fmt: skip
    say(f"{args.out}: {args.count} frames" if complete else f"{args.out}: shard done, others are missing")
    return 0
