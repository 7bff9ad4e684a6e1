"""What is counted in maps of several objects, against counts by hand."""

from __future__ import annotations

import numpy as np

from experiments.common.several import LEAST_PIXELS, counted


def test_objects_are_hit_where_a_fifth_of_their_highlight_is_found() -> None:
    """Object 1 is found by a fifth, object 2 by less, and object 3 is too small to count."""
    parts, found = np.zeros((40, 30), int), np.zeros((40, 30), bool)
    parts[0:10, 0:10], parts[20:30, 0:10], parts[35, : LEAST_PIXELS - 1] = 1, 2, 3
    found[0:2, 0:10], found[20, 0:10], found[35] = True, True, True
    true, both = 200 + LEAST_PIXELS - 1, 30 + LEAST_PIXELS - 1
    assert counted(found, parts) == (both, 30 + 30, true, 1, 2)
