"""What `fit_highlight` does to the last layer, and that a file keeps what training left."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np
import pytest

import sonarjax as sj
from experiments import fit_highlight
from experiments.common.runs import Job
from sonarjax.io.safetensors import read_safetensors, write_safetensors
from sonarjax.segment.weights import shipped_path

LAYER = f"params.{fit_highlight.LAYER}.bias"


def biases_seen(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The biases with which maps are made."""
    seen: list[np.ndarray] = []

    def scored(maps: np.ndarray, frames: object) -> dict[str, float]:
        return {"iou": 0.5, "precision": 1.0, "recall": 1.0, "hit": 1.0}

    def maps_of(frames: object, weights: sj.segment.GeneratorWeights) -> np.ndarray:
        seen.append(np.asarray(weights.variables["params"][fit_highlight.LAYER]["bias"]))
        return seen[-1]

    monkeypatch.setattr(fit_highlight, "frames_of", lambda *_: [0])
    monkeypatch.setattr(fit_highlight, "maps_of", maps_of)
    monkeypatch.setattr(fit_highlight, "scored", scored)
    return seen


def trained() -> np.ndarray:
    arrays, about = read_safetensors(shipped_path())
    return arrays[LAYER] - np.float32([0, about.get("highlight_bias", 0.0), 0])


def test_the_number_added_goes_into_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second fit, of that file, starts from what training left: it finds the same."""
    arrays, about = read_safetensors(shipped_path())
    path, first = tmp_path / "weights.safetensors", shipped_path()
    for segmenter in (first, path):
        seen = biases_seen(monkeypatch)
        settings = fit_highlight.Settings(
            str(segmenter), (0.0, 0.6), most=(1,), severities=(2.0,), added=0.6, into=str(path)
        )
        report = fit_highlight.run(settings, Job(tmp_path / segmenter.stem, 0))
        np.testing.assert_allclose(seen, [trained(), trained() + np.float32([0, 0.6, 0])], atol=1e-6)
        assert [row["bias"] for row in report["means"]] == [0.0, 0.6]
        found, said = read_safetensors(path)
        np.testing.assert_allclose(found[LAYER], trained() + np.float32([0, 0.6, 0]), atol=1e-6)
        assert said == about | {"highlight_bias": 0.6}
        assert all((found[name] == arrays[name]).all() for name in arrays if name != LAYER)


def test_a_network_without_classes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "grey.safetensors"
    write_safetensors(path, {LAYER: np.zeros(1, np.float32)}, {})
    with pytest.raises(sj.SonarjaxError, match="grey.safetensors: params.up15.bias: expected a network with three"):
        fit_highlight.run(fit_highlight.Settings(str(path)), Job(tmp_path, 0))


def test_more_bias_is_more_highlight() -> None:
    """In the network itself, where the bias is added before the softmax."""
    weights = sj.load_segmenter().weights
    image = np.random.default_rng(0).uniform(0, 1, (128, 128)).astype(np.float32)
    maps = [
        np.asarray(jax.jit(sj.segment)(image, fit_highlight._with_bias(weights, trained() + np.float32([0, more, 0]))))
        for more in (0.0, 3.0)
    ]
    assert (maps[1] > 0.75).mean() > (maps[0] > 0.75).mean()
