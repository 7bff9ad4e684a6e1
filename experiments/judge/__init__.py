"""An independent judge: frames by a ray caster on Embree and a sensor model of its own.

Nothing here imports the package's renderer, sensor, data, segmenter, matcher or refinement (a test holds that). Python
loads most of them all the same, because `sonarjax/__init__.py` does, but nothing here calls them. Nothing is ever
trained on these frames, and no constant here was chosen by how well anything recognizes them.

`view` the true geometry → `raycast` what rays meet → `echoes`, `ground` mean powers → `sensor`, `display` the stored
frame; `labels` its true classes; `device` what differs between devices and tanks; `frames` the sets;
`leaning` objects that lean and float, seen from two sides.
"""
