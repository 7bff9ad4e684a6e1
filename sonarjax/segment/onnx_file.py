"""A segmenter's network as an ONNX file, for users without JAX: a 128 × 128 crop in, its semantic map out.

Only the network is exported. Cutting a frame into crops and joining the answers is left to the user (docs/export.md
shows it in NumPy). The closer look at each object is not exported.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
from typing import Any

from sonarjax.crops import PATCH
from sonarjax.io.atomic import write_atomic
from sonarjax.io.errors import SonarjaxError
from sonarjax.segment.onnx_graph import IR_VERSION, OPSET, Graph, add_generator
from sonarjax.segment.segmenters import Segmenter

CROP_IN = (
    "image: float32 (batch, 128, 128), grey in [0, 1]; axis 1 is range, near to far, axis 2 the beams in ascending "
    "azimuth. A part of a frame, at most `tile` (range bins, beams) large, resampled linearly to 128 x 128"
)
SEMANTIC_OUT = "semantic: float32 (batch, 128, 128), shadow 0, background 0.5, highlight 1"
CLASSES_OUT = "probabilities: float32 (batch, 3, 128, 128) in the order of `labels`"


def export_onnx(path: str | os.PathLike[str], segmenter: Segmenter) -> None:
    """Write a segmenter's network as an ONNX file, all or nothing; the bytes are the same each time.

    The input `image` is (batch, 128, 128) in [0, 1], for any batch size. The output `semantic` is (batch, 128, 128):
    shadow 0, background 0.5, highlight 1. A network with three classes also has the output `probabilities` (batch, 3,
    128, 128) of background, highlight and shadow. The file's metadata repeat this, and hold `tile`, `threshold` and
    `labels`.

    Args:
        path: The file.
        segmenter: A segmenter with a network.

    Raises:
        SonarjaxError: The segmenter has no network, the package `onnx` is missing, or the file cannot be written.
    """
    data = onnx_model(segmenter).SerializeToString(deterministic=True)
    write_atomic(path, lambda file: file.write(data))


def onnx_model(segmenter: Segmenter) -> Any:
    """Make the `onnx.ModelProto` that `export_onnx` writes, checked by `onnx`. Raises the same errors."""
    if segmenter.weights is None:
        raise SonarjaxError(f"segmenter: {segmenter.name!r} has no network: expected pix2pix or a weights file")
    try:
        import onnx
        from onnx import TensorProto, helper
    except ImportError as error:
        raise SonarjaxError("export: the package onnx is not installed: pip install 'sonarjax[onnx]'") from error
    module, graph = segmenter.weights.module, Graph()
    output = add_generator(graph, module, segmenter.weights.variables, "image")
    outputs: dict[str, tuple[Any, ...]] = {"semantic": ("batch", *PATCH)}
    if module.head == "classes":
        _add_classes(graph, output)
        outputs["probabilities"] = ("batch", 3, *PATCH)
    else:
        _add_grey(graph, output)

    def value(name: str, shape: tuple[Any, ...]) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    proto = helper.make_graph(
        graph.nodes, "sonarjax_segmenter", [value("image", ("batch", *PATCH))],
        [value(*item) for item in outputs.items()], graph.constants,
    )  # fmt: skip
    model = helper.make_model(
        proto, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="sonarjax"
    )
    helper.set_model_props(model, _about(segmenter, list(outputs)))
    onnx.checker.check_model(model, full_check=True)
    return model


def _add_classes(graph: Graph, logits: str) -> None:
    """Add the probabilities, and the grey of `generator.to_grey`: probability of highlight minus that of shadow."""
    graph.node("Softmax", logits, axis=1, result="probabilities")
    weights = graph.constant([[[[0.0]], [[0.5]], [[-0.5]]]])
    grey = graph.node("ReduceSum", graph.node("Mul", "probabilities", weights), graph.shape(1), keepdims=0)
    graph.node("Add", grey, 0.5, result="semantic")


def _add_grey(graph: Graph, output: str) -> None:
    """Add the grey in [0, 1] of a single channel."""
    grey = graph.node("Squeeze", graph.node("Tanh", output), graph.shape(1))
    graph.node("Mul", graph.node("Add", grey, 1.0), 0.5, result="semantic")


def _about(segmenter: Segmenter, outputs: list[str]) -> dict[str, str]:
    """The file's metadata: plain text, and JSON where a program will read it."""
    said = [SEMANTIC_OUT, *([CLASSES_OUT] if "probabilities" in outputs else [])]
    name = os.path.basename(segmenter.name).encode("utf-8", "replace").decode()  # a file's name may be no UTF-8
    return {
        "segmenter": name,
        "input": CROP_IN,
        "output": "; ".join(said),
        "crop": json.dumps(PATCH),
        "tile": json.dumps(segmenter.tile),
        "labels": json.dumps(["background", "highlight", "shadow"]),
        "threshold": json.dumps(segmenter.threshold),
        "threshold_is": "least correlation (eq. 5) of a matched template with the semantic map of an identified target",
        "sonarjax": _version(),
    }


def _version() -> str:
    try:
        return importlib.metadata.version("sonarjax")
    except importlib.metadata.PackageNotFoundError:  # run from its sources
        return "unknown"
