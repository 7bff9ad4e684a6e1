"""The paper's figures, tables and numbers, drawn from runs/; nothing is simulated or trained here.

`python -m paper_figs --help`. One file an item; each has ITEM, CAPTION, EXPERIMENTS, `draw(runs)` and, if it is
more than a picture, NUMBERS.
"""
