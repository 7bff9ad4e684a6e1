"""Self-calibration: the sonar's own geometry from frames of a known object (beyond the paper)."""

from sonarjax.calibrate.calibration import Calibration, calibrate
from sonarjax.calibrate.parameters import PARAMETERS, Parameter, check_free
from sonarjax.calibrate.report import compare_templates, describe_calibration

__all__ = [
    "PARAMETERS", "Calibration", "Parameter", "calibrate", "check_free", "compare_templates",
    "describe_calibration",
]  # fmt: skip
