"""pix2pix in PyTorch, as an experienced user would write it: the peer of `bench_train`, the same networks and step.

Layers 7 and 9 have the 2 × 2 taps that a 1 × 1 map can reach, as ours do; Adam is PyTorch's fused one.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

MULTIPLIERS = (1, 2, 4, 8, 8, 8, 8)


class Generator(nn.Module):
    """The U-Net of 15 layers."""

    def __init__(self, width: int) -> None:
        super().__init__()
        c = [1] + [width * m for m in MULTIPLIERS]
        plain = (0, 6)
        self.downs = nn.ModuleList(
            nn.Conv2d(c[n], c[n + 1], 2 if n == 6 else 4, 2, 0 if n == 6 else 1, bias=n in plain) for n in range(7)
        )
        self.norms = nn.ModuleList(nn.Identity() if n in plain else nn.BatchNorm2d(c[n + 1]) for n in range(7))
        self.bottleneck = nn.Conv2d(c[7], c[7], 1)
        out = [c[6], c[5], c[4], c[3], c[2], c[1], 1]
        self.ups = nn.ModuleList(
            nn.ConvTranspose2d(2 * c[7 - n], out[n], 4 if n else 2, 2, 1 if n else 0, bias=n == 6) for n in range(7)
        )
        self.up_norms = nn.ModuleList(nn.BatchNorm2d(out[n]) for n in range(6))

    def forward(self, x: Tensor) -> Tensor:
        """Images (batch, 1, height, width) to maps of the same shape, in [−1, 1]."""
        layers = []
        for layer, norm in zip(self.downs, self.norms, strict=True):
            x = functional.leaky_relu(norm(layer(x)), 0.2)
            layers.append(x)
        x = functional.relu(self.bottleneck(x))
        for n, layer in enumerate(self.ups):
            x = layer(torch.cat([x, layers[6 - n]], 1))
            if n == 6:
                return torch.tanh(x)
            x = self.up_norms[n](x)
            x = functional.relu(functional.dropout(x, 0.5, self.training) if n < 3 else x)
        raise AssertionError("the last layer returns")


class Discriminator(nn.Module):
    """The patch discriminator of four convolutions."""

    def __init__(self, width: int) -> None:
        super().__init__()
        c = (2, width, 2 * width, 4 * width)
        self.downs = nn.ModuleList(nn.Conv2d(c[n], c[n + 1], 4, 2, 1, bias=n == 0) for n in range(3))
        self.norms = nn.ModuleList(nn.Identity() if n == 0 else nn.BatchNorm2d(c[n + 1]) for n in range(3))
        self.patch = nn.Conv2d(c[3], 1, 4, 1, 1)

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        """Logits of images and maps, both (batch, 1, height, width)."""
        x = torch.cat([x, y], 1)
        for layer, norm in zip(self.downs, self.norms, strict=True):
            x = functional.leaky_relu(norm(layer(x)), 0.2)
        return self.patch(x)


class Trainer:
    """Both networks, their optimisers and the averaged generator."""

    def __init__(self, width: int, layout: torch.memory_format) -> None:
        self.generator = Generator(width).to(memory_format=layout)
        self.judge = Discriminator(width).to(memory_format=layout)
        self.adams = [torch.optim.Adam(m.parameters(), 2e-4, (0.5, 0.999), fused=True) for m in self._both()]
        self.average = [p.detach().clone() for p in self.generator.parameters()]

    def _both(self) -> tuple[nn.Module, nn.Module]:
        return self.generator, self.judge

    def step(self, x: Tensor, y: Tensor) -> None:
        """One step of both networks; the generator's maps are made once."""
        self.generator.train()
        made = self.generator(x)
        self.adams[1].zero_grad(set_to_none=True)
        real, fake = self.judge(x, y), self.judge(x, made.detach())
        (functional.softplus(-real).mean() + functional.softplus(fake).mean()).backward()
        self.adams[1].step()
        self.adams[0].zero_grad(set_to_none=True)
        for p in self.judge.parameters():  # the generator's turn needs no gradient of the judge's weights
            p.requires_grad_(False)
        (functional.softplus(-self.judge(x, made)).mean() + 50 * (made - y).abs().mean()).backward()
        self.adams[0].step()
        for p in self.judge.parameters():
            p.requires_grad_(True)
        torch._foreach_lerp_(self.average, [p.detach() for p in self.generator.parameters()], 1e-3)

    def infer(self, x: Tensor) -> Tensor:
        """The generator's maps, normalised with the running statistics."""
        self.generator.eval()
        with torch.inference_mode():
            return self.generator(x)
