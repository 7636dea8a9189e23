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
from dolfinx_mortar.algebra.parallel import Relaxed, maximum, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import NUMBER, Rule, check, check_optional, instance, number
from dolfinx_mortar.common.arrays import QUARTER_OF_DIGITS, TINY, Bools, Floats, Longs, place
from dolfinx_mortar.common.compat import interpolation_points
from dolfinx_mortar.common.spaces import check_space
from dolfinx_mortar.common.tags import tags_of
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.results import NoResult
from dolfinx_mortar.mortar.assembly import assemble_mortar
from dolfinx_mortar.solid.laws import by_cells

Law = float | fem.Constant | fem.Function | Callable[[Floats, Floats], Any]


@dataclass(frozen=True, eq=False)
class Conductance:
    """Flux across an interface, q = h(p, g) (T_s - T_m) per area of the slave side.

    Args:
        interface: a contact, tie or tool of the problem.
        h: conductance where it is closed: a number, a Constant, a Function of the temperature's
            space, or a function of pressures and gaps, arrays (n,); None for T_s = T_m.
        open: the same where it is open, 0 by default.
        share: of the heat of friction or current that enters the slave side, 0 to 1; the rest
            enters the master side, and is lost in a tool.
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
        check("temperature", _number(self.temperature), NUMBER)
        for name, law in (("h", self.h), ("open", self.open)):
            if not (law is None and name == "h") and not isinstance(law, fem.Function | Callable):
                check(name, law, number("a conductance", least=0.0))
        if self.h is None and self.interface.master is None:
            raise ValueError(
                "h is None for a tool: prescribe its temperature by a Dirichlet condition, or give "
                "a large h"
            )

    def values(self, V: fem.FunctionSpace) -> tuple[Bools, Floats]:
        """Nodes of this rank in contact, those of a tie all, and conductances; collective."""
        closed, *at = np.outer([1.0, 0.0, 0.0], np.ones(len(V.tabulate_dof_coordinates())))
        if self.interface.unilateral:
            closed, *at = (
                _at_nodes(V, self.interface, name) for name in ("active", "pressure", "gap")
            )
        laws = [0.0 if self.h is None else self.h, self.open]
        with raised_together(V.mesh.comm):
            given = (_evaluate(law, *np.nan_to_num(at)) for law in laws)
            found: Floats = np.where(closed > 0.5, next(given), next(given))
            for i in np.flatnonzero(~((found >= 0.0) & (found < np.inf))):
                x = place(V.tabulate_dof_coordinates()[i])
                raise ValueError(
                    f"the conductance of {self.interface!r} is {found[i]:g} at {x}, pressure "
                    f"{at[0][i]:g}: give a law that is finite and not negative"
                )
        return closed > 0.5, found

    def friction(self, V: fem.FunctionSpace, dt: float | None) -> Floats:
        """Heat of friction per area and time at the nodes of this rank; collective."""
        if getattr(self.interface, "law", None) is None:
            return np.zeros(len(V.tabulate_dof_coordinates()))
        traction, slip = (_at_nodes(V, self.interface, name) for name in ("traction", "step_slip"))
        work = -(traction * slip).reshape(-1, V.mesh.geometry.dim).sum(axis=1)
        if dt is None and maximum(V.mesh.comm, np.abs(work).max(initial=0.0))[0] > 0.0:
            raise ValueError(f"{self.interface!r} has friction, which heats by its power: give dt")
        return work if dt is None else work / dt


def _evaluate(law: Law, pressure: Floats, gap: Floats) -> Floats:
    own = isinstance(law, fem.Constant | fem.Function)
    value = law(pressure, gap) if callable(law) and not own else _number(law)
    found = np.asarray(value, dtype=float)
    if found.shape not in ((), pressure.shape):
        raise ValueError(
            f"a conductance gives values of the shape {found.shape} at {len(gap)} nodes: give one "
            "for each node, or a Function of T's space"
        )
    return found


def _number(given: Any) -> Any:
    if isinstance(given, fem.Function):
        return given.x.array
    return float(given.value) if isinstance(given, fem.Constant) else given


def _at_nodes(V: fem.FunctionSpace, interface: Interface, name: str) -> Floats:
    """Result of the last step at the nodes of V (times components)."""
    if interface.resultants is None:
        raise NoResult(interface, name)
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
        current: a `Heat` for the potential on the same space, solved first, whose power heats:
            k |grad phi|^2 per volume, h (phi_s - phi_m)^2 per area of an interface.
        u: displacement of the problem at whose positions the sides meet and bodies conduct, None
            for X.
        axisymmetric: whether all is per whole ring, with the weight 2 pi x[0].

    Raises:
        ValueError: on all ranks, for arguments that are negative, not finite or of another mesh or
            space, cells without a conductivity, and fields that nothing holds (when solved).
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
        sources: Any = 0.0,
        loads: ufl.Form | None = None,
        current: Heat | None = None,
        u: fem.Function | None = None,
        axisymmetric: bool = False,
    ) -> None:
        check("T", T, instance(fem.Function, "give a Function on a scalar Lagrange space"))
        V = T.function_space
        check_space(V, scalar=True)
        self.T, self.V, self.comm, self.u = T, V, V.mesh.comm, u
        self.interfaces, self.bcs = list(interfaces), list(bcs)
        facets = tags_of(V.mesh, V.mesh.topology.dim - 1)
        for i, one in enumerate(self.interfaces):
            check(f"interfaces[{i}]", one, instance(Conductance, "give a Conductance"))
            check(f"interfaces[{i}]: facet_tags", one.interface.facet_tags, facets)
        of_V: Rule[Heat] = Rule(
            "give a Heat on T's space", lambda f: f if HEAT.read(f) and f.V == V else None
        )
        check_optional("current", current, of_V)
        self.given = [conductivity, capacity, self.bcs, sources, loads, self.interfaces]
        check_same_on_all_ranks(self.comm, heat=self.given, axisymmetric=axisymmetric)
        self.fields: list[Heat] = [*([] if current is None else current.fields), self]
        self.current, self.rubbed = current, True
        self.before = T.copy()  # at the start of the step
        self.relaxed = Relaxed(self.comm)
        self.rate = fem.Constant(V.mesh, default_scalar_type(0.0))  # 1 / dt
        self._weight = (lambda X: 2 * np.pi * X[:, 0]) if axisymmetric else None
        k, c = (_on_cells(*given, cell_tags, V) for given in zip(LAWS, self.given, strict=False))
        self._laws = [*k[1], *c[1]]
        x, normal = ufl.SpatialCoordinate(V.mesh), ufl.FacetNormal(V.mesh)
        at = x if u is None else x + u
        J, inverse = ufl.det(ufl.grad(at)), ufl.inv(ufl.grad(at))
        weight, hoop = 1.0, fem.Constant(V.mesh, default_scalar_type(1.0))
        turned = J * ufl.dot(normal, inverse)
        if axisymmetric:
            weight = 2 * np.pi * x[0]
            hoop = ufl.conditional(ufl.gt(x[0], 0.0), at[0] / x[0], ufl.grad(at)[0, 0])

        slope = ufl.dot(ufl.grad(T), inverse)
        self.power = weight * hoop * k[0] * J * ufl.dot(slope, slope)
        v, w, dx = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.dx(V.mesh)
        stored = weight * c[0] * self.rate * w
        right = stored * self.before + weight * sources * w
        if current is not None:
            current.rubbed = False
            right += current.power * w
        conducted = ufl.derivative(ufl.derivative(self.power / 2 * dx, T, w), T, v)
        self._left = fem.form(conducted + stored * v * dx)
        self._right = fem.form(right * dx if loads is None else right * dx + loads)
        self._hoop = fem.Expression(hoop, interpolation_points(V))
        area = weight * ufl.sqrt(ufl.dot(turned, turned)) * w
        self._areas = {
            one: fem.form(
                area * ufl.Measure("ds", V.mesh, subdomain_data=side.facet_tags)(side.slave)
            )
            for one, side in ((one, one.interface) for one in self.interfaces)
            if side.master is None
        }

    def solve(self, dt: float | None = None) -> float:
        """Solve for T with the last step's pressures, gaps and friction; collective.

        Args:
            dt: length of the step from the committed temperature; without a capacity only the heat
                of friction depends on it. None for the steady state, without friction.

        Returns:
            Largest change of T against its last value, over the range of T now and before.

        Raises:
            ValueError: if nothing holds T in a body, laws are negative or not finite, and without
                dt if friction heats.
        """
        check_optional("dt", dt, number("a time", above=0.0))
        return max(field._solve_alone(dt) for field in self.fields)

    def _solve_alone(self, dt: float | None) -> float:
        with raised_together(self.comm):
            for name, law, values, dofs in self._laws:
                values.x.array[dofs] = check(name, _number(law), number(above=0.0))
        self.rate.value = 0.0 if dt is None else 1.0 / dt
        A, b = petsc.assemble_matrix(self._left), _assembled(self._right)
        A.assemble()
        held, hoop = np.zeros(len(self.T.x.array), dtype=bool), fem.Function(self.V)
        for bc in self.bcs:
            held[bc.dof_indices()[0]] = True
        hoop.interpolate(self._hoop)
        ties, self._across = list[PETSc.Mat](), list[Any]()
        for one in self.interfaces:
            D, M, nodes = self._sides(one)
            G, size = D - M, D.getRowSum().array
            per_area = 1.0 / np.where(size > 0.0, size, 1.0)
            closed, h = one.values(self.V)
            given = h, one.friction(self.V, dt) * self.rubbed
            h, rate = ((values * hoop.x.array)[nodes] for values in given)
            scaled, factor = G.copy(), D.createVecLeft()
            factor.array = h * per_area
            scaled.diagonalScale(factor)
            A.axpy(1.0, G.transposeMatMult(scaled))
            _spread(b, one.share, D, M, rate, h * _number(one.temperature))
            if one.h is None:
                rows = np.flatnonzero((closed & ~held)[nodes]) + G.getOwnershipRange()[0]
                every = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=self.comm)
                ties.append(G.createSubMatrix(every))
            self._across.append((one, D, M, h, per_area))
        if self.current is not None:
            self.current.add_power(b)
        change = self._solve(A, b, ties, held)
        every = np.concatenate([self.T.x.array, self.before.x.array])
        high, low = maximum(self.comm, every.max(initial=-np.inf), (-every).max(initial=-np.inf))
        return change / max(float(high + low), QUARTER_OF_DIGITS * float(max(high, low)), TINY)

    def commit(self) -> None:
        """Make the temperature that of the start of the next step."""
        for one in self.fields:
            one.before.x.array[:], one.relaxed.last = one.T.x.array, None

    @contextmanager
    def undone(self) -> Iterator[None]:
        """Return to the committed temperature if the block fails."""
        try:
            yield
        except BaseException:
            for one in self.fields:
                one.T.x.array[:], one.relaxed.last = one.before.x.array, None
            raise

    def add_power(self, b: PETSc.Vec) -> None:
        """Add the power of this current at interfaces, after a solution; collective."""
        for one, D, M, h, per_area in self._across:
            drop = ((D - M) * self.T.x.petsc_vec).array * per_area - _number(one.temperature)
            _spread(b, one.share, D, M, h * drop**2)

    def _sides(self, one: Conductance) -> tuple[PETSc.Mat, PETSc.Mat, Longs]:
        """D, M and the slave nodes (rows,); of a tool areas of all nodes, and zero; collective."""
        side = one.interface
        if side.master is None:
            areas = _assembled(self._areas[one])
            D = _diagonal(areas)
            return D, 0.0 * D, np.arange(areas.local_size)
        sides = {"slave": side.slave, "master": side.master}
        mortar = assemble_mortar(self.V, side.facet_tags, **sides, u=self.u, weight=self._weight)
        return mortar.D, mortar.M, mortar.nodes - self.V.dofmap.index_map.local_range[0]

    def _solve(self, A: PETSc.Mat, b: PETSc.Vec, ties: list[PETSc.Mat], held: Bools) -> float:
        """Solve with the Dirichlet conditions and multipliers; return the largest change."""
        n = b.local_size
        for C in ties:
            none = _diagonal(C.createVecLeft())  # whose entries PETSc asks for below
            both = [[A, C.transpose(PETSc.Mat())], [C, none]]
            A = PETSc.Mat().createNest(both, comm=self.comm).convert("aij")
        x, right = A.createVecs()
        right.array[:n] = b.array
        for bc in self.bcs:
            bc.set(x.array, None, 1.0)
        rows = np.flatnonzero(held[:n]) + A.getOwnershipRange()[0]
        A.zeroRowsColumns(rows.astype(PETSc.IntType), 1.0, x, right)
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("lu")
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
                "conductance, or a capacity and dt; or sources, loads, conditions or temperatures "
                "of tools are not finite"
            )
        self.T.x.array[:n] += self.relaxed(way)
        self.T.x.scatter_forward()
        return change


HEAT = instance(Heat, "give a Heat")


LAWS = "conductivity", "capacity"


def _diagonal(values: PETSc.Vec) -> PETSc.Mat:
    """Diagonal matrix with entries, also zeros; collective."""
    D = PETSc.Mat().createAIJ([values.sizes] * 2, nnz=1, comm=values.comm)
    D.setDiagonal(values)
    D.assemble()
    return D


def _assembled(form: fem.Form) -> Any:
    """Vector of a form; collective."""
    b = petsc.assemble_vector(form)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return b


def _spread(b: PETSc.Vec, share: float, D: Any, M: Any, heat: Floats, flux: Any = 0.0) -> None:
    """Add heat per area to both sides by their shares, and a flux into the slave side."""
    values = D.createVecLeft()
    for X, part in ((D, share * heat + flux), (M, (1.0 - share) * heat - flux)):
        values.array = part
        X.multTransposeAdd(values, b, b)


def _on_cells(name: str, given: Any, cell_tags: Any, V: fem.FunctionSpace) -> tuple[Any, list[Any]]:
    """Function of cells, and name, law and its dofs for each entry; collective."""
    values = fem.Function(fem.functionspace(V.mesh, ("DG", 0)))
    if not isinstance(given, Mapping):
        return values, [(name, given, values, slice(None))] * (given is not None)
    found, tags = by_cells(V.mesh, cell_tags, given, name, cover=True)
    dofs = values.function_space.dofmap.list[: len(tags), 0]
    return values, [
        (f"{name}[{tag}]", law, values, dofs[tags == tag]) for tag, law in found.items()
    ]
