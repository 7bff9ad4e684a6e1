"""The generator as a graph of ONNX operators, one node for each layer, which any ONNX runtime can run.

Translating the traced JAX program would be simpler, but jax2onnx 0.17 refuses the histogram of `inputs.ranks` and pins
an older orbax-checkpoint than training needs. The network has only fifteen layers, so they are written out here. Maps
are channels-first, as ONNX has them. Operators are those of opset 18 (2022), which onnxruntime 1.14 and later run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sonarjax.segment.generator import Generator
from sonarjax.segment.inputs import LEVELS, SPREAD, Inputs
from sonarjax.segment.normalise import EPSILON

OPSET = 18
"""Version of ONNX's operators."""
IR_VERSION = 8
"""Version of ONNX's file format that belongs to this opset; older runtimes refuse a newer one."""


class Graph:
    """A growing list of nodes and constants. Every value is referred to by its name."""

    def __init__(self) -> None:
        """Start with an empty graph."""
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        """Add an array of any shape; return its name."""
        from onnx import numpy_helper

        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, dtype), name))
        return name

    def node(self, operator: str, *inputs: Any, result: str | None = None, **attributes: Any) -> str:
        """Add an operator and return the name of its result, `result` if given. Inputs that are not names
        become constants.
        """
        from onnx import helper

        name = result or f"{operator.lower()}{len(self.nodes)}"
        names = [v if isinstance(v, str) else self.constant(v) for v in inputs]
        self.nodes.append(helper.make_node(operator, names, [name], **attributes))
        return name

    def cast(self, value: str, dtype: Any) -> str:
        """Add a change of type; return the name of its result."""
        from onnx import helper

        name = f"cast{len(self.nodes)}"
        to = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        self.nodes.append(helper.make_node("Cast", [value], [name], to=to))
        return name

    def shape(self, *sizes: int) -> str:
        """Add a constant of whole numbers, such as a shape or axes; return its name."""
        return self.constant(sizes, np.int64)


def add_generator(graph: Graph, module: Generator, variables: Mapping[str, Any], image: str) -> str:
    """Add the network to `graph`.

    Args:
        graph: The graph.
        module: The network.
        variables: Its variables, as `module.apply` takes them.
        image: Name of the crops (batch, height, width) in [0, 1].

    Returns:
        Name of its output (batch, output, height, width), before the nonlinearity of the head.
    """
    params, statistics = variables["params"], variables["batch_stats"]
    x = add_network_input(graph, module.inputs, image)
    down: list[str] = []
    for n in range(1, 8):
        x = _convolution(graph, params[f"down{n}"], x)
        if f"norm{n}" in params:
            x = _normalisation(graph, params[f"norm{n}"], statistics[f"norm{n}"], x)
        x = graph.node("LeakyRelu", x, alpha=0.2)
        down.append(x)
    dense = params["Dense_0"]
    kernel = np.asarray(dense["kernel"]).T[
        :, :, None, None
    ]  # the map has one pixel: a dense layer is a 1 × 1 convolution
    x = graph.node("Relu", graph.node("Conv", x, kernel, dense["bias"]))
    for n in range(9, 16):
        parts = [x, down[15 - n]] if module.skips else [x]  # layer 16 − n, counted from 1
        x = graph.node("Concat", *parts, axis=1) if len(parts) > 1 else x
        x = _transposed(graph, params[f"up{n}"], x)
        if n < 15:
            x = graph.node("Relu", _normalisation(graph, params[f"norm{n}"], statistics[f"norm{n}"], x))
    return x


def add_network_input(graph: Graph, inputs: Inputs, image: str) -> str:
    """Add `inputs.network_input` of `image` (batch, height, width) in [0, 1]; return its name. Channels come first."""
    grey = graph.node("Sub", graph.node("Mul", image, 2.0), 1.0)
    if inputs == "grey":
        return graph.node("Unsqueeze", grey, graph.shape(1))
    flat = graph.node("Flatten", image, axis=1)
    rank = graph.node("Reshape", _ranks(graph, flat), graph.node("Shape", image))
    channels = [graph.node("Sub", graph.node("Mul", rank, 2.0), 1.0), _deviation(graph, grey)]
    each = [graph.node("Unsqueeze", channel, graph.shape(1)) for channel in channels]
    return graph.node("Concat", *each, axis=1)


def _deviation(graph: Graph, grey: str) -> str:
    """Deviation from the image's mean in standard deviations, saturated."""
    axes = graph.shape(1, 2)
    centred = graph.node("Sub", grey, graph.node("ReduceMean", grey, axes))
    variance = graph.node("ReduceMean", graph.node("Mul", centred, centred), axes)
    spread = graph.node("Mul", graph.node("Add", graph.node("Sqrt", variance), 1e-3), SPREAD)
    return graph.node("Tanh", graph.node("Div", centred, spread))


def _ranks(graph: Graph, flat: str) -> str:
    """`inputs.ranks` of images in [0, 1] whose pixels are in one row (batch, pixel)."""
    place = graph.node("Mul", graph.node("Clip", flat, 0.0, 1.0), LEVELS - 1.0)
    level = graph.node("Min", graph.node("Floor", place), LEVELS - 2.0)
    part = graph.node("Sub", place, level)
    rest = graph.node("Sub", 1.0, part)
    low = graph.cast(level, np.int64)
    high = graph.node("Add", low, graph.shape(1))
    batch = graph.node("Shape", flat, start=0, end=1)
    size = graph.cast(graph.node("Shape", flat, start=1, end=2), np.float32)
    empty = graph.node("Expand", 0.0, graph.node("Concat", batch, graph.shape(LEVELS), axis=0))
    histogram = graph.node("ScatterElements", empty, low, rest, axis=1, reduction="add")
    histogram = graph.node("ScatterElements", histogram, high, part, axis=1, reduction="add")
    histogram = graph.node("Div", histogram, size)
    below = graph.node("CumSum", histogram, graph.shape(1))
    below = graph.node("Sub", below, graph.node("Mul", histogram, 0.5))
    at_low = graph.node("Mul", rest, graph.node("GatherElements", below, low, axis=1))
    return graph.node("Add", at_low, graph.node("Mul", part, graph.node("GatherElements", below, high, axis=1)))


def _convolution(graph: Graph, params: Mapping[str, Any], x: str) -> str:
    """`layers.Down`: stride 2; a 4 × 4 kernel is padded by 1, a 2 × 2 kernel is not."""
    kernel = np.asarray(params["kernel"]).transpose(3, 2, 0, 1)
    return graph.node("Conv", x, kernel, *_bias(params), strides=[2, 2], pads=[_padding(kernel)] * 4)


def _transposed(graph: Graph, params: Mapping[str, Any], x: str) -> str:
    """`layers.Up`: each pixel spreads over the kernel, stride 2, which is ONNX's transposed convolution."""
    kernel = np.asarray(params["kernel"]).transpose(3, 2, 0, 1)
    return graph.node("ConvTranspose", x, kernel, *_bias(params), strides=[2, 2], pads=[_padding(kernel)] * 4)


def _padding(kernel: np.ndarray) -> int:
    return 1 if kernel.shape[-1] == 4 else 0


def _bias(params: Mapping[str, Any]) -> list[Any]:
    return [params["bias"]] if "bias" in params else []


def _normalisation(graph: Graph, params: Mapping[str, Any], statistics: Mapping[str, Any], x: str) -> str:
    """`normalise.batch_norm` with its running statistics."""
    numbers = params["scale"], params["bias"], statistics["mean"], statistics["var"]
    return graph.node("BatchNormalization", x, *numbers, epsilon=EPSILON)
