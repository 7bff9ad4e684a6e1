"""What a real device adds to a rendered frame: propagation, beams, speckle, multipath, gain and eight bits.

`observe` turns a `SonarFrame` into the image (range, beam) that a device described by a `SensorModel` would store. The
functions that it calls are public and can be used alone. Each names its source, or says that there is none and it is a
model of ours.
"""

from sonarjax.sensor.beams import (
    array_pattern,
    beam_gains,
    beam_mixing,
    crosstalk_mixing,
    dim_beams,
    group_gains,
    other_pings,
    streaks,
)
from sonarjax.sensor.bottom import ripple_brightness, slow_brightness
from sonarjax.sensor.display import compress, quantise
from sonarjax.sensor.echoes import EchoLaw, render_paths, stored_echo
from sonarjax.sensor.model import SensorModel
from sonarjax.sensor.multipath import bounce_mesh, bounce_points, render_bounces
from sonarjax.sensor.observe import observe, observe_scene, received_energy, speckle
from sonarjax.sensor.propagation import (
    absorption_loss,
    elevation_gain,
    floor_elevation,
    fresh_absorption,
    late_reverberation,
    noise_floor,
    pulse_blur,
    range_middles,
    reference_energy,
    reference_range,
    time_varied_gain,
    with_skirts,
)
from sonarjax.sensor.speckle import (
    azimuth_kernel,
    complex_field,
    correlate,
    gamma_of_normal,
    gamma_texture,
    heavy_tails,
    multi_look,
    patchy_normal,
    range_kernel,
    speckle_intensity,
)

__all__ = [
    "EchoLaw", "SensorModel", "absorption_loss", "array_pattern", "azimuth_kernel", "beam_gains",
    "beam_mixing", "bounce_mesh", "bounce_points", "complex_field", "compress", "correlate", "crosstalk_mixing",
    "dim_beams", "elevation_gain", "floor_elevation", "fresh_absorption", "gamma_of_normal", "gamma_texture",
    "group_gains", "heavy_tails", "late_reverberation", "multi_look", "noise_floor", "observe", "observe_scene",
    "other_pings", "patchy_normal", "pulse_blur", "quantise", "range_kernel", "range_middles", "received_energy",
    "reference_energy", "reference_range", "render_bounces", "render_paths", "ripple_brightness", "slow_brightness",
    "speckle", "speckle_intensity", "stored_echo", "streaks", "time_varied_gain", "with_skirts",
]  # fmt: skip
