"""Table 4: correlations of templates with images that are not segmented."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from experiments.common import paper
from paper_figs.matrix import blocks, draw_blocks
from paper_figs.shared import load

ITEM = "Table 4"
CAPTION = (
    "Matching results before applying the segmentation, as in Table 3. The sensor model is calibrated so that the "
    "mean of the diagonal comes near the paper's."
)
EXPERIMENTS = ("reproduce_paper",)
PAPER = {"target": paper.TABLE_4}


def draw(runs: Path) -> Figure:
    """The paper's table beside ours."""
    table = load(runs, "reproduce_paper").report["tables"]["tab04"]
    return draw_blocks(blocks(table, **PAPER), table["threshold"])
