"""What is rendered (`SonarFrame`), which part of the image (`Window`) and how finely (`RenderQuality`)."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from sonarjax.io.given import check_whole
from sonarjax.records import record, static
from sonarjax.sonar import Sonar

BACKGROUND = 0.5
"""Grey of a semantic map where the object neither covers nor hides the floor; shadow is 0, highlight 1."""


@dataclass(frozen=True)
class RenderQuality:
    """How finely a frame is rendered. Hashable, so that it can be a static argument under `jax.jit`."""

    sub_beams: int = 2
    """Number of equal azimuth parts of each beam. Edges of the object divide a beam further."""
    elevations: int = 64
    """About how many elevation cells a slice's energy integral has. With up to 32 triangles in a slice, visibility is
    exact and does not depend on this number; with more, visibility is sampled at this many elevations.
    """

    def __post_init__(self) -> None:
        """Turn numbers into those of Python. Raise a SonarjaxError for what is no whole number of 1 or more."""
        for name in ("sub_beams", "elevations"):
            check_whole(getattr(self, name), 1, name)
            object.__setattr__(self, name, int(getattr(self, name)))  # of NumPy it could not be written as JSON


@record
class Window:
    """A part of the image. Its place may be traced; its size decides shapes."""

    row: Int[Array, "*batch"] | int
    """First range bin."""
    column: Int[Array, "*batch"] | int
    """First beam."""
    shape: tuple[int, int] = static()
    """Number of (range, beam) pixels."""
    object_columns: int | None = static(default=None)
    """Most beams that the object itself can touch; None for all. Only these beams are searched for it."""


@record
class SonarFrame:
    """A rendered sonar image, or a window of one: near to far, starboard to port."""

    intensity: Float[Array, "*batch range beam"]
    """Energy of first hits on objects and floor in each range bin [rad/m²] (eq. 2 with k = I0 = 1), not scaled."""
    highlight: Float[Array, "*batch range beam"]
    """Share of the pixel's range cell that first hits of an object cover, 0 to 1."""
    shadow: Float[Array, "*batch range beam"]
    """Share of the pixel's floor that an object hides, 0 to 1."""
    lit: Bool[Array, "*batch range beam"]
    """True where the floor is insonified or an object is seen. Elsewhere a real frame is as dark as shadow."""
    overflow: Int[Array, "*batch"]
    """How many triangles the fullest slice had no room for (`Mesh.crossings`, `Mesh.front`); 0 if nothing is missing.
    """
    sonar: Sonar
    """The sonar that looked."""

    def semantic(self) -> Float[Array, "*batch range beam"]:
        """Return the semantic map: shadow 0, background 0.5, highlight 1, mixed by their shares.

        Returns:
            Semantic map of each frame (range, beam), after the batch axes.
        """
        return semantic_image(self.highlight, self.shadow)

    def labels(self) -> UInt8[Array, "*batch range beam"]:
        """Return the class with the largest share in each pixel.

        Returns:
            Classes (range, beam), after the batch axes: 0 background, 1 highlight, 2 shadow.
        """
        shares = jnp.stack(
            [(1 - self.highlight) * (1 - self.shadow), self.highlight, self.shadow * (1 - self.highlight)]
        )
        return jnp.argmax(shares, axis=0).astype(jnp.uint8)


def semantic_image(
    highlight: Float[Array, "*batch range beam"], shadow: Float[Array, "*batch range beam"]
) -> Float[Array, "*batch range beam"]:
    """Return the semantic map of given shares of highlight and shadow.

    Args:
        highlight: Share h of highlight in each pixel (range, beam), 0 to 1.
        shadow: Share s of shadow in each pixel (range, beam), 0 to 1.

    Returns:
        Semantic map (range, beam), 0 to 1: 0.5·(1 + h − s·(1 − h)).
    """
    return jnp.clip(0.5 * (1 + highlight - shadow * (1 - highlight)), 0.0, 1.0)
