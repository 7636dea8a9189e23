# SPDX-License-Identifier: MIT
"""Limits of friction as their user gives them: coefficients, or tractions."""

from dataclasses import dataclass
from numbers import Real
from typing import TypeAlias

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import ROUND_OFF, Floats
from dolfinx_mortar.interfaces.nodal import check_nodal

Limit: TypeAlias = float | fem.Constant | fem.Function

REMEDY = "give a number, a scalar fem.Constant, or a scalar Lagrange fem.Function"


@dataclass(frozen=True)
class FrictionLaw:
    """What limits the tangential traction tau of a closed contact with pressure p.

    Coulomb's law, "friction": abs(tau) <= mu p. Tresca's, "tresca": abs(tau) <= s.
    """

    name: str  # of the argument that gave it
    value: Limit

    def values(self, scalar: fem.FunctionSpace) -> Floats:
        """Return the present values at the owned nodes of a scalar space; collective.

        Raises:
            ValueError: on all ranks, for values that are negative or not finite.
        """
        comm, n = scalar.mesh.comm, scalar.dofmap.index_map.size_local
        if isinstance(self.value, fem.Function):
            self.value.x.scatter_forward()  # a node may have its value from a cell of ghosts
            at_nodes = fem.Function(scalar)
            at_nodes.interpolate(self.value)
            values = np.asarray(at_nodes.x.array[:n], dtype=np.float64)
            largest = maximum(comm, np.abs(values).max(initial=0.0))[0]
            # interpolation from another degree leaves the round-off of a zero
            none = np.isfinite(values) & (values < 0.0) & (values >= -ROUND_OFF * largest)
            values[none] = 0.0
        else:
            number = float(np.asarray(getattr(self.value, "value", self.value)).reshape(()))
            values = np.full(n, number)
        bad = ~(np.isfinite(values) & (values >= 0.0))
        if any_rank(comm, bad.any())[0]:
            what = f"{float(values[bad][0]):g} somewhere" if bad.any() else "so on another rank"
            raise ValueError(f"{self.name} is {what}: every value has to be finite and >= 0")
        return values


def create_law(friction: Limit | None, tresca: Limit | None) -> FrictionLaw | None:
    """Return the law of two arguments, None for neither and for the number 0.

    Raises:
        ValueError: for both, and for values that are no limits.
    """
    if friction is not None and tresca is not None:
        raise ValueError(
            f"friction is {friction!r} and tresca is {tresca!r}: give one of the two, a "
            "coefficient of the pressure or a traction"
        )
    name, value = ("friction", friction) if tresca is None else ("tresca", tresca)
    if value is None:
        return None
    if isinstance(value, Real) and not isinstance(value, bool):
        if not (is_number(value) and value >= 0.0):
            raise ValueError(f"{name} is {value!r}: it has to be finite and >= 0")
        return FrictionLaw(name, float(value)) if value > 0.0 else None
    if isinstance(value, fem.Function):
        check_nodal(name, value, (), REMEDY)
    elif not isinstance(value, fem.Constant):
        raise ValueError(f"{name} is {value!r}: {REMEDY}")
    if value.ufl_shape != () or not np.issubdtype(_dtype(value), np.floating):
        raise ValueError(f"{name} has shape {value.ufl_shape} and type {_dtype(value)}: {REMEDY}")
    return FrictionLaw(name, value)


def _dtype(value: fem.Function | fem.Constant) -> np.dtype:
    array = value.x.array if isinstance(value, fem.Function) else value.value
    return np.asarray(array).dtype
