"""The paper's figures, tables and numbers, drawn from runs/; nothing is simulated or trained here.

`python -m paper_figs --help`. One file an item; each has ITEM, CAPTION, EXPERIMENTS, a `draw` that is given a run of
each of these, and NUMBERS where it is more than a picture. `ablations` has several items.
"""
