"""From a grey frame to a semantic map (§2.2): classical baselines; pix2pix joins them later."""

from sonarjax.segment.classical import SEGMENTERS, check_segmenter, segment, to_grey

__all__ = ["SEGMENTERS", "check_segmenter", "segment", "to_grey"]
