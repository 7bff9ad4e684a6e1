"""How fast and how exact eq. 4 is: ours, a loop of OpenCV's matchTemplate and scikit-image's, in the same run.

python experiments/bench_match.py [--templates synthetic|bank] [--smoke]: prints one table; `run` returns its numbers.
OpenCV and scikit-image are the `bench` and core dependencies; a peer that is not installed is left out of the table.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sonarjax.match import match_bank, prepare_bank


@dataclass(frozen=True)
class Settings:
    """What is timed; every field is a command line option."""

    yaws: tuple[int, ...] = (36, 360)
    """Numbers of templates over the full circle."""
    ranges: int = 512
    """Range bins of the frame."""
    beams: int = 96
    """Beams of the frame."""
    height: int = 96
    """Range bins of a template."""
    width: int = 32
    """Beams of a template."""
    repeats: int = 15
    """Rounds; each times every contender once (scikit-image in the first round only)."""
    templates: str = "synthetic"
    """`synthetic`: turned blocks with a shadow; `bank`: sonarjax.template_bank of the paper's target."""
    seed: int = 0
    """Seed of the frame's noise."""
    smoke: bool = False
    """A run of seconds: 36 templates, three rounds."""


def block_templates(count: int, height: int, width: int) -> np.ndarray:
    """Semantic-like templates (yaw, height, width): two turned blocks at 1, shadow 0, edges about a pixel soft.

    A pixel is taken as 5 mm in range and 12 mm across, as a DIDSON has it at 2.4 m.
    """
    along = (np.arange(height) - 0.4 * height)[:, None] * 5.0  # [mm]
    across = (np.arange(width) - 0.5 * (width - 1))[None, :] * 12.0  # [mm]
    templates = np.empty((count, height, width), np.float32)
    for index, yaw in enumerate(np.arange(count) * (2 * np.pi / count)):
        highlight = _blocks(along, across, yaw)
        shadow = np.max([_blocks(along - step, across, yaw) for step in np.arange(10.0, 160.0, 10.0)], axis=0)
        templates[index] = 0.5 * (1 + highlight - shadow * (1 - highlight))
    return templates


def _blocks(along: np.ndarray, across: np.ndarray, yaw: float) -> np.ndarray:
    """Coverage, 0 to 1, of two bricks of 190 x 90 mm, one of them off centre and square to the other."""
    u = np.cos(yaw) * along + np.sin(yaw) * across
    v = np.cos(yaw) * across - np.sin(yaw) * along

    def brick(x: float, y: float, length: float, breadth: float) -> np.ndarray:
        outside = np.maximum(abs(u - x) - length / 2, abs(v - y) - breadth / 2)
        return np.clip(0.5 - outside / 8.0, 0, 1)

    return np.maximum(brick(0, 0, 190, 90), brick(70, 60, 90, 190))


def bank_templates(count: int, settings: Settings) -> np.ndarray:
    """Templates (yaw, h, w) of the package's own bank for the paper's target, on its 512 x 96 frame."""
    from sonarjax.render import template_bank
    from sonarjax.scene.objects import target
    from sonarjax.sonar import Sonar

    sonar = Sonar.preset(
        "didson-hf", tilt=np.deg2rad(20.0), height=0.9, range_min=1.5, range_max=4.0, n_ranges=settings.ranges
    )
    return np.asarray(template_bank(target(), sonar, np.arange(count) * (2 * np.pi / count), x=2.3).templates)


def frame_with(template: np.ndarray, settings: Settings) -> np.ndarray:
    """A semantic frame (range, beam) with `template` in it and noise over it, float32."""
    rng = np.random.default_rng(settings.seed)
    frame = np.full((settings.ranges, settings.beams), 0.5, np.float32)
    row, col = (settings.ranges - template.shape[0]) // 2, (settings.beams - template.shape[1]) // 3
    frame[row : row + template.shape[0], col : col + template.shape[1]] = template
    return frame + rng.normal(0, 0.1, frame.shape).astype(np.float32)


def contenders(frame: np.ndarray, templates: np.ndarray) -> dict[str, Callable[[], np.ndarray]]:
    """Name → function that returns the best score of each template (yaw,)."""
    bank = jax.block_until_ready(prepare_bank(templates, (frame.shape[0], frame.shape[1])))
    image, stack = jnp.asarray(frame), jnp.asarray(templates)
    found: dict[str, Callable[[], np.ndarray]] = {
        "sonarjax, spectra kept": lambda: np.asarray(match_bank(image, bank)),
        "sonarjax, from templates": lambda: np.asarray(match_bank(image, stack)),
    }
    try:
        import cv2

        found["OpenCV loop"] = lambda: np.array(
            [cv2.matchTemplate(frame, t, cv2.TM_CCOEFF_NORMED).max() for t in templates]
        )
    except ImportError:
        pass
    try:
        from skimage.feature import match_template

        found["scikit-image loop"] = lambda: np.array([match_template(frame, t).max() for t in templates])
    except ImportError:
        pass
    return found


def time_all(functions: dict[str, Callable[[], np.ndarray]], repeats: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Median seconds of each function over interleaved rounds, and its last result."""
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    results = {name: function() for name, function in functions.items() if "scikit" not in name}  # warm up, compile
    for round_ in range(repeats):
        for name, function in functions.items():
            if "scikit" in name and round_:
                continue  # ten times slower than the rest: its spread does not matter
            start = time.perf_counter()
            results[name] = function()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(times) for name, times in seconds.items()}, results


def run(settings: Settings) -> dict[str, Any]:
    """Times [s], ratios to ours and largest score differences, one entry for each number of templates."""
    if settings.smoke:
        settings = replace(settings, yaws=(36,), repeats=3)
    report: dict[str, Any] = {"device": jax.devices()[0].platform, "rows": []}
    for count in settings.yaws:
        if settings.templates == "bank":
            templates = bank_templates(count, settings)
        else:
            templates = block_templates(count, settings.height, settings.width)
        seconds, results = time_all(
            contenders(frame_with(templates[count // 3], settings), templates), settings.repeats
        )
        ours = "sonarjax, spectra kept"
        for name, value in seconds.items():
            report["rows"].append(
                {
                    "templates": count,
                    "shape": templates.shape[1:],
                    "name": name,
                    "seconds": value,
                    "ratio": value / seconds[ours],
                    "max_difference": float(abs(results[name] - results[ours]).max()),
                }
            )
    return report


def table(report: dict[str, Any]) -> str:
    """The report as text, one line for each contender."""
    lines = [
        f"{'templates':>9}  {'method':<26} {'ms':>9} {'x ours':>7} {'max |difference|':>17}   ({report['device']})"
    ]
    for row in report["rows"]:
        lines.append(
            f"{row['templates']:>9}  {row['name']:<26} {1e3 * row['seconds']:>9.2f} {row['ratio']:>7.2f}"
            f" {row['max_difference']:>17.1e}"
        )
    return "\n".join(lines)


def parse(arguments: list[str] | None = None) -> Settings:
    """Settings from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    for option in fields(Settings):
        name = "--" + option.name.replace("_", "-")
        if isinstance(option.default, bool):
            parser.add_argument(name, action="store_true")
        elif isinstance(option.default, tuple):
            parser.add_argument(name, type=int, nargs="+", default=option.default)
        elif option.name == "templates":
            parser.add_argument(name, choices=("synthetic", "bank"), default=option.default)
        else:
            parser.add_argument(name, type=type(option.default), default=option.default)
    values = vars(parser.parse_args(arguments))
    return Settings(**{**values, "yaws": tuple(values["yaws"])})


if __name__ == "__main__":
    print(table(run(parse())))
