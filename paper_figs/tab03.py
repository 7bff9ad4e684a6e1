"""Table 3: correlations of templates with segmented images."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.common import paper
from experiments.common.runs import Run
from experiments.common.tables import off_diagonal
from paper_figs.matrix import blocks, draw_blocks

ITEM = "Table 3"
CAPTION = (
    "Matching results between the template images and the segmented images, means over four sets. Below Otsu's "
    "threshold on a table's own values stands 0, and in ours the number under the zero in grey."
)
EXPERIMENTS = ("reproduce_paper",)
PAPER = {"target": paper.TABLE_3_TARGET, "other": paper.TABLE_3_OTHER}


def draw(run: Run) -> Figure:
    """The paper's table beside ours."""
    table = run.report["tables"]["tab03"]
    return draw_blocks(blocks(table, **PAPER), table["threshold"])


NUMBERS = [
    ("target with other templates, largest shown", float(off_diagonal(paper.TABLE_3_TARGET).max()),
     lambda report: off_diagonal(np.array(report["tables"]["tab03"]["target_shown"])).max()),
]  # fmt: skip
