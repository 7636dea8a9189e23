# SPDX-License-Identifier: MIT
"""Results of a step at an interface: resultants, and Functions of tractions and gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import Relaxed
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.spaces import set_owned
from dolfinx_mortar.interfaces.constraints import FrictionLaw
from dolfinx_mortar.interfaces.coupling import Sides


class NoResult(RuntimeError, AttributeError):
    """No result before the first step; also an AttributeError, for ``hasattr``."""

    def __init__(self, interface: Results, name: str, why: str = "") -> None:
        why = f": {why}" if why else " yet: solve a step first, newton(problem)"
        super().__init__(f"{interface} has no {name}{why}")


@dataclass(frozen=True)
class Resultants:
    """Results other than Functions."""

    force: Floats  # (d,) on the slave side
    moment: Floats  # (3,) about the origin
    master_force: Floats  # (d,) on the master side
    master_moment: Floats  # (3,)
    multiplier: Floats  # (n,) or (n, d) at owned slave nodes
    nodes: Ints  # (n,) their local numbers
    carries: Bools  # (n,) with a multiplier
    place: Floats  # (3,) position of a tool or rigid side


class Results:
    """Results of steps at an interface.

    Attributes:
        law: of friction, or None.
        owner: problem to which the interface belongs.
        nodal: Functions by name.
        resultants: None until the first step.
        dissipated: energy of all ranks.
        turns: iteration of the coefficient of friction in a step.
        ended: coefficient and states (n,) at the end of a step, see `Coefficient`.
    """

    law: FrictionLaw | None = None
    owner: object = None
    resultants: Resultants | None = None
    dissipated: float = 0.0
    turns: Relaxed | None = None
    ended: Mapping[str, Floats] | None = None

    def __init__(self) -> None:
        self.nodal: dict[str, fem.Function] = {}

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Assign to a problem, without results; collective."""
        self.owner, self.resultants, self.dissipated = owner, None, 0.0
        scalar = V.sub(0).collapse()[0]
        spaces = dict.fromkeys(("pressure", "gap", "active"), scalar)
        if self.law is not None:
            spaces |= {"traction": V, "step_slip": V}
            spaces |= dict.fromkeys(("slip", "status", "energy"), scalar)
            if same := {*spaces, "wear_depth", "committed_depth"} & {*self.law.own}:
                raise ValueError(f"state: {', '.join(same)} is a result of each contact: rename it")
            spaces |= dict.fromkeys(self.law.own, scalar)
        self.nodal = {name: fem.Function(space, name=name) for name, space in spaces.items()}

    def keep(self) -> Any:
        """Copies of the results, for `put_back`."""
        values = [(f, f.x.array.copy()) for f in self.nodal.values()]
        return self.resultants, self.dissipated, self.ended, values

    def put_back(self, kept: Any) -> None:
        """Restore the result of `keep`; without communication."""
        self.resultants, self.dissipated, self.ended, functions = kept
        for f, values in functions:
            f.x.array[:] = values

    def commit(self) -> None:
        """Let the next step begin with the coefficient and states that have ended; collective."""
        for name, values in (self.ended or {}).items():
            set_owned(self.nodal[name], values)
        self.ended = None

    def clear(self) -> None:
        """Remove the results; without communication."""
        self.resultants, self.dissipated = None, 0.0
        for f in self.nodal.values():
            f.x.array[:] = 0.0

    def sum_up(self, comm: MPI.Comm, nodes: Ints) -> None:
        """Sum the energies of the owned slave nodes; collective."""
        if "energy" in self.nodal:
            energy = self.nodal["energy"].x.array[nodes]
            self.dissipated = comm.allreduce(float(energy.sum()), op=MPI.SUM)

    def _resultant(self, name: str) -> Floats:
        if self.resultants is None:
            raise NoResult(self, name)
        return np.asarray(getattr(self.resultants, name))

    def _about_place(self, moment: Floats, force: Floats) -> Floats:
        whole = np.append(force, np.zeros(3 - len(force)))
        return moment - np.cross(self._resultant("place"), whole)

    def _function(self, name: str) -> fem.Function:
        if name not in self.nodal:
            raise NoResult(self, name)
        return self.nodal[name]

    @property
    def force(self) -> Floats:
        """Resultant (d,) on the slave side at the end of the step (impulses: `Ledger.impulses`).

        Of rings the sum of outward forces, which cancel on the whole, and the axial force.
        """
        return self._resultant("force")

    @property
    def moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the slave side.

        Of rings that of the sums in the plane of the section, to check the balance of both sides.
        """
        return self._resultant("moment")

    @property
    def master_force(self) -> Floats:
        """Resultant (d,) on the master side."""
        return self._resultant("master_force")

    @property
    def master_moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the master side."""
        return self._resultant("master_moment")

    @property
    def multiplier(self) -> Floats:
        """Lagrange multipliers lambda_j at the owned slave nodes."""
        return self._resultant("multiplier")

    @property
    def pressure(self) -> fem.Function:
        """Normal traction, positive in compression; zero off the slave side."""
        return self._function("pressure")

    @property
    def gap(self) -> fem.Function:
        """Distance to the master; zero off the slave side."""
        return self._function("gap")

    @property
    def active(self) -> fem.Function:
        """1 where the interface acts, else 0."""
        return self._function("active")

    def gather(self, u: fem.Function) -> Mapping[str, Floats]:
        """Slave nodes of all ranks on every rank, ordered by X; collective.

        Returns:
            "X" (n, d) reference and "x" (n, d) current coordinates at u, "pressure", "gap" and
            "active" (n,), with friction also "traction" (n, d), "step_slip" (n, d), "slip" and
            "status" (n,).

        Raises:
            NoResult: before the first step.
            ValueError: if u is no displacement.
        """
        if self.resultants is None:
            raise NoResult(self, "nodal results")
        mesh = self.pressure.function_space.mesh
        if not isinstance(u, fem.Function) or u.function_space.mesh is not mesh or not u.ufl_shape:
            raise ValueError(f"u is {u!r}: give the displacement, solid.u")
        V, own, d = u.function_space, self.resultants.nodes, len(self.force)
        X = V.tabulate_dof_coordinates()[own, :d]
        shown = {"X": X, "x": X + u.x.array.reshape(-1, d)[own]}
        shown |= {
            n: _at_nodes(f)[own]
            for n, f in self.nodal.items()
            if n not in ("energy", "committed_depth")
        }
        order, parts = None, {}
        for name, values in shown.items():
            whole = np.concatenate(mesh.comm.allgather(values))
            order = np.lexsort(whole.T[::-1]) if order is None else order
            parts[name] = whole[order, 0] if whole.size == len(whole) else whole[order]
        return parts


def _at_nodes(f: fem.Function) -> Floats:
    return np.asarray(f.x.array.reshape(-1, f.function_space.dofmap.index_map_bs))


def merge_results(
    sides: Sequence[Sides], interfaces: Sequence[Results], name: str, function: fem.Function
) -> fem.Function:
    """Fill a Function with results of all interfaces, "pressure" to "slip" or "facing"; collective.

    A node of several slave sides has the value of the interface with its multiplier, else of the
    first whose master it faces; elsewhere 0.
    """
    n, size = sides[0].n_owned, function.function_space.dofmap.index_map_bs
    merged, best = np.zeros((n, size)), np.full(n, -1)
    for side, interface in zip(sides, interfaces, strict=True):
        nodes, last = side.nodes, interface.resultants
        facing = ~np.isnan(interface.gap.x.array[nodes])
        claim = np.where(facing, 1 + (np.False_ if last is None else last.carries), 0)
        take = claim > best[nodes]
        best[nodes[take]] = claim[take]
        if name == "facing":
            values: Floats = np.full((len(nodes), 1), float(last is not None))
        else:
            field = ({"status": interface.active} | interface.nodal).get(name)
            values = np.zeros((len(nodes), size)) if field is None else _at_nodes(field)[nodes]
        merged[nodes[take]] = np.where(facing[:, None], values, 0.0)[take]
    function.x.array[: n * size] = merged.ravel()
    function.x.scatter_forward()
    return function
