"""The metrics of validation pairs, against scikit-image."""

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from sonarjax.segment.classical import to_grey
from sonarjax.segment.training.batches import Stored
from sonarjax.segment.training.evaluate import score


def _pairs(empty: int, shown: int) -> tuple[np.ndarray, Stored]:
    """Predicted maps, perfect where nothing is shown, and pairs, the first `empty` of them without an object."""
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 3, (empty + shown, 128, 128)).astype(np.uint8)
    labels[:empty] = 0
    grey = to_grey(labels)
    grey[empty:] = np.clip(grey[empty:] + rng.normal(0, 0.1, grey[empty:].shape), 0, 1)
    return grey.astype(np.float32), Stored(rng.integers(0, 256, labels.shape).astype(np.uint8), labels)


@pytest.mark.parametrize("empty", [0, 2])
def test_pairs_without_an_object_do_not_count_in_psnr(empty: int) -> None:
    grey, pairs = _pairs(empty, shown=3)
    found = score(grey, pairs)
    truth = to_grey(pairs.labels).astype(np.float64)
    for name, image in (("psnr_db", grey), ("psnr_raw_db", pairs.image / 255)):
        each = [
            peak_signal_noise_ratio(t, np.asarray(i, float), data_range=1.0)
            for t, i in zip(truth[empty:], image[empty:], strict=True)
        ]
        assert found[name] == pytest.approx(np.mean(each), abs=1e-3)
    assert found["psnr_gain_db"] == pytest.approx(found["psnr_db"] - found["psnr_raw_db"])


def test_psnr_is_finite_where_no_pair_shows_an_object() -> None:
    grey, pairs = _pairs(empty=2, shown=0)
    assert np.isfinite(list(score(grey, pairs).values())).all()
