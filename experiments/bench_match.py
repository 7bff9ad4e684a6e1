"""How fast and how exact is eq. 4? Ours, a loop of OpenCV's matchTemplate and scikit-image's, in the same run.

python -m experiments.bench_match [--preset smoke] [--help]

OpenCV is of the extras `bench` and `test`; --no-peer does without it. scikit-image the project needs anyway.
"""

from __future__ import annotations

import importlib.util
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common.engine import engine
from experiments.common.launch import Report, Skipped, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from sonarjax.match import low_rank_bank, match_bank, match_low_rank, prepare_bank, scores_at

OURS, OPENCV, SKIMAGE = "sonarjax, spectra kept", "OpenCV loop", "scikit-image loop"
LOW_RANK = "sonarjax, low rank"


def has(module: str) -> bool:
    """Whether a peer's module is installed."""
    return importlib.util.find_spec(module) is not None


SMOKE = {"yaws": (36,), "repeats": 3, "peer": has("cv2")}


@dataclass(frozen=True)
class Settings:
    """What is timed."""

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
    templates: Literal["synthetic", "bank"] = "synthetic"
    """`synthetic`: turned blocks with a shadow; `bank`: sonarjax.template_bank of the paper's target."""
    rank: int = 48
    """Components of the bank of low rank; only banks of four times as many templates are matched by them."""
    peer: bool = True
    """Time OpenCV too."""


def need(module: str, package: str) -> None:
    """Raise Skipped, saying what to install, when the peer's `module` is not there."""
    if not has(module):
        raise Skipped(f"{package} is not installed: install it, or time ours without it by --no-peer")


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
    yaws = np.arange(count) * (2 * np.pi / count)
    return np.asarray(template_bank(target(), sonar, yaws, x=2.3, engine=engine()).templates)


def frame_with(template: np.ndarray, settings: Settings, seed: int) -> np.ndarray:
    """A semantic frame (range, beam) with `template` in it and noise over it, float32."""
    rng = np.random.default_rng(seed)
    frame = np.full((settings.ranges, settings.beams), 0.5, np.float32)
    row, col = (settings.ranges - template.shape[0]) // 2, (settings.beams - template.shape[1]) // 3
    frame[row : row + template.shape[0], col : col + template.shape[1]] = template
    return frame + rng.normal(0, 0.1, frame.shape).astype(np.float32)


def contenders(frame: np.ndarray, templates: np.ndarray, peer: bool, rank: int) -> dict[str, Callable[[], np.ndarray]]:
    """Name → function that returns the best score of each template (yaw,)."""
    from skimage.feature import match_template

    bank = jax.block_until_ready(prepare_bank(templates, (frame.shape[0], frame.shape[1])))
    image, stack = jnp.asarray(frame), jnp.asarray(templates)
    found: dict[str, Callable[[], np.ndarray]] = {
        OURS: lambda: np.asarray(match_bank(image, bank)),
        "sonarjax, from templates": lambda: np.asarray(match_bank(image, stack)),
    }
    if len(templates) >= 4 * rank:
        few = jax.block_until_ready(low_rank_bank(templates, image.shape, rank))
        found[LOW_RANK] = lambda: np.asarray(scores_at(image, stack, match_low_rank(image, few)))
    if peer:
        import cv2

        found[OPENCV] = lambda: np.array([cv2.matchTemplate(frame, t, cv2.TM_CCOEFF_NORMED).max() for t in templates])
    return found | {SKIMAGE: lambda: np.array([match_template(frame, t).max() for t in templates])}


def time_all(functions: dict[str, Callable[[], np.ndarray]], repeats: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Median seconds of each function over interleaved rounds, and its last result."""
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    results = {name: function() for name, function in functions.items() if name != SKIMAGE}  # warm up, compile
    for round_ in range(repeats):
        for name, function in functions.items():
            if name == SKIMAGE and round_:
                continue  # ten times slower than the rest: its spread does not matter
            start = time.perf_counter()
            results[name] = function()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(times) for name, times in seconds.items()}, results


def run(settings: Settings, job: Job) -> Report:
    """Times [ms], ratios to ours and largest score differences, one row for each number of templates and contender."""
    if settings.peer:
        need("cv2", "OpenCV")
    cases = {f"{count} templates": count for count in settings.yaws}
    found = job.map(lambda count: compare(count, settings, job.seed), cases, "match")
    return {"platform": jax.devices()[0].platform, "rows": [row for rows in found.values() for row in rows]}


def compare(count: int, settings: Settings, seed: int) -> list[dict[str, Any]]:
    """One row for each contender, with `count` templates."""
    if settings.templates == "bank":
        templates = bank_templates(count, settings)
    else:
        templates = block_templates(count, settings.height, settings.width)
    frame = frame_with(templates[count // 3], settings, seed)
    seconds, results = time_all(contenders(frame, templates, settings.peer, settings.rank), settings.repeats)
    bound = {}
    if LOW_RANK in seconds:
        few = low_rank_bank(templates, (settings.ranges, settings.beams), settings.rank)
        bound[LOW_RANK] = float(few.residual.max())
    return [
        {
            "templates": count,
            "shape": templates.shape[1:],
            "name": name,
            "milliseconds": 1e3 * value,
            "ratio": value / seconds[OURS],
            "faster": seconds[OPENCV] / value if settings.peer else None,
            "bound": bound.get(name),
            "max_difference": float(abs(results[name] - results[OURS]).max()),
        }
        for name, value in seconds.items()
    ]


def table(report: Report) -> str:
    """One line for each contender."""
    heads = {"templates": "templates", "name": "method", "milliseconds": "ms", "faster": "times as fast as OpenCV"}
    shown = [row | {"largest": f"{row['max_difference']:.1e}"} for row in report["rows"]]
    heads |= {
        "largest": f"largest difference of scores ({report['platform']})",
        "bound": "bound of it before `scores_at`",
    }
    return columns(shown, heads)


if __name__ == "__main__":
    launch(run, Settings, table, smoke=SMOKE)
