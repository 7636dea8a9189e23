# SPDX-License-Identifier: MIT
"""What forces drive: a motion that is unknown, because the force along it is given."""

from collections.abc import Sequence
from typing import Protocol

from dolfinx_mortar.arrays import Floats


class Driven(Protocol):
    """A rigid tool or side with m unknown motions, each with a given force; the same on all ranks.

    An interface offers it, see `Interface.driven`, and Newton's method finds the motions, see
    `newton_method.driven_tools`.
    """

    @property
    def holds(self) -> bool:
        """Whether nodes follow it in all directions, rather than touch it."""

    @property
    def names(self) -> Sequence[str]:
        """How messages call the m motions, and the forces that drive them."""

    def loads(self) -> Floats:
        """Return the given forces (m,) on the tool.

        Raises:
            ValueError: for values of Constants that are not finite.
        """

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """Return what one unit of each motion (m, n, d) does at points.

        Args:
            x: (n, d) where they are, X if the geometry is frozen.
            X: (n, d) where they were at the start.
            moved: (m,) amounts of the motions by which it is moved from where it is; what that
                changes is found to first order, or neglected.
        """

    def move(self, amounts: Floats) -> None:
        """Move the tool by amounts (m,) of its motions."""
