"""Self-calibration: the sonar's own geometry from frames of a known object (beyond the paper)."""

from sonarjax.calibrate.calibration import Calibration, calibrate
from sonarjax.calibrate.parameters import PARAMETERS, Parameter, check_free
from sonarjax.calibrate.report import compare_templates, describe_calibration
from sonarjax.calibrate.yaw_error import stated_std, yaw_std_of_geometry

__all__ = [
    "PARAMETERS", "Calibration", "Parameter", "calibrate", "check_free", "compare_templates",
    "describe_calibration", "stated_std", "yaw_std_of_geometry",
]  # fmt: skip
