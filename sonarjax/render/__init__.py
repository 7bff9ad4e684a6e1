"""The simulator: what each azimuth slice sees, range bins, frames and the template bank (§2.1, eq. 1–2)."""

from sonarjax.render.bank import TemplateBank, bank_place, template_bank
from sonarjax.render.energy import floor_angle
from sonarjax.render.fine import mesh_tolerance, reduced_for
from sonarjax.render.fits import check_fits
from sonarjax.render.frame import RenderQuality, SonarFrame, Window, semantic_image
from sonarjax.render.frame_file import write_frame
from sonarjax.render.region import WindowSize, floor_point, image_azimuth, place_window, plan_window
from sonarjax.render.simulate import render
from sonarjax.render.unseen import why_unseen
from sonarjax.render.window import render_echo, render_window

__all__ = [
    "RenderQuality", "SonarFrame", "TemplateBank", "Window", "WindowSize", "bank_place", "check_fits", "floor_angle",
    "floor_point", "image_azimuth", "mesh_tolerance", "place_window", "plan_window", "reduced_for", "render",
    "render_echo", "render_window", "semantic_image", "template_bank", "why_unseen",
    "write_frame",
]  # fmt: skip
