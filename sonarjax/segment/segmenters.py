"""All segmenters by name: the shipped pix2pix network and the classical baselines."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8

from sonarjax.engine import PLAIN, Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.io.given import is_number, shown
from sonarjax.io.safetensors import read_safetensors
from sonarjax.segment.classical import CLASSICAL, THRESHOLDS, from_grey, threshold_labels, to_grey
from sonarjax.segment.rule import RULES, IdentificationRule, read_rule
from sonarjax.segment.tiled import TILE, check_frame, plain_frame, segment
from sonarjax.segment.weights import GeneratorWeights, generator_of, shipped_path

NETWORK = "pix2pix"
SEGMENTERS = (NETWORK, *CLASSICAL)
"""Names that `load_segmenter` knows; it also takes the path of a weights file."""
DEFAULT_SEGMENTER = NETWORK
"""The segmenter that `recognize` and the command line use unless another is named."""


@dataclass(frozen=True)
class Segmenter:
    """A way from a grey frame to a semantic map, ready for use."""

    name: str
    """Its name, or the path of its weights file."""
    threshold: float | None
    """Least NCC of an identified target (eq. 5), from validation frames; None if it was never measured."""
    weights: GeneratorWeights | None = None
    """The network; None for a classical segmenter."""
    tile: tuple[int, int] = TILE
    """Largest size of a tile (range, beam) [pixels] that the network sees at once."""
    rule: IdentificationRule | None = None
    """Decides about refined matches; if None, the threshold decides."""

    def semantic(
        self, image: Float[np.ndarray, "range beam"], mask: Bool[np.ndarray, "range beam"] | None = None,
        engine: Engine = PLAIN,
    ) -> Float[np.ndarray, "range beam"]:  # fmt: skip
        """Compute the semantic map of a frame.

        The map of `none` is the grey frame itself, everywhere.

        Args:
            image: Grey frame (range, beam) in [0, 1].
            mask: True where the frame was measured (range, beam); None means everywhere. Elsewhere the map is
                background.
            engine: Runs the compiled functions.

        Returns:
            Map (range, beam): shadow 0, background 0.5, highlight 1. Where a network is unsure, values lie between.

        Raises:
            SonarjaxError: The image is not one frame, a measured pixel is not finite or lies far outside [0, 1], or the
                mask has another shape.
        """
        check_frame(image, mask)
        if self.weights is not None:
            image, mask = plain_frame(image, mask)  # an engine would take a list for many arguments
            return np.array(engine.run(segment, image, self.weights, mask, tile=self.tile))
        return _copied(image) if self.name == "none" else to_grey(threshold_labels(image, self.name, mask))

    def labels(
        self, image: Float[np.ndarray, "range beam"], mask: Bool[np.ndarray, "range beam"] | None = None,
        engine: Engine = PLAIN,
    ) -> UInt8[np.ndarray, "range beam"]:  # fmt: skip
        """Label each pixel of a frame.

        Args:
            image: Grey frame (range, beam) in [0, 1].
            mask: True where the frame was measured (range, beam); None means everywhere. Elsewhere the label is
                background.
            engine: Runs the compiled functions.

        Returns:
            Labels (range, beam): 0 background, 1 highlight, 2 shadow.

        Raises:
            SonarjaxError: The image is not one frame, a measured pixel is not finite or lies far outside [0, 1], or the
                mask has another shape.
        """
        check_frame(image, mask)
        if self.weights is None:
            return threshold_labels(image, self.name, mask)
        return from_grey(self.semantic(image, mask, engine))


def _copied(image: Any) -> Any:
    """The frame (range, beam) as a new float32 array: whoever changes the map must not change the frame."""
    return image.astype(np.float32) if isinstance(image, jax.core.Tracer) else np.array(image, np.float32)


def load_segmenter(name: str | os.PathLike[str] = DEFAULT_SEGMENTER) -> Segmenter:
    """Load a segmenter by its name, or from a weights file that training wrote.

    - `pix2pix`: the shipped network. It looks at tiles of the frame, then more closely at each object.
    - `otsu`: Otsu's two thresholds (1979) on the frame's 3 × 3 median: highlight above the upper one, shadow at or
      below the lower one, background between.
    - `otsu3`: the same on the frame without a median; named for its three classes.
    - `median-otsu`: the same on the frame's 5 × 5 median.
    - `otsu1`: Otsu's single threshold on the frame without a median: highlight above it, no shadow.
    - `none`: no segmentation. The map is the grey frame itself; for labels it is cut at 1/4 and 3/4.

    Args:
        name: One of `SEGMENTERS`, or the path of a weights file (*.safetensors).

    Returns:
        The segmenter.

    Raises:
        SonarjaxError: There is no such name or file, or the file cannot be used.
    """
    text = os.fspath(name) if isinstance(name, os.PathLike) else name
    check_segmenter(text)
    if text in CLASSICAL:
        return Segmenter(text, THRESHOLDS[text], rule=RULES.get(text))
    path = shipped_path() if text == NETWORK else text
    arrays, about = read_safetensors(path)
    threshold, tile = about.get("threshold"), about.get("tile", TILE)
    sizes = tile if isinstance(tile, list | tuple) and len(tile) == 2 else ()
    usable = bool(sizes) and all(is_number(v) and 1 <= v < math.inf for v in sizes)
    if not (usable and (threshold is None or is_number(threshold))):
        raise SonarjaxError(
            f"{os.fspath(path)}: metadata: expected a number `threshold` and two numbers `tile` of 1 or more"
        )
    rule = read_rule(about.get("rule"), os.fspath(path))
    weights = generator_of(arrays, os.fspath(path), check=text != NETWORK)
    return Segmenter(text, threshold, weights, (int(tile[0]), int(tile[1])), rule)


def check_segmenter(name: str) -> None:
    """Check the name of a segmenter, without reading a file.

    Args:
        name: One of `SEGMENTERS`, or the path of a weights file (*.safetensors).

    Raises:
        SonarjaxError: The name is neither.
    """
    if not isinstance(name, str) or (name not in SEGMENTERS and not name.endswith(".safetensors")):
        expected = f"one of {', '.join(SEGMENTERS)} or a .safetensors file"
        raise SonarjaxError(f"segmenter: expected {expected}, got {shown(name)}")
