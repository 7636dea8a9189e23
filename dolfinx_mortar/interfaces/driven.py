# SPDX-License-Identifier: MIT
"""What forces drive: a motion that is unknown, because the force along it is given."""

from collections.abc import Sequence
from typing import Protocol

from dolfinx_mortar.arrays import Floats


class Driven(Protocol):
    """A rigid tool with m unknown motions, each with a given force; the same on all ranks.

    An interface offers it, see `Interface.driven`, and Newton's method finds the motions, see
    `newton_method.driven_tools`.
    """

    @property
    def names(self) -> Sequence[str]:
        """How messages call the m motions, and the forces that drive them."""

    def loads(self) -> Floats:
        """Return the given forces (m,) on the tool.

        Raises:
            ValueError: for values of Constants that are not finite.
        """

    def motions(self, x: Floats) -> Floats:
        """Return what one unit of each motion (m, n, d) does at points x (n, d)."""

    def move(self, amounts: Floats) -> None:
        """Move the tool by amounts (m,) of its motions."""
