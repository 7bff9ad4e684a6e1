"""What experiments share: how they are started and keep their results, the frames of §4.1, segmenters, metrics."""
