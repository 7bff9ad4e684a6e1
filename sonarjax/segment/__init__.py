"""From a grey frame to a semantic map (§2.2): the pix2pix network, and classical baselines behind the same call."""

from sonarjax.segment.classical import to_grey
from sonarjax.segment.segmenters import DEFAULT_SEGMENTER, SEGMENTERS, segment, semantic_map

__all__ = ["DEFAULT_SEGMENTER", "SEGMENTERS", "segment", "semantic_map", "to_grey"]
