# SPDX-License-Identifier: MIT
"""What the stress of the committed state rests on beside internal variables, for a small strain.

Where an eigenstrain, parameters of laws, or a displacement from which a user starts lead beyond
yield, the tangent at the start of a step is that of flow, singular where nothing hardens, and the
stress is capped: it does not tell how far the bodies have to move. A step begins with

    F = F_n + int C_n : (eps(u - u_n) - (e - e_n)) : eps(v)

then, C_n being the tangent of the committed state, see `Solid.add_first_forces`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.solid.eigenstrain import Eigenstrain
from dolfinx_mortar.solid.sources import Followed


class CommittedData:
    """Displacement, eigenstrain and parameters of the committed state."""

    def __init__(
        self,
        u: fem.Function,
        eigenstrain: Eigenstrain | None,
        parameters: Sequence[Followed],
        create_change: Callable[[], tuple[fem.Form, list[fem.Function]]],
    ) -> None:
        """Begin at X, without eigenstrain, with the parameters as they are.

        Args:
            u: displacement.
            eigenstrain: of the bodies.
            parameters: of their laws.
            create_change: compiles the last term of F, with the changes of u and of e.
        """
        self._create_change = create_change
        strained = [u] if eigenstrain is None else [u, eigenstrain.function]
        other = [one.function for one in parameters if one.varying]
        self._functions = [*strained, *other]
        self._kept: list[Floats] | None = [np.zeros_like(f.x.array) for f in strained]
        self._kept += [f.x.array.copy() for f in other]

    def keep(self) -> None:
        """Take the present values for those of the committed state."""
        self._kept = [f.x.array.copy() for f in self._functions]

    def forget(self) -> None:
        """Take the values of the next `complete`: checkpoints have none."""
        self._kept = None

    def complete(self) -> None:
        """Take the present values if none are known."""
        if self._kept is None:
            self.keep()

    def differ(self) -> bool:
        """Tell whether present values on this rank are others."""
        assert self._kept is not None
        now = [f.x.array for f in self._functions]
        return not all(map(np.array_equal, now, self._kept))

    @contextmanager
    def put(self) -> Iterator[None]:
        """Set the Functions back for the time being."""
        assert self._kept is not None
        now = [f.x.array.copy() for f in self._functions]
        self._set(self._kept)
        try:
            yield
        finally:
            self._set(now)

    def change(self) -> fem.Form:
        """Return the last term of F for what has changed since, to be assembled in `put`."""
        assert self._kept is not None
        form, changes = self._change
        for change, f, kept in zip(changes, self._functions, self._kept, strict=False):
            change.x.array[:] = f.x.array - kept
        return form

    @cached_property
    def _change(self) -> tuple[fem.Form, list[fem.Function]]:
        """The form and the changes; few steps need them."""
        return self._create_change()

    def _set(self, values: Sequence[Floats]) -> None:
        """Set the Functions."""
        for f, array in zip(self._functions, values, strict=True):
            f.x.array[:] = array
