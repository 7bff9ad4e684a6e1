"""How likely errors are under an error bar, and how much wider or narrower that should be."""

from __future__ import annotations

import numpy as np

TAIL = 4.0
"""An error of more standard deviations than this counts as this many [1]."""
WITHIN = (0.683, 0.954)
"""Shares of a normal distribution within 1 and 2 standard deviations [1]."""


def unlikeliness(error: np.ndarray, std: np.ndarray) -> float:
    """Negative log-likelihood of errors (error,) that are normal but cut at `TAIL`, up to a constant."""
    return float((np.log(std) + np.minimum(error / std, TAIL) ** 2 / 2).sum())


def log_widening(error: np.ndarray, std: np.ndarray) -> float:
    """Logarithm of the factor that makes standard deviations (error,) right for the sizes of errors (error,).

    Errors have longer tails than a normal distribution: bars that hold 68 % of them within 1 standard deviation hold
    less than 95 % within 2. So it lies halfway between the factors that are right at 68 % and at 95 % (geometric mean).
    """
    one, two = np.quantile(error / std, WITHIN)
    return float(np.log(one * two / 2) / 2)


def scale_to_68(error: np.ndarray, std: np.ndarray) -> float:
    """Factor with which standard deviations (error,) hold 68 % of the sizes of errors (error,)."""
    return float(np.quantile(error / std, WITHIN[0]))
