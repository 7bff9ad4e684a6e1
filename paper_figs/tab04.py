"""Table 4: correlations of templates with images that are not segmented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.tables import off_diagonal
from paper_figs.matrix import blocks, draw_blocks, largest, mean_own
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


NUMBERS = [
    ("target with its own template, mean", mean_own(paper.TABLE_4),
     lambda report: mean_own(report["tables"]["tab04"]["target"])),
    ("target with other templates, largest", largest(off_diagonal(paper.TABLE_4)),
     lambda report: largest(off_diagonal(np.array(report["tables"]["tab04"]["target"])))),
]  # fmt: skip
"""What the table comes to."""
