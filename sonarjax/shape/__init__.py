"""The shape of an object from frames of it: its extents, or all its vertices (beyond the paper)."""

from sonarjax.shape.size import SizeEstimate, fit_size
from sonarjax.shape.surface import SurfaceConfig, SurfaceEstimate, fit_surface

__all__ = ["SizeEstimate", "SurfaceConfig", "SurfaceEstimate", "fit_size", "fit_surface"]
