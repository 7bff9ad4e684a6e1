"""pix2pix's networks and step in PyTorch with weights taken from ours: what the tests compare with."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch.nn import functional


def maps(x: Any) -> torch.Tensor:
    """(batch, height, width, channel) as PyTorch's (batch, channel, height, width)."""
    return torch.tensor(np.asarray(x)).permute(0, 3, 1, 2)


def back(x: torch.Tensor) -> np.ndarray:
    """PyTorch's maps as (batch, height, width, channel)."""
    return x.detach().permute(0, 2, 3, 1).numpy()


def tensors(params: Any) -> Any:
    """A tree of arrays as tensors that take gradients."""
    if isinstance(params, dict):
        return {name: tensors(value) for name, value in params.items()}
    return torch.tensor(np.asarray(params), requires_grad=True)


def down(x: torch.Tensor, layer: Any) -> torch.Tensor:
    """Our `Down` with its kernel (size, size, channel, feature), always as a convolution by 4 × 4."""
    return functional.conv2d(x, _four(layer["kernel"]).permute(3, 2, 0, 1), layer.get("bias"), stride=2, padding=1)


def up(x: torch.Tensor, layer: Any) -> torch.Tensor:
    """Our `Up` with its kernel (size, size, feature, channel), always as a transposed convolution by 4 × 4."""
    kernel = _four(layer["kernel"]).permute(3, 2, 0, 1)
    return functional.conv_transpose2d(x, kernel, layer.get("bias"), stride=2, padding=1)


def _four(kernel: torch.Tensor) -> torch.Tensor:
    """A kernel of 2 × 2 amid the twelve taps that on a map of one pixel meet nothing but padding."""
    return kernel if len(kernel) == 4 else functional.pad(kernel, (0, 0, 0, 0, 1, 1, 1, 1))


def normalised(x: torch.Tensor, layer: Any, kept: Any | None = None) -> torch.Tensor:
    """Batch normalisation: with the running statistics `kept`, else with the batch's own."""
    mean, variance = (None, None) if kept is None else (kept["mean"], kept["var"])
    return functional.batch_norm(x, mean, variance, layer["scale"], layer["bias"], training=kept is None)


def generator(params: Any, x: torch.Tensor, stats: Any | None = None) -> torch.Tensor:
    """Output of the U-Net without its last nonlinearity; no dropout. `stats`: running statistics, for inference."""
    layers = []
    for n in range(1, 8):
        x = down(x, params[f"down{n}"])
        if n not in (1, 7):
            x = normalised(x, params[f"norm{n}"], stats and stats[f"norm{n}"])
        x = functional.leaky_relu(x, 0.2)
        layers.append(x)
    middle = params["Dense_0"]
    x = torch.relu(functional.conv2d(x, middle["kernel"].T[:, :, None, None], middle["bias"]))
    for n in range(9, 16):
        x = up(torch.cat([x, layers[15 - n]], 1), params[f"up{n}"])
        if n < 15:
            x = torch.relu(normalised(x, params[f"norm{n}"], stats and stats[f"norm{n}"]))
    return x


def discriminator(params: Any, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Logits of the patch discriminator."""
    h = torch.cat([x, y], 1)
    for n in (1, 2, 3):
        h = down(h, params[f"down{n}"])
        h = h if n == 1 else normalised(h, params[f"norm{n}"])
        h = functional.leaky_relu(h, 0.2)
    layer = params["patch"]
    return functional.conv2d(h, layer["kernel"].permute(3, 2, 0, 1), layer["bias"], padding=1)
