# SPDX-License-Identifier: MIT
"""What has been logged for a problem, so that a warning is not repeated in every step."""

from weakref import WeakKeyDictionary

_LOGGED: WeakKeyDictionary[object, set[str]] = WeakKeyDictionary()


def is_new(owner: object, warning: str) -> bool:
    """Tell whether a warning has not been logged for its owner; it has been from then on.

    >>> class Problem: pass
    >>> one = Problem()
    >>> [is_new(one, text) for text in "aab"]
    [True, False, True]
    """
    known = _LOGGED.setdefault(owner, set())
    new = warning not in known
    known.add(warning)
    return new
