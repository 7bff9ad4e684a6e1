"""Files in and out as arrays and dicts: ARIS, DIDSON, Oculus, ROS bags, PNG, NPY, NPZ, TOML, JSON Lines. No pickle.

`read_frames("file.aris:3")` gives `Frame`s: an image float32 (range, beam) in [0, 1], near row first, beams in
ascending azimuth (to port), with its mask, its geometry [m, deg] and whatever else the header says. Input that cannot
be used raises `SonarjaxError`: one line that names the file, the field and what was expected. This folder imports no
other folder of the package.
"""

from sonarjax.io.aris import parse_aris
from sonarjax.io.aris_beams import aris_azimuth_deg
from sonarjax.io.atomic import write_atomic, write_npz, write_png, write_text
from sonarjax.io.console import complain, say, silence_stdout
from sonarjax.io.convert import FAN_OPTIONS, FanOptions, PolarAxes, convert, one_frame, to_bag
from sonarjax.io.describe import describe
from sonarjax.io.didson import DIDSON_TABLES, DidsonTables, didson_azimuth_deg, parse_didson
from sonarjax.io.errors import SonarjaxError, UnreadableError
from sonarjax.io.fan import fan_to_polar, polar_to_fan
from sonarjax.io.fan_geometry import FanGeometry, PictureBox, content_box, fan_around, fit_fan
from sonarjax.io.files import read_bytes
from sonarjax.io.frame import Frame
from sonarjax.io.images import parse_npy_frame, parse_npz_frame, parse_png_frame
from sonarjax.io.jsonlines import JsonLines
from sonarjax.io.load import iter_frames, iter_records, naming, read_frames, split_spec
from sonarjax.io.npy import PIXEL_LIMIT
from sonarjax.io.oculus import parse_oculus
from sonarjax.io.oculus_log import parse_oculus_log
from sonarjax.io.outputs import check_ending, check_label_files, check_outputs, make_folder
from sonarjax.io.ros import bag_topics, write_bag
from sonarjax.io.toml import parse_toml, read_toml

__all__ = [
    "DIDSON_TABLES",
    "DidsonTables",
    "FAN_OPTIONS",
    "FanGeometry",
    "FanOptions",
    "Frame",
    "JsonLines",
    "PIXEL_LIMIT",
    "PictureBox",
    "PolarAxes",
    "SonarjaxError",
    "UnreadableError",
    "aris_azimuth_deg",
    "bag_topics",
    "check_ending",
    "check_label_files",
    "complain",
    "check_outputs",
    "content_box",
    "convert",
    "describe",
    "didson_azimuth_deg",
    "fan_around",
    "fan_to_polar",
    "fit_fan",
    "iter_frames",
    "iter_records",
    "make_folder",
    "naming",
    "one_frame",
    "parse_aris",
    "parse_didson",
    "parse_npy_frame",
    "parse_npz_frame",
    "parse_oculus",
    "parse_oculus_log",
    "parse_png_frame",
    "parse_toml",
    "polar_to_fan",
    "read_bytes",
    "read_frames",
    "read_toml",
    "say",
    "silence_stdout",
    "split_spec",
    "to_bag",
    "write_atomic",
    "write_bag",
    "write_npz",
    "write_png",
    "write_text",
]
