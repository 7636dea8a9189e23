# SPDX-License-Identifier: MIT
"""Which cases of a test the default run has."""

from collections.abc import Iterable
from typing import Any

import pytest


def quick(cases: Iterable[Any], *chosen: Any) -> list[Any]:
    """Return cases to parametrize with, slow but for those chosen."""
    return [c if c in chosen else pytest.param(c, marks=pytest.mark.slow) for c in cases]
