"""Beam centres of ARIS sonars: uneven tables, approximated by an odd polynomial of the beam number.

With t from -1 (beam 0, the rightmost) to 1 (the last beam) and F the angle of beam 0 from the axis,

    azimuth(t) = F * (a t + b t^3 + c t^5),   a + b + c = 1,

where a follows from the spacing in the middle of the fan, and b, c from the spacing at its edge. The curve is smooth
and symmetric about the axis. It is an approximation, not the maker's table. For 96, 64 and 48 beams it is within 0.03
deg of Sound Metrics' published centres, with one exception: the published 96-beam table is not symmetric (its last beam
is at +13.876 deg, beam 0 at -13.749 deg), so its port edge is off by 0.13 deg. For 128 beams, and for the telephoto
table of 48, only the first centre and the spacings are known.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

ARIS_1800, ARIS_3000, ARIS_1200 = 0, 1, 2
"""Values of SystemType in the header."""

Fan = tuple[float, float, float]

FANS: dict[tuple[int, bool], dict[int, Fan]] = {
    (ARIS_1800, False): {96: (13.749, 0.342, 0.210), 48: (13.5735, 0.684, 0.430)},
    (ARIS_1200, False): {48: (13.5735, 0.684, 0.430)},
    (ARIS_3000, False): {128: (15.007, 0.246, 0.217), 64: (14.887, 0.478, 0.461)},
    (ARIS_1800, True): {96: (7.419, 0.160, 0.148), 48: (7.339, 0.320, 0.297)},
    (ARIS_1200, True): {48: (7.339, 0.320, 0.297)},
}
"""(SystemType, large lens) -> beams -> (angle of beam 0 from the axis, spacing in the middle, spacing at the
edge) [deg].
"""


def uneven_fan(n_beams: int, first_deg: float, middle_deg: float, edge_deg: float) -> Float64[np.ndarray, "beam"]:
    """Ascending beam centres (beam,) [deg] of the module's polynomial.

    Args:
        n_beams: Number of beams.
        first_deg: Angle of beam 0 from the axis [deg].
        middle_deg: Spacing in the middle [deg].
        edge_deg: Spacing at the edge [deg].
    """
    half = (n_beams - 1) / 2
    t = (np.arange(n_beams) - half) / half
    a = middle_deg * half / first_deg
    # The outermost spacing lies between two beams, so the slope is matched half a beam inside the edge.
    q = ((half - 0.5) / half) ** 2
    b, c = np.linalg.solve([[1.0, 1.0], [3 * q, 5 * q * q]], [1 - a, edge_deg * half / first_deg - a])
    return first_deg * t * (a + t * t * (b + c * t * t))


def aris_azimuth_deg(system: int, n_beams: int, large_lens: bool) -> Float64[np.ndarray, "beam"] | None:
    """Return the azimuths of an ARIS's beam centres, from the polynomial of this module.

    Args:
        system: SystemType of the header: 0 for an ARIS 1800, 1 for an ARIS 3000, 2 for an ARIS 1200.
        n_beams: Number of beams.
        large_lens: True if the sonar has the large lens.

    Returns:
        Beam centres (beam,) in ascending order [deg]; None if no table is known for this combination.
    """
    fan = FANS.get((system, large_lens), {}).get(n_beams)
    return None if fan is None else uneven_fan(n_beams, *fan)
