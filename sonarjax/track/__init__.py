"""Sequences of frames: a belief over yaw, x, y and yaw rate, updated by the recognizer's hypotheses frame by frame."""

from sonarjax.track.belief import Belief, Measurement, Numbers, next_belief, nothing_known, numbers_of, run_filter
from sonarjax.track.measurement import Mode, measurement_of, modes_of
from sonarjax.track.motion import Motion, Standing, TrackConfig, Turning
from sonarjax.track.sequence import Track, Tracked, Tracker, track

__all__ = [
    "Belief", "Measurement", "Mode", "Motion", "Numbers", "Standing", "Track", "TrackConfig", "Tracked", "Tracker",
    "Turning", "measurement_of", "modes_of", "next_belief", "nothing_known", "numbers_of", "run_filter", "track",
]  # fmt: skip
