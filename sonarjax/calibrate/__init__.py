"""Self-calibration: the sonar's own geometry from frames of a known object (beyond the paper)."""

from sonarjax.calibrate.calibration import Calibration, calibrate
from sonarjax.calibrate.parameters import PARAMETERS, Parameter

__all__ = ["PARAMETERS", "Calibration", "Parameter", "calibrate"]
