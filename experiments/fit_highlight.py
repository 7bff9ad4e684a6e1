"""How readily should a network call a pixel highlight? Maps of drawn frames, by what is added to highlight's logit.

python -m experiments.fit_highlight [--segmenter FILE --added NUMBER --into FILE] [--preset smoke] [--help]

A network that was trained by cross-entropy weighs errors of all pixels alike. Objects are few pixels, so on a device
unlike those of its training it misses much of them and finds little too much. A number added to the logit of a rare
class mends that (Menon et al., Long-tail learning via logit adjustment, 2021). The frames show one object or several,
by usual devices and by more unusual ones; none occurs in a test. With `--into` the number `--added` becomes part of the
last layer's bias, and stands in the weights file's metadata as `highlight_bias`. The shipped network has none: where
walls are in view it then found fewer targets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

import sonarjax as sj
from experiments.common import several
from experiments.common.launch import Report, launch
from experiments.common.metrics import columns
from experiments.common.runs import Job
from experiments.common.several import frames_of, maps_of, scored
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment import GeneratorWeights
from sonarjax.segment.weights import shipped_path

LAYER, HIGHLIGHT = "up15", 1
"""The last layer, and the channel of highlight."""
HEADS = {
    "shown": "objects in a frame", "severity": "severity", "frames": "frames", "bias": "added", **several.HEADS,
}  # fmt: skip
MEAN_HEADS = {"bias": "added", **{name: f"mean {text}" for name, text in several.HEADS.items()}}


@dataclass(frozen=True)
class Settings:
    """What is compared."""

    segmenter: str = ""
    """A weights file whose network has three classes; empty for the shipped one."""
    biases: tuple[float, ...] = (0.0, 0.3, 0.6, 0.9)
    """Numbers added to the logit that training has left."""
    sonars: tuple[str, ...] = ("didson-hf", "aris-3000")
    """Sonars, by the names of their presets."""
    count: int = 64
    """Frames of each kind and sonar; a multiple of 16."""
    most: tuple[int, ...] = (1, 8)
    """Most objects in a frame."""
    severities: tuple[float, ...] = (1.2, 2.0)
    """Severities of the devices [1]."""
    added: float = 0.0
    """The number that `into` is given."""
    into: str = ""
    """A weights file that is given it; empty for none."""


def run(settings: Settings, job: Job) -> Report:
    """A row for each kind of frames and number, and their means.

    Raises SonarjaxError for a network without classes, and for a count of frames that are no full chunks.
    """
    path = settings.segmenter or str(shipped_path())
    arrays, about = read_safetensors(path)
    bias = f"params.{LAYER}.bias"
    if np.shape(arrays.get(bias)) != (3,):
        raise sj.SonarjaxError(f"{path}: {bias}: expected a network with three classes")
    trained = np.asarray(arrays[bias], np.float32) - _only(about.get("highlight_bias", 0.0))
    weights = sj.load_segmenter(path).weights
    kinds = {f"{most} at {severity:g}": (most, severity) for most in settings.most for severity in settings.severities}

    def measure(kind: tuple[int, float]) -> list[dict[str, float]]:
        frames = frames_of(settings.sonars, settings.count, *kind, job.seed)
        return [
            {"frames": len(frames), "bias": one}
            | scored(maps_of(frames, _with_bias(weights, trained + _only(one))), frames)
            for one in settings.biases
        ]

    found = job.map(measure, kinds, "frames")
    rows = [
        {"shown": "1" if most == 1 else f"1 to {most}", "severity": severity} | row
        for name, (most, severity) in kinds.items()
        for row in found[name]
    ]
    means = [
        {"bias": one} | {key: float(np.mean([row[key] for row in rows if row["bias"] == one])) for key in several.HEADS}
        for one in settings.biases
    ]
    if settings.into:
        changed = arrays | {bias: trained + _only(settings.added)}
        write_safetensors(settings.into, changed, about | {"highlight_bias": settings.added})
    return {"rows": rows, "means": means}


def _only(value: float) -> np.ndarray:
    """A value for highlight's logit, zero for the others."""
    return np.float32(value) * np.eye(3, dtype=np.float32)[HIGHLIGHT]


def _with_bias(weights: GeneratorWeights, bias: np.ndarray) -> GeneratorWeights:
    """The network with another bias (class,) in its last layer."""
    params: Any = weights.variables["params"]
    changed = params | {LAYER: params[LAYER] | {"bias": jax.device_put(bias)}}
    return GeneratorWeights(dict(weights.variables) | {"params": changed}, weights.module)


def table(report: Report) -> str:
    """The rows, and the means over the kinds of frames."""
    return f"{columns(report['rows'], HEADS)}\n\n{columns(report['means'], MEAN_HEADS)}"


if __name__ == "__main__":
    small = {"biases": (0.0, 0.9), "sonars": ("didson-hf",), "count": 16, "most": (2,), "severities": (2.0,)}
    launch(run, Settings, table, smoke=small)
