"""What looks at the scene: the `Sonar` pytree, device presets and `sonar.toml` (Table 2)."""

from sonarjax.sonar.image import checked_image
from sonarjax.sonar.model import Sonar, range_edges_of, sonar_from_dict
from sonarjax.sonar.parts import FloorPatch, GeometryStd
from sonarjax.sonar.presets import PRESETS

__all__ = ["PRESETS", "FloorPatch", "GeometryStd", "Sonar", "checked_image", "range_edges_of", "sonar_from_dict"]
