"""The simulator: exact visible profiles of azimuth slices, range bins, frames and the template bank (§2.1, eq. 1–2)."""

from sonarjax.render.bank import TemplateBank, bank_place, semantic_window, template_bank
from sonarjax.render.energy import floor_angle
from sonarjax.render.fits import check_fits
from sonarjax.render.frame import SonarFrame, render, semantic_image
from sonarjax.render.region import floor_point, image_azimuth, object_columns, place_window, window_shape
from sonarjax.render.window import Window, render_echo, render_window

__all__ = [
    "SonarFrame", "TemplateBank", "Window", "bank_place", "check_fits", "floor_angle", "floor_point", "image_azimuth",
    "object_columns", "place_window", "render", "render_echo", "render_window", "semantic_image", "semantic_window",
    "template_bank", "window_shape",
]  # fmt: skip
