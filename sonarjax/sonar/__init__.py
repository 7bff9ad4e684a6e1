"""What looks at the scene: the `Sonar` pytree, device presets and `sonar.toml` (Table 2)."""

from sonarjax.sonar.model import FloorPatch, GeometryStd, Sonar
from sonarjax.sonar.presets import PRESETS
from sonarjax.sonar.toml import sonar_from_dict

__all__ = ["PRESETS", "FloorPatch", "GeometryStd", "Sonar", "sonar_from_dict"]
