"""Template matching (§2.3): eq. 4 for every yaw bin of a bank at once, eq. 5's decision and the hypotheses over yaw.

Takes a frame or semantic map (range, beam) and a bank of templates (yaw, h, w); returns scores (yaw,), positions and
records. `TargetSearch` holds the banks of one target at all distances.
"""

from sonarjax.match.decision import Decision, Peaks, between_bins, decide, peaks
from sonarjax.match.lean import LeanMatch, LeanSearch, LeanSearchConfig
from sonarjax.match.ncc import (
    MatchPositions,
    PreparedBank,
    correlation_maps,
    match_bank,
    match_positions,
    prepare_bank,
)
from sonarjax.match.search import Match, SearchConfig, TargetSearch
from sonarjax.match.spectra import TemplateSpectra, template_spectra

__all__ = [
    "Decision",
    "LeanMatch",
    "LeanSearch",
    "LeanSearchConfig",
    "Match",
    "MatchPositions",
    "Peaks",
    "PreparedBank",
    "SearchConfig",
    "TargetSearch",
    "TemplateSpectra",
    "between_bins",
    "correlation_maps",
    "decide",
    "match_bank",
    "match_positions",
    "peaks",
    "prepare_bank",
    "template_spectra",
]
