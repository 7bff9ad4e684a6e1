"""Tables 3 and 4 and the receiver operating characteristic, from the correlations of many frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from skimage.filters import threshold_otsu

from experiments.common.paper import ANGLES_DEG


def angle_means(scores: np.ndarray, yaw_deg: np.ndarray) -> np.ndarray:
    """Mean correlation (image, template) at the angles of Tables 3 and 4 [deg], over the sets.

    `scores` (frame, bin) are of frames on the grid, whose yaw (frame,) is `yaw_deg` [deg]; bin 0 is yaw 0.
    """
    bins = [round(angle * scores.shape[1] / 360) for angle in ANGLES_DEG]
    near = [np.abs((yaw_deg - angle + 180) % 360 - 180) < 1e-3 for angle in ANGLES_DEG]
    return np.stack([scores[frames][:, bins].mean(axis=0) for frames in near])


def with_zeros(means: np.ndarray) -> tuple[np.ndarray, float]:
    """A table with zeros where Otsu's threshold on its own correlations is not reached, and that threshold."""
    limit = float(threshold_otsu(means))
    return np.where(means > limit, means, 0.0), limit


def correlation_table(scores: np.ndarray, yaw_deg: np.ndarray, is_target: np.ndarray) -> dict[str, Any]:
    """Table 3 or 4: means of target and other object (image, template), the same with zeros, and Otsu's threshold.

    `scores` (frame, bin), `yaw_deg` (frame,) [deg], `is_target` (frame,); the threshold is that of all means at once.
    """
    means = np.concatenate([angle_means(scores[kind], yaw_deg[kind]) for kind in (is_target, ~is_target)])
    shown, limit = with_zeros(means)
    half = len(ANGLES_DEG)
    return {
        "target": means[:half],
        "other": means[half:],
        "target_shown": shown[:half],
        "other_shown": shown[half:],
        "threshold": limit,
    }


def off_diagonal(table: np.ndarray) -> np.ndarray:
    """The correlations (n,) with templates of other angles than the image's."""
    return table[~np.eye(len(table), dtype=bool)]


def receiver_curve(score: np.ndarray, is_target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """False and true positive rates (cut,) at every threshold, both from 0 to 1, and the area under them."""
    cuts = np.append(np.inf, np.unique(score)[::-1])
    false, true = ((score[kind][None] >= cuts[:, None]).mean(axis=1) for kind in (~is_target, is_target))
    return false, true, float(np.trapezoid(true, false))
