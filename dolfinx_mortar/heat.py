# SPDX-License-Identifier: MIT
"""Conduction of heat, or of electric current, in bodies and across their interfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc
from dolfinx_mortar.algebra.csr import Triplets
from dolfinx_mortar.algebra.parallel import maximum, raised_together
from dolfinx_mortar.common.arguments import check, instance, number
from dolfinx_mortar.common.arrays import TINY, Bools, Floats, Ints, Longs, place
from dolfinx_mortar.common.spaces import check_space
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.assembly import assemble_mortar, segments
from dolfinx_mortar.solid.laws import by_cells

Law = float | fem.Function | Callable[[Floats, Floats], Any]


@dataclass(frozen=True, eq=False)
class Conductance:
    """Flux across an interface, q = h(p, g) (T_s - T_m) per area of the slave side.

    Args:
        interface: a contact, tie or tool of the problem.
        h: conductance where it is closed: a number, a Function of the temperature's space, or a
            function of pressures and gaps, arrays (n,); None for T_s = T_m.
        open: the same where it is open, 0 by default.
        share: of the heat of friction that enters the slave side, 0 to 1; the rest enters the
            master side, and is lost in a tool.
        temperature: of a tool.

    Raises:
        ValueError: naming an argument that is negative, not finite, or of another kind.
    """

    interface: Interface
    h: Law | None
    open: Law = 0.0
    share: float = 0.5
    temperature: float | fem.Constant = 0.0

    def __post_init__(self) -> None:
        check("interface", self.interface, instance(Interface, "give a contact, tie or tool"))
        check("share", self.share, number("a share", least=0.0, most=1.0))
        for name, law in (("h", self.h), ("open", self.open)):
            if not (law is None and name == "h") and not isinstance(law, fem.Function | Callable):
                check(name, law, number("a conductance", least=0.0))
        if self.h is None and self.interface.master is None:
            raise ValueError(
                "h is None for a tool: prescribe its temperature by a Dirichlet condition, or give "
                "a large h"
            )

    def closed(self, V: fem.FunctionSpace) -> Bools:
        """Nodes of this rank in contact, those of a tie all; collective."""
        if not self.interface.unilateral:
            return np.ones(len(V.tabulate_dof_coordinates()), dtype=bool)
        return _at_nodes(V, self.interface, "active") > 0.5

    def values(self, V: fem.FunctionSpace, closed: Bools) -> Floats:
        """Conductances at the nodes of this rank; collective."""
        if self.interface.unilateral:
            at = [_at_nodes(V, self.interface, name) for name in ("pressure", "gap")]
        else:
            at = [np.zeros(len(closed))] * 2
        laws = [0.0 if self.h is None else self.h, self.open]
        shut, apart = (_evaluate(law, *np.nan_to_num(at)) for law in laws)
        found = np.where(closed, shut, apart)
        with raised_together(V.mesh.comm):
            for i in np.flatnonzero(~((found >= 0.0) & (found < np.inf))):
                x = place(V.tabulate_dof_coordinates()[i])
                raise ValueError(
                    f"the conductance of {self.interface!r} is {found[i]:g} at {x}, pressure "
                    f"{at[0][i]:g}: give a law that is finite and not negative"
                )
        return found

    def friction(self, V: fem.FunctionSpace, dt: float | None) -> Floats:
        """Heat of friction per area and time at the nodes of this rank; collective."""
        if getattr(self.interface, "law", None) is None:
            return np.zeros(len(V.tabulate_dof_coordinates()))
        traction, slip = (
            _at_nodes(V, self.interface, name).reshape(-1, V.mesh.geometry.dim)
            for name in ("traction", "step_slip")
        )
        work = -(traction * slip).sum(axis=1)
        if dt is None and maximum(V.mesh.comm, np.abs(work).max(initial=0.0))[0] > 0.0:
            raise ValueError(f"{self.interface!r} has friction, which heats by its power: give dt")
        return work if dt is None else work / dt


def _evaluate(law: Law, pressure: Floats, gap: Floats) -> Floats:
    if isinstance(law, fem.Function):
        return np.asarray(law.x.array)
    value = law(pressure, gap) if callable(law) else law
    return np.broadcast_to(np.asarray(value, dtype=float), pressure.shape)


def _at_nodes(V: fem.FunctionSpace, interface: Interface, name: str) -> Floats:
    """Result of the last step at the nodes of V (times components)."""
    result = getattr(interface, name)
    of = V
    if result.function_space.dofmap.bs > 1:
        of = fem.functionspace(
            V.mesh, ("Lagrange", V.element.basix_element.degree, (V.mesh.geometry.dim,))
        )
    values = fem.Function(of)
    values.interpolate(result)
    return np.array(values.x.array)


class Heat:
    """Conduction of heat: c dT/dt = div(k grad T) + r in the bodies, fluxes across interfaces.

    Backward Euler in time, or steady without a step. The same equation governs electric current,
    with the potential for T, the conductivity for k, and contact resistances 1/h.

    Args:
        T: temperature, on a scalar Lagrange space of degree 1 or 2 on the mesh; its values are
            those at the start.
        conductivity: k > 0, power per length and degree: a number or Constant, or one for each cell
            tag or name.
        cell_tags: for arguments by tag.
        capacity: c, energy per volume and degree, likewise; needed in time.
        interfaces: a `Conductance` each.
        bcs: Dirichlet conditions on T.
        sources: r, power per volume: a number, Constant, Function or UFL.
        loads: linear form of the flux that enters, in the test function of T's space.
        u: displacement of the problem at whose positions the sides meet and bodies conduct, None
            for X.
        axisymmetric: whether all is per whole ring, with the weight 2 pi x[0].

    Raises:
        ValueError: on all ranks, for arguments that are negative, not finite or of another space,
            cells without a conductivity, and fields that nothing holds (at the first solution).
    """

    def __init__(
        self,
        T: fem.Function,
        conductivity: Any,
        cell_tags: Any = None,
        *,
        capacity: Any = None,
        interfaces: Sequence[Conductance] = (),
        bcs: Sequence[fem.DirichletBC] = (),
        sources: Any = None,
        loads: ufl.Form | None = None,
        u: fem.Function | None = None,
        axisymmetric: bool = False,
    ) -> None:
        check("T", T, instance(fem.Function, "give a Function on a scalar Lagrange space"))
        V = T.function_space
        check_space(V, scalar=True)
        self.T, self.V, self.comm, self.u = T, V, V.mesh.comm, u
        self.interfaces, self.bcs = list(interfaces), list(bcs)
        for i, one in enumerate(self.interfaces):
            check(f"interfaces[{i}]", one, instance(Conductance, "give a Conductance"))
        self.before = T.copy()  # at the start of the step
        self.turn: tuple[Floats, float] | None = None  # last change in this step, and its factor
        self.rate = fem.Constant(V.mesh, default_scalar_type(0.0))  # 1 / dt
        self.axisymmetric = axisymmetric
        k = _on_cells("conductivity", conductivity, cell_tags, V)
        c = _on_cells("capacity", capacity, cell_tags, V) if capacity is not None else 0.0
        x = ufl.SpatialCoordinate(V.mesh)
        self.weight = 2 * np.pi * x[0] if axisymmetric else 1.0
        v, w, dx = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.dx(V.mesh)
        zero = fem.Constant(V.mesh, default_scalar_type(0.0))
        move = ufl.Identity(len(x)) + (ufl.grad(u) if u is not None else 0.0 * ufl.Identity(len(x)))
        J, inverse = ufl.det(move), ufl.inv(move)
        slope = ufl.dot(ufl.grad(v), inverse), ufl.dot(ufl.grad(w), inverse)
        conducted = k * J * ufl.inner(*slope) + c * self.rate * v * w
        given = (c * self.rate * self.before + (zero if sources is None else sources)) * w
        self._conducted = fem.form(self.weight * conducted * dx)
        right = self.weight * given * dx
        self._given = fem.form(right if loads is None else right + loads)
        temperatures = [one.temperature for one in self.interfaces]
        self.given = [conductivity, capacity, self.bcs, sources, loads, temperatures]
        self._tools = [self._tool(one) for one in self.interfaces]

    def solve(self, dt: float | None = None) -> float:
        """Solve for T with the last step's pressures, gaps and friction; collective.

        Args:
            dt: length of the step from the committed temperature; without a capacity only the heat
                of friction depends on it. None for the steady state, without friction.

        Returns:
            Largest change of T against its last value, over the range of T now and before.

        Raises:
            ValueError: if nothing holds T in a body, conductances are negative or not finite, and
                without dt if friction heats.
        """
        if dt is not None:
            check("dt", dt, number("a time", above=0.0))
        self.rate.value = 0.0 if dt is None else 1.0 / dt
        A = petsc.assemble_matrix(self._conducted)
        A.assemble()
        b = petsc.assemble_vector(self._given)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        ties, held = [], np.zeros(len(self.T.x.array), dtype=bool)
        for bc in self.bcs:
            held[bc.dof_indices()[0]] = True
        for one, tool in zip(self.interfaces, self._tools, strict=True):
            closed = one.closed(self.V)
            values = one.values(self.V, closed), one.friction(self.V, dt)
            if tool:
                self._add_tool(tool, values, A, b)
                continue
            self._add_sides(one.interface, one.share, values, A, b)
            if one.h is None:
                ties.append(self._tie(one.interface, *map(self._global, (closed, held))))
        change = self._solve(A, b, ties)
        every = np.concatenate([self.T.x.array, self.before.x.array])
        high, low = maximum(self.comm, every.max(initial=-np.inf), (-every).max(initial=-np.inf))
        return change / max(float(high + low), TINY)

    def commit(self) -> None:
        """Make the temperature that of the start of the next step."""
        self.before.x.array[:] = self.T.x.array
        self.turn = None

    @contextmanager
    def undone(self) -> Iterator[None]:
        """Return to the committed temperature if the block fails."""
        try:
            yield
        except BaseException:
            self.T.x.array[:] = self.before.x.array
            self.turn = None
            raise

    def _tool(self, one: Conductance) -> tuple[Any, ...]:
        """Conductance, heat of friction, and forms of a tool's flux."""
        if one.interface.master is not None:
            return ()
        h, rate = fem.Function(self.V), fem.Function(self.V)
        v, w = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        tags = one.interface.facet_tags
        d = ufl.Measure("ds", self.V.mesh, subdomain_data=tags)(one.interface.slave)
        given = self.weight * (h * one.temperature + one.share * rate) * w * d
        return h, rate, fem.form(self.weight * h * v * w * d), fem.form(given)

    def _add_tool(self, tool: tuple[Any, ...], values: Sequence[Floats], A: Any, b: Any) -> None:
        h, rate, left, right = tool
        h.x.array[:], rate.x.array[:] = values
        flux, given = petsc.assemble_matrix(left), petsc.assemble_vector(right)
        flux.assemble()
        given.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        A.axpy(1.0, flux)
        b.axpy(1.0, given)

    def _add_sides(
        self, interface: Interface, share: float, values: Sequence[Floats], A: Any, b: Any
    ) -> None:
        """Add int h (T_s - T_m) (w_s - w_m), and the heat of friction."""
        sides: dict[str, Any] = {"slave": interface.slave, "master": interface.master}
        points = segments(self.V, interface.facet_tags, **sides, u=self.u)
        on_slave = np.asarray(
            self.V.dofmap.index_map.global_to_local(points.slave_dofs.ravel())
        ).reshape(points.slave_dofs.shape)
        area = points.weight
        if self.axisymmetric:
            area = area * 2 * np.pi * points.x[:, 0]
        h, rate = (area * (points.slave_values * v[on_slave]).sum(axis=1) for v in values)
        dofs = np.hstack([points.slave_dofs, points.master_dofs]).astype(PETSc.IntType)
        jump = np.hstack([points.slave_values, -points.master_values])
        k = dofs.shape[1]
        entries = np.repeat(dofs, k, axis=1), np.tile(dofs, (1, k))
        flux = h[:, None, None] * jump[:, :, None] * jump[:, None]
        A.axpy(1.0, Triplets(self.comm, self.V.dofmap.index_map, *entries).fill(flux))
        shares = np.hstack([share * points.slave_values, (1.0 - share) * points.master_values])
        b.setValues(dofs.ravel(), (rate[:, None] * shares).ravel(), addv=True)
        b.assemble()

    def _global(self, mask: Bools) -> Longs:
        nodes = np.flatnonzero(mask).astype(np.int32)
        return np.asarray(self.V.dofmap.index_map.local_to_global(nodes))

    def _tie(self, interface: Interface, closed: Longs, held: Longs) -> PETSc.Mat:
        """Rows of D - M of closed nodes whose temperature is not prescribed."""
        sides: dict[str, Any] = {"slave": interface.slave, "master": interface.master}
        mortar = assemble_mortar(self.V, interface.facet_tags, **sides, u=self.u)
        chosen = np.isin(mortar.nodes, closed) & ~np.isin(mortar.nodes, held)
        rows = mortar.D.getOwnershipRange()[0] + np.flatnonzero(chosen)
        every = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=self.comm)
        return (mortar.D - mortar.M).createSubMatrix(every)

    def _solve(self, A: PETSc.Mat, b: PETSc.Vec, ties: list[PETSc.Mat]) -> float:
        """Solve with the Dirichlet conditions and multipliers; return the largest change."""
        n, held = b.local_size, list[Ints]([np.empty(0, dtype=np.int32)])
        for C in ties:
            both = [[A, C.transpose(PETSc.Mat())], [C, None]]
            A = PETSc.Mat().createNest(both, comm=self.comm).convert("aij")
        x, right = A.createVecs()
        right.array[:n] = b.array
        for bc in self.bcs:
            dofs, count = bc.dof_indices()
            held.append(dofs[:count])
            bc.set(x.array, None, 1.0)
        rows = np.unique(np.concatenate(held)) + A.getOwnershipRange()[0]
        A.zeroRowsColumns(rows.astype(PETSc.IntType), 1.0, x, right)
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        pc = ksp.getPC()
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factor = pc.getFactorMatrix()
        factor.setMumpsIcntl(24, 1)  # counts null pivots
        ksp.solve(right, x)
        way = x.array[:n] - self.T.x.array[:n]
        change = float(maximum(self.comm, np.abs(way).max(initial=0.0))[0])
        if not change < np.inf or factor.getMumpsInfog(28) > 0:
            raise ValueError(
                "nothing holds the temperature of a body: give a Dirichlet condition, a "
                "conductance, or a capacity and dt"
            )
        self.T.x.array[:n] += self._relaxed(way) * way
        self.T.x.scatter_forward()
        return change

    def _relaxed(self, way: Floats) -> float:
        """Factor of the next change in a step, Aitken's; collective.

        Source: U. Kuettler, W. A. Wall, Comput. Mech. 43 (2008) 61-72, eq. 44.
        """
        factor = 1.0
        if self.turn is not None:
            before, last = self.turn
            bend = way - before
            product, square = self.comm.allreduce(np.array([before @ bend, bend @ bend]))
            factor = float(np.clip(-last * product / square, 0.01, 1.0)) if square else 1.0
        self.turn = way, factor
        return factor


HEAT = instance(Heat, "give a Heat")


def _on_cells(name: str, given: Any, cell_tags: Any, V: fem.FunctionSpace) -> fem.Function:
    """Positive constants of cells as a Function; collective."""
    positive = number(above=0.0)
    if not isinstance(given, Mapping):
        value = given.value if isinstance(given, fem.Constant) else given
        check(name, float(value), positive)
        return (
            given
            if isinstance(given, fem.Constant)
            else fem.Constant(V.mesh, default_scalar_type(value))
        )
    found, tags = by_cells(V.mesh, cell_tags, given, name, cover=True)
    values = fem.Function(fem.functionspace(V.mesh, ("DG", 0)))
    for tag, value in found.items():
        check(f"{name}[{tag}]", value, positive)
        values.x.array[values.function_space.dofmap.list[: len(tags), 0][tags == tag]] = value
    values.x.scatter_forward()
    return values
