"""What is rendered, of which part of the image, and how finely: `SonarFrame`, `Window` and `RenderQuality`."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from sonarjax.io.errors import SonarjaxError
from sonarjax.records import record, static
from sonarjax.sonar import Sonar


@dataclass(frozen=True)
class RenderQuality:
    """How finely a frame is rendered; hashable, so that it may be static under `jax.jit`."""

    sub_beams: int = 2
    """Even azimuth parts of a beam; edges of the object split it further."""
    elevations: int = 64
    """About the number of elevation cells of a slice's energy integral. Which surface is visible does not depend on it
    for up to 32 triangles a slice, and is sampled at that many elevations above."""

    def __post_init__(self) -> None:
        """Raises SonarjaxError for a number below 1."""
        if self.sub_beams < 1 or self.elevations < 1:
            raise SonarjaxError(
                f"RenderQuality: expected sub_beams and elevations of at least 1, got {self.sub_beams} and "
                f"{self.elevations}"
            )


@record
class Window:
    """A part of the image; its place may be traced, its size decides shapes."""

    row: Int[Array, "*batch"] | int
    """First range bin."""
    column: Int[Array, "*batch"] | int
    """First beam."""
    shape: tuple[int, int] = static()
    """Number of (range, beam) pixels."""
    object_columns: int | None = static(default=None)
    """Upper bound of the beams that the object itself touches; None for all. Only they are looked at."""


@record
class SonarFrame:
    """A rendered sonar image or a window of it: near to far, and starboard to port."""

    intensity: Float[Array, "*batch range beam"]
    """Energy of first hits per range bin, objects and floor [rad/m²] (eq. 2 with k = I0 = 1), not scaled."""
    highlight: Float[Array, "*batch range beam"]
    """Share of the pixel's range cell covered by first hits of an object, 0 to 1."""
    shadow: Float[Array, "*batch range beam"]
    """Share of the pixel's floor hidden behind an object, 0 to 1."""
    lit: Bool[Array, "*batch range beam"]
    """True where the floor is insonified, or an object is seen; elsewhere a real frame is as dark as shadow."""
    overflow: Int[Array, "*batch"]
    """Triangles for which the fullest slice had no room in `Mesh.crossings` or `Mesh.front`; 0 where all is well."""
    sonar: Sonar
    """What looked."""

    def semantic(self) -> Float[Array, "*batch range beam"]:
        """One grey image (range, beam) of each frame: shadow 0, background 0.5, highlight 1, by shares."""
        return semantic_image(self.highlight, self.shadow)

    def labels(self) -> UInt8[Array, "*batch range beam"]:
        """The class (range, beam) of each frame with the largest share: 0 background, 1 highlight, 2 shadow."""
        shares = jnp.stack(
            [(1 - self.highlight) * (1 - self.shadow), self.highlight, self.shadow * (1 - self.highlight)]
        )
        return jnp.argmax(shares, axis=0).astype(jnp.uint8)


def semantic_image(
    highlight: Float[Array, "*batch range beam"], shadow: Float[Array, "*batch range beam"]
) -> Float[Array, "*batch range beam"]:
    """0.5·(1 + h − s·(1 − h)): the classes' shares (range, beam) as one grey image in [0, 1]."""
    return jnp.clip(0.5 * (1 + highlight - shadow * (1 - highlight)), 0.0, 1.0)
