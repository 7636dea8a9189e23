# SPDX-License-Identifier: MIT
"""Warnings with level and logger name where nobody has configured logging.

Python's own last resort prints the bare text. As soon as the program has a handler, on the root or
on this package's logger, that one rules and nothing is printed here.
"""

from __future__ import annotations

import logging
import sys

NAME = __name__.partition(".")[0]


class LastResort(logging.Handler):
    """Prints records of level WARNING and above to the present stderr, if nobody else does."""

    def __init__(self) -> None:
        """Set level and format."""
        super().__init__(logging.WARNING)
        self.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record unless the program has a handler of its own."""
        if not is_configured():
            print(self.format(record), file=sys.stderr)


def is_configured() -> bool:
    """Tell whether the program has a handler of its own, on the root or this package's logger."""
    own = logging.getLogger(NAME).handlers
    others = [handler for handler in own if not isinstance(handler, LastResort)]
    return bool(others or logging.getLogger().handlers)


def add_last_resort() -> None:
    """Add the handler to this package's logger, once."""
    logger = logging.getLogger(NAME)
    if not any(isinstance(handler, LastResort) for handler in logger.handlers):
        logger.addHandler(LastResort())
