"""Where refinement starts: the peaks of the map, the frame's best match, and that of both together."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sonarjax.refine import Candidate, make_starts

YAWS = np.arange(36) * math.radians(10.0)
SEEN, IMAGE = np.zeros((4, 4), np.float32), np.ones((4, 4), np.float32)


def candidate(yaw_deg: float, x: float = 2.0) -> Candidate:
    """A match whose scores have one peak, at `yaw_deg`."""
    scores = np.cos(YAWS - math.radians(yaw_deg)).astype(np.float32)
    match: Any = SimpleNamespace(scores=scores, bank=SimpleNamespace(yaws=YAWS, x=2.0, y=0.0))
    return Candidate(None, match, x, 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("in_both", "wanted"),
    [
        (candidate(120), [(30, 2.0), (200, 2.3), (120, 2.0)]),
        (candidate(31), [(30, 2.0), (200, 2.3)]),  # within 5° of the map's
        (candidate(31, 2.1), [(30, 2.0), (200, 2.3), (31, 2.1)]),  # that yaw, elsewhere
        (candidate(200, 2.31), [(30, 2.0), (200, 2.3)]),
        (None, [(30, 2.0), (200, 2.3)]),
    ],
)
def test_both_together_are_a_start_where_neither_alone_is(
    in_both: Candidate | None, wanted: list[tuple[float, float]]
) -> None:
    starts = make_starts(candidate(30), candidate(200, 2.3), in_both, SEEN, IMAGE, 4)
    found = [(math.degrees(float(one.begin.yaw)), float(one.begin.x)) for one in starts]
    np.testing.assert_allclose(found, wanted, atol=0.1)
    assert starts[0].picture is SEEN and all(one.picture is IMAGE for one in starts[1:])
