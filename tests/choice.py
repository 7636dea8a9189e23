# SPDX-License-Identifier: MIT
"""Which cases of a test the default run has; the slow run has the others."""

import pytest


def quick(cases, *chosen):
    """Return cases to parametrize with, slow but for those chosen."""
    return [_case(c, c in chosen) for c in cases]


def crosswise(first, second):
    """Return all pairs to parametrize with; quick ones have every value of both, not every pair.

    >>> [pair.values for pair in crosswise("ab", "xyz") if not pair.marks]
    [('a', 'x'), ('a', 'z'), ('b', 'y')]
    """
    few = min(len(first), len(second))
    return [
        _case((*_values(a), *_values(b)), i % few == j % few)
        for i, a in enumerate(first)
        for j, b in enumerate(second)
    ]


def _case(case, is_quick):
    """Return a case, with values for several names if it is a tuple."""
    return pytest.param(*_values(case), marks=() if is_quick else pytest.mark.slow)


def _values(case):
    """Return a tuple as it is, anything else as the only value."""
    return case if isinstance(case, tuple) else (case,)
