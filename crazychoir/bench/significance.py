"""Statistics of a benchmark for a paper: medians, quartiles, worst cases, and a paired test."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import wilcoxon


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return the median, the quartiles, the least and the largest value."""
    least, lower, median, upper, most = np.percentile(
        np.asarray(values, float), [0, 25, 50, 75, 100]
    ).tolist()
    return {
        "median": median,
        "lower": lower,
        "upper": upper,
        "least": least,
        "most": most,
    }


def compare_pairs(ours: Sequence[float], theirs: Sequence[float]) -> dict[str, Any]:
    """Compare costs on the same instances: number of wins, and Wilcoxon's signed-rank test.

    The alternative hypothesis is that ours costs less.
    p: one-sided, exact if no two differences are equal, None if all are 0; with n pairs it is at
    least 2^-n
    """
    gap = np.asarray(theirs, float) - np.asarray(ours, float)
    level = np.abs(gap) <= 1e-6 * np.abs(np.asarray(ours, float))
    gap[level] = 0.0
    p = None if level.all() else float(wilcoxon(gap, alternative="greater").pvalue)
    return {
        "pairs": len(gap),
        "wins": int((gap > 0.0).sum()),
        "ties": int(level.sum()),
        "p": p,
    }


def relative_excess(cost: float, reference: float) -> float:
    """Return how much more a plan costs, in per cent of the reference."""
    return 100.0 * (cost / reference - 1.0)
