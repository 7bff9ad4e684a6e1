"""Labelled training pairs made by the simulator (§3.1): random objects and views, cropped to 128 × 128.

`make_pairs(count, key=split_key(run_seed, "train"))` draws pairs at random from a key. `export_pairs` writes them to
PNG files and `import_pairs` reads them back. `make_dataset` writes whole frames with instance masks, boxes and poses.
`cut_box` and `paste_patch` do the resampling, which training and inference share.
"""

from sonarjax.crops import PATCH, Box, cut_box, paste_patch
from sonarjax.data.crops import cut_labels, draw_box
from sonarjax.data.dataset import make_dataset
from sonarjax.data.folder import export_pairs, import_pairs
from sonarjax.data.formats import FORMATS
from sonarjax.data.frames import SENSORS, FrameSettings
from sonarjax.data.pairs import Pairs, PairSettings, make_pairs, paper_pairs, split_key

__all__ = [
    "Box", "FORMATS", "FrameSettings", "PATCH", "PairSettings", "Pairs", "SENSORS", "cut_box", "cut_labels", "draw_box",
    "export_pairs", "import_pairs", "make_dataset", "make_pairs", "paper_pairs", "paste_patch", "split_key",
]  # fmt: skip
