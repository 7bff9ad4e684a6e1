"""Template matching (§2.3): NCC (eq. 4) for all yaw bins of a bank at once, the decision (eq. 5) and yaw hypotheses.

The functions take a frame or semantic map (range, beam) and a bank of templates (yaw, h, w). They return scores (yaw,),
positions and records. `TargetSearch` holds the banks of one target at all distances. `FirstLook` selects the few of
many targets that are worth a full search.
"""

from sonarjax.match.decision import Decision, Peaks, between_bins, decide, peaks
from sonarjax.match.first_look import FirstLook, Sighting, leading
from sonarjax.match.lean import LeanMatch, LeanSearch, LeanSearchConfig
from sonarjax.match.low_rank import LowRankBank, low_rank_bank, match_low_rank, scores_at
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
    "FirstLook",
    "LeanMatch",
    "LeanSearch",
    "LeanSearchConfig",
    "LowRankBank",
    "Match",
    "MatchPositions",
    "Peaks",
    "PreparedBank",
    "SearchConfig",
    "Sighting",
    "TargetSearch",
    "TemplateSpectra",
    "between_bins",
    "correlation_maps",
    "decide",
    "leading",
    "low_rank_bank",
    "match_bank",
    "match_low_rank",
    "match_positions",
    "peaks",
    "prepare_bank",
    "scores_at",
    "template_spectra",
]
