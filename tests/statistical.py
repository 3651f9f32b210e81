# SPDX-License-Identifier: Apache-2.0
"""Statistical tests. Seeds are fixed, so a test that passes keeps passing; the error rate is the probability that a
correct program would have failed for a random seed."""

from __future__ import annotations

import numpy as np
from scipy import stats

ERROR_RATE = 1e-4


def assert_mean(values: np.ndarray, expected: float, error_rate: float = ERROR_RATE, rounding: float = 1e-6) -> None:
    """z-test: independent values have this mean. rounding: what float32 may add, a share of expected."""
    values = np.asarray(values, dtype=np.float64).ravel()
    error = values.std(ddof=1) / np.sqrt(len(values))
    difference = values.mean() - expected
    allowed = stats.norm.isf(error_rate / 2) * error + rounding * abs(expected)
    assert abs(difference) <= allowed, (
        f"mean {values.mean():.8g} +- {error:.2g} (n = {len(values)}), expected {expected:.8g}: "
        f"z = {difference / max(error, 1e-300):.2f}"
    )


def assert_histogram(counts: np.ndarray, expected: np.ndarray, error_rate: float = ERROR_RATE) -> None:
    """Chi-square test of counts against their expectation; cells that expect fewer than 5 are pooled."""
    counts, expected = np.ravel(counts).astype(np.float64), np.ravel(expected)
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    small = int(np.searchsorted(expected, 5.0))
    while 0 < small < len(expected) and expected[:small].sum() < 5.0:
        small += 1
    counts = np.concatenate([[counts[:small].sum()], counts[small:]])
    expected = np.concatenate([[expected[:small].sum()], expected[small:]])
    counts, expected = counts[expected > 0], expected[expected > 0]
    chi_square = ((counts - expected) ** 2 / expected).sum()
    limit = stats.chi2.isf(error_rate, len(counts) - 1)
    assert chi_square <= limit, (
        f"chi-square {chi_square:.1f} over {limit:.1f} with {len(counts) - 1} degrees of freedom"
    )
