"""The ONNX file against onnxruntime: the same maps as the network in JAX, and a page whose code runs without JAX."""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.data import Box, cut_box
from sonarjax.io.errors import SonarjaxError
from sonarjax.segment import Segmenter, export_onnx, load_segmenter
from sonarjax.segment.classical import from_grey
from sonarjax.segment.generator import Generator
from sonarjax.segment.initial import draw_variables
from sonarjax.segment.onnx_file import onnx_model
from sonarjax.segment.tiled import segment
from sonarjax.segment.weights import GeneratorWeights, save_generator, segment_patch

onnx = pytest.importorskip("onnx", reason="the extra `onnx` is not installed")
onnxruntime = pytest.importorskip("onnxruntime", reason="the runtime that the files are held to is not installed")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "export.md"
TOLERANCE = 1e-4
BOXES = [Box(120.0, 20.0, 180.0, 50.0), Box(0.0, 0.0, 256.0, 64.0), Box(201.3, 33.7, 90.5, 31.2)]


def session_of(path: Path) -> Any:
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def frame() -> np.ndarray:
    """A drawn frame (range, beam) of the paper's target, in noise."""
    sonar = sj.Sonar.preset("didson-hf", tilt=math.radians(20))
    clean = np.asarray(sj.render(sj.objects.target(), sj.Pose(x=2.3, y=0.05, yaw=0.7), sonar).semantic())
    noise = np.random.default_rng(1).normal(0.0, 0.05, clean.shape)
    return np.clip(0.4 + 0.5 * (clean - 0.5) + noise, 0, 1).astype(np.float32)


@pytest.fixture(scope="module")
def crops(frame: np.ndarray) -> np.ndarray:
    """Crops (crop, 128, 128) of the drawn frame: around the object, of floor, and a small one."""
    return np.stack([np.asarray(cut_box(jnp.asarray(frame), box)) for box in BOXES])


BATCHES = (1, 2, 5)


@pytest.fixture(scope="module")
def in_jax(crops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the shipped network makes of the crops in JAX: maps, and shares (crop, class, row, column)."""
    images, weights = jnp.asarray(np.resize(crops, (max(BATCHES), 128, 128))), load_segmenter().weights
    assert weights is not None
    output = jax.jit(weights.module.apply)(weights.variables, 2 * images[..., None] - 1)
    shares = np.asarray(jax.nn.softmax(output, -1)).transpose(0, 3, 1, 2)
    return np.asarray(segment_patch(weights, images)), shares


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("onnx") / "segmenter.onnx"
    export_onnx(path, load_segmenter())
    return path


@pytest.mark.parametrize("batch", BATCHES)
def test_shipped_network_on_crops_of_a_drawn_frame(
    shipped: Path, crops: np.ndarray, in_jax: tuple[np.ndarray, np.ndarray], batch: int
) -> None:
    images = np.resize(crops, (batch, 128, 128))
    semantic, probabilities = session_of(shipped).run(["semantic", "probabilities"], {"image": images})
    wanted, shares = in_jax
    assert (from_grey(wanted[0]) == 1).sum() > 50 and (from_grey(wanted[0]) == 2).sum() > 50  # all classes are there
    assert semantic.shape == images.shape and len(probabilities) == batch
    np.testing.assert_allclose(semantic, wanted[:batch], atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose(probabilities, shares[:batch], atol=TOLERANCE, rtol=0)


def drawn(**options: Any) -> GeneratorWeights:
    """A small network whose normalisation and biases are not those of the first step."""
    network = Generator(4, multipliers=(1, 2, 2, 3, 2, 2, 1), **options)
    variables = draw_variables(network, jnp.zeros((1, 128, 128, 1)), key=jax.random.key(1))
    rng = np.random.default_rng(2)

    def changed(v: jax.Array) -> jax.Array:
        # Kernels larger than at the start: else all maps end near 0, and anything is equal to them.
        return 8 * v if v.ndim > 1 else v + 0.1 * rng.random(v.shape, np.float32)

    return GeneratorWeights(jax.tree.map(changed, variables), network)


@pytest.mark.parametrize(
    "options", [{}, {"head": "classes"}, {"skips": False}, {"inputs": "ranks"}, {"inputs": "ranks", "head": "classes"}]
)
def test_every_kind_of_network(options: dict[str, Any], crops: np.ndarray, tmp_path: Path) -> None:
    weights = drawn(**options)
    export_onnx(tmp_path / "g.onnx", Segmenter("g.safetensors", 0.5, weights))
    session = session_of(tmp_path / "g.onnx")
    wanted = np.asarray(segment_patch(weights, jnp.asarray(crops)))
    assert wanted.std() > 50 * TOLERANCE  # a map that varies
    np.testing.assert_allclose(session.run(["semantic"], {"image": crops})[0], wanted, atol=TOLERANCE, rtol=0)
    outputs = [value.name for value in session.get_outputs()]
    assert outputs == ["semantic", *(["probabilities"] if options.get("head") == "classes" else [])]


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_even_images(shipped: Path, value: float) -> None:
    """Nothing varies: the deviation's divisor is near 0, and all pixels share one level."""
    image = np.full((1, 128, 128), value, np.float32)
    weights = load_segmenter().weights
    assert weights is not None
    found = session_of(shipped).run(["semantic"], {"image": image})[0]
    np.testing.assert_allclose(found, np.asarray(segment_patch(weights, jnp.asarray(image))), atol=TOLERANCE, rtol=0)


def test_metadata_say_what_goes_in_and_out(shipped: Path) -> None:
    about, segmenter = session_of(shipped).get_modelmeta().custom_metadata_map, load_segmenter()
    assert json.loads(about["tile"]) == list(segmenter.tile)
    assert json.loads(about["threshold"]) == segmenter.threshold
    assert json.loads(about["crop"]) == [128, 128]
    assert json.loads(about["labels"]) == ["background", "highlight", "shadow"]
    assert about["segmenter"] == "pix2pix"
    assert "(batch, 128, 128)" in about["input"] and "semantic" in about["output"] and "eq. 5" in about["threshold_is"]


def test_file_is_valid_and_the_same_each_time(shipped: Path, tmp_path: Path) -> None:
    model = onnx.load(shipped)
    onnx.checker.check_model(model, full_check=True)
    assert [(item.domain, item.version) for item in model.opset_import] == [("", 18)]
    assert shipped.stat().st_size < 15e6
    export_onnx(tmp_path / "again.onnx", load_segmenter())
    assert (tmp_path / "again.onnx").read_bytes() == shipped.read_bytes()


@pytest.mark.parametrize("shape", [None, (150, 40)])
def test_code_of_the_page(
    shape: tuple[int, int] | None, shipped: Path, frame: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame as it is, and one smaller than a tile: the same map as the package's, without the closer look."""
    frame = frame if shape is None else np.ascontiguousarray(frame[200 : 200 + shape[0], 20 : 20 + shape[1]])
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert "jax" not in code
    np.save(shipped.with_name("frame.npy"), frame)
    monkeypatch.chdir(shipped.parent)
    names: dict[str, Any] = {}
    exec(compile(code, str(PAGE), "exec"), names)
    weights = load_segmenter().weights
    assert weights is not None
    np.testing.assert_allclose(names["semantic"], np.asarray(segment(frame, weights, closer=0)), atol=TOLERANCE, rtol=0)
    assert set(np.unique(names["labels"])) >= ({0, 1, 2} if shape is None else {0, 2})


@pytest.mark.parametrize("name", ["otsu", "none"])
def test_without_a_network_there_is_nothing_to_export(name: str, tmp_path: Path) -> None:
    with pytest.raises(SonarjaxError, match=f"'{name}' has no network"):
        export_onnx(tmp_path / "f.onnx", load_segmenter(name))
    assert list(tmp_path.iterdir()) == []


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(SonarjaxError, match=r"pip install 'sonarjax\[onnx\]'"):
        onnx_model(load_segmenter())


def test_a_file_whose_name_is_no_utf8_is_exported(tmp_path: Path) -> None:
    export_onnx(tmp_path / "g.onnx", Segmenter("runs/w\udcff.safetensors", 0.5, drawn()))
    assert session_of(tmp_path / "g.onnx").get_modelmeta().custom_metadata_map["segmenter"] == "w?.safetensors"


def test_network_from_a_file_keeps_its_name_and_threshold(tmp_path: Path) -> None:
    path = tmp_path / "own.safetensors"
    save_generator(path, drawn().variables, {"threshold": 0.25, "tile": [100, 50]})
    export_onnx(tmp_path / "own.onnx", load_segmenter(path))
    about = session_of(tmp_path / "own.onnx").get_modelmeta().custom_metadata_map
    assert (about["segmenter"], about["threshold"], about["tile"]) == ("own.safetensors", "0.25", "[100, 50]")
