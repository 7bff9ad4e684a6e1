"""Table 4: correlations of templates with images that are not segmented."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from paper_figs.matrix import blocks, draw_blocks

ITEM = "Table 4"
CAPTION = (
    "Matching results before applying the segmentation, as in Table 3. The sensor model is calibrated so that the "
    "mean of the diagonal comes near the paper's."
)
EXPERIMENTS = ("reproduce_paper",)
PAPER = {"target": paper.TABLE_4}


def draw(run: Run) -> Figure:
    """The paper's table beside ours."""
    table = run.report["tables"]["tab04"]
    return draw_blocks(blocks(table, **PAPER), table["threshold"])
