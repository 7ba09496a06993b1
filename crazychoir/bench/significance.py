"""Figures of a benchmark as a paper gives them: medians, quartiles, worst cases, and a paired test."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import wilcoxon


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, quartiles, least and largest."""
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


def paired(ours: Sequence[float], theirs: Sequence[float]) -> dict[str, Any]:
    """Both on the same instances: how often ours costs less, and Wilcoxon's signed-rank test that it does.

    p: one-sided, exact where no two differences are equal; None where all are 0. Of n pairs it is at least 2^-n.
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


def relative(cost: float, reference: float) -> float:
    """How much more it costs, in per cent of the reference."""
    return 100.0 * (cost / reference - 1.0)
