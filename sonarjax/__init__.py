"""sonarjax: a differentiable imaging-sonar simulator, template matching and continuous yaw refinement in JAX.

Conventions, everywhere in the package:

- Ground frame: origin on the floor under the sonar, x forward, y to port, z up (right-handed). The sonar is at
  (0, 0, height), tilted down by `tilt`. Sonar frame: x along the beam axis, y to port, z up before the tilt.
- A ray at azimuth θ and elevation φ is (cos φ cos θ, cos φ sin θ, sin φ) in the sonar frame; azimuth grows to port.
- Images: axis 0 = range bin, near to far; axis 1 = beam in ascending azimuth (column 0 is the starboard-most beam).
  Batches lead. Values float32 in [0, 1]. Labels uint8: 0 background, 1 highlight, 2 shadow. As one grey image:
  shadow 0, background 0.5, highlight 1. `intensity` is raw energy per bin, not scaled.
- Object pose: (x, y) of the mesh origin on the floor, yaw about the vertical, counter-clockwise from above; z, roll
  and pitch default to 0. A mesh keeps its own z: it is never dropped onto the floor.
- Metres and radians inside; degrees only at the command line and in files whose key says `_deg`.
- Random functions take a keyword-only `key`.

Pictures of frames and results are in `sonarjax.plot`, speed on a CPU is in `sonarjax.cpu`; both are imported when they
are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from sonarjax.calibrate import Calibration, calibrate
from sonarjax.engine import Engine
from sonarjax.io.errors import SonarjaxError
from sonarjax.match import LeanSearchConfig, SearchConfig, match_bank, match_positions
from sonarjax.recognition import Recognition
from sonarjax.recognize import Recognizer, recognize
from sonarjax.refine import (
    PoseEstimate,
    PoseFinder,
    RefineConfig,
    YawEstimate,
    plan_refinement,
    refine_pose,
    refine_yaw,
)
from sonarjax.render import (
    RenderQuality,
    SonarFrame,
    TemplateBank,
    Window,
    WindowSize,
    plan_window,
    render,
    template_bank,
)
from sonarjax.scene import Mesh, Pose, objects, reduce_mesh, stack_meshes
from sonarjax.segment import GeneratorWeights, Segmenter, load_segmenter, segment
from sonarjax.sensor import SensorModel, observe
from sonarjax.shape import SizeEstimate, SurfaceConfig, SurfaceEstimate, fit_size, fit_surface
from sonarjax.sonar import FloorPatch, Sonar
from sonarjax.track import Standing, Track, TrackConfig, Tracker, Turning, track

if TYPE_CHECKING:
    from sonarjax import cpu as cpu
    from sonarjax import plot as plot
else:

    def __getattr__(name: str) -> object:
        """Import `plot` and `cpu` on first use: matplotlib takes a while, and not everybody draws."""
        if name == "plot":
            return import_module("sonarjax.plot")
        if name == "cpu":
            return import_module("sonarjax.cpu")
        raise AttributeError(f"module 'sonarjax' has no attribute {name!r}")


__version__ = "0.2.0.dev0"

__all__ = [
    "Calibration", "Engine", "FloorPatch", "GeneratorWeights", "LeanSearchConfig", "Mesh", "Pose", "PoseEstimate",
    "PoseFinder", "Recognition", "Recognizer", "RefineConfig", "RenderQuality", "SearchConfig", "Segmenter",
    "SensorModel", "SizeEstimate", "Sonar", "SonarFrame", "SonarjaxError", "Standing", "SurfaceConfig",
    "SurfaceEstimate", "TemplateBank", "Track", "TrackConfig", "Tracker", "Turning", "Window", "WindowSize",
    "YawEstimate", "calibrate", "fit_size", "fit_surface", "load_segmenter", "match_bank", "match_positions",
    "objects", "observe", "plan_refinement", "plan_window", "recognize", "reduce_mesh", "refine_pose", "refine_yaw",
    "render", "segment", "stack_meshes", "template_bank", "track",
]  # fmt: skip
