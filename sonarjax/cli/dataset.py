"""`sonarjax dataset`: simulate frames with labels, instance masks, boxes and poses, in common data set formats."""

from __future__ import annotations

import argparse
import re
import sys
from functools import partial
from typing import Any

from sonarjax.cli.arguments import add_mesh_options, count, limited
from sonarjax.cli.frames import CLUSTER_HELP, engine_of, start_jax
from sonarjax.cli.targets import MESH_ENDINGS, load_mesh, mesh_files
from sonarjax.data import FORMATS, SENSORS
from sonarjax.io import say


def add(commands: Any) -> None:
    """Add this command and its arguments to `commands`, the subparsers of the command line."""
    command = commands.add_parser(
        "dataset", help="simulate frames with masks, boxes and poses",
        epilog="the same command continues an interrupted run; exit codes: 0 done; 2 input could not be used",
    )  # fmt: skip
    command.set_defaults(run=run)
    command.add_argument(
        "meshes", metavar="MESH", nargs="+",
        help="mesh files that trimesh reads, or folders of them: of a folder, its "
        f"{', '.join(MESH_ENDINGS[:-1])} and {MESH_ENDINGS[-1]} files; names must differ",
    )  # fmt: skip
    command.add_argument("--sonar", metavar="S.toml", required=True, help="the sonar and its geometry")
    command.add_argument(
        "--count", metavar="N", required=True, type=partial(count, high=2**31), help="number of frames"
    )
    command.add_argument("--out", metavar="DIR", required=True, help="output folder; its README.md describes the set")
    command.add_argument("--format", choices=FORMATS, default="png", help="file format (default: %(default)s)")
    command.add_argument(
        "--scenes", metavar="K", type=partial(count, high=32), default=1, help="1 to K objects per frame (default: 1)"
    )
    command.add_argument(
        "--sensor", choices=SENSORS, default="drawn",
        help="nominal: one device; drawn: a new one for each frame; wide: from wider ranges (default: %(default)s)",
    )  # fmt: skip
    command.add_argument(
        "--severity", metavar="S", type=partial(limited, low=0.0, high=10.0), default=1.0,
        help="noise: 0 is none, 1 as hard as the paper's frames (default: 1)",
    )  # fmt: skip
    command.add_argument(
        "--seed", metavar="S", type=partial(count, low=0, high=2**31), default=0, help="random seed (default: 0)"
    )
    command.add_argument(
        "--shard", metavar="I/N", type=_shard, default=(1, 1), help="make part I of N; all parts share one --out"
    )
    command.add_argument("--license", metavar="TEXT", default="", help="licence to name in the data set's README.md")
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
    say(f"{args.out}: {args.count} frames" if complete else f"{args.out}: this shard is done, others are missing")
    return 0
