# SPDX-License-Identifier: MIT
"""Residual and QP subproblem at a Newton iterate, as immutable records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from petsc4py import PETSc

import numpy as np

from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.congruence import CongruentOperator, OperatorOfBases, as_aij
from dolfinx_mortar.algebra.parallel import any_rank, largest
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Actives, Floats, Ints
from dolfinx_mortar.interfaces.basis import Transformation
from dolfinx_mortar.interfaces.constraints import Constraints, SlipLimits, equalities, join
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.moving_geometry import GeometryTangent
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.mortar.surface import coordinates, sum_at_nodes
from dolfinx_mortar.problem.checks import StepData
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import BoundQP, Friction, QPSolution
from dolfinx_mortar.qp.preconditioner import interface_unknowns
from dolfinx_mortar.solid.kinematics import on_axis


@dataclass(frozen=True)
class Balance:
    """Residual forces and constraints at the present u and geometry."""

    r: PETSc.Vec  # (n,) -dJ/du, external minus internal forces
    reduced: PETSc.Vec  # (n,) T^T r
    equal: Constraints  # of Dirichlet data and ties
    bounds: Constraints  # of contact
    elements: float  # norm of the unassembled element forces
    external: float  # largest norm of the forces of one term
    limits: SlipLimits | None = None
    from_committed: bool = False  # bodies are linearised about the committed state
    friction: Floats | None = None  # (n,) part of r at prescribed slips
    give: Floats | None = None  # (k,) wear per reaction, on all ranks or on none

    def known(self, multipliers: Floats) -> Floats:
        """Friction reactions (owned nodes, d) at prescribed slips."""
        found = np.zeros((len(multipliers), self.reduced.getBlockSize()))
        if self.limits is not None:
            found[self.limits.nodes] = self.limits.known(multipliers)
        return found

    @property
    def nodes(self) -> Ints:
        """Owned nodes (k,) of the bounded unknowns."""
        return np.asarray(self.bounds.dofs // self.reduced.getBlockSize(), dtype=np.int32)

    @property
    def eliminated(self) -> Ints:
        """Owned unknowns (m,) that are eliminated, ascending."""
        return np.sort(self.equal.dofs)


@dataclass(frozen=True)
class Linearisation:
    """Quadratic program of one iterate."""

    qp: BoundQP
    balance: Balance
    diagonal: PETSc.Vec  # (n,) of K^ before the elimination
    geometry: GeometryTangent | None = None
    drives: Any = None  # `driven_tools.Drives`


def find_extent(mesh: Mesh, displacement: Floats) -> float:
    """Largest coordinate of the mesh plus the largest displacement; collective."""
    return largest(mesh.comm, mesh.geometry.x) + largest(mesh.comm, displacement)


def find_balance(
    problem: ContactProblem,
    data: StepData,
    overlap: float = 0.0,
    multipliers: Floats | None = None,
    *,
    from_committed: bool = False,
) -> Balance:
    """Assemble forces and constraints at the present u; collective.

    Args:
        overlap: depth of an initial overlap left to later steps.
        multipliers: lambda_j (owned nodes,), for friction at prescribed slips.
        from_committed: linearise forces of bodies about the committed state.
    """
    with problem.timings("assembly"):
        r = problem.vector()
        external = problem.terms.assemble_forces(r, from_committed=from_committed)
        elements = problem.solid.element_force_norm()
        r.scale(-1.0)
    with problem.timings("transform"):
        u = problem.vector(problem.u.x.array[: r.local_size])
        found = problem.system.constraints(problem.positions(), u)
        dofs, slots = support_slots(problem)
        asked = equalities(slots, data.target[dofs] - u.array_r[dofs])
        limits = None
        if data.limits:
            u.array[:] -= problem.committed.displacement
            now = _present_limits(problem, data.limits)
            limits = problem.system.slip_limits(u, now, data.partners, problem.committed.sliding)
        friction = None
        if limits is not None and multipliers is not None:
            if any_rank(problem.comm, limits.shares.any())[0]:
                forces = np.zeros((problem.n, problem.d))
                forces[limits.nodes] = limits.known(multipliers)
                friction = -problem.system.exert(forces).ravel()
                r.array[:] += friction
        reduced = to_reduced(problem.system.transformation, r)
    equal, bounds = found.select(found.equal), found.select(~found.equal)
    if overlap > 0.0:
        bounds = replace(bounds, upper=bounds.upper + overlap)
    supported = join([asked, equal])
    at = r, reduced, supported, bounds, elements, external, limits
    give = None
    if any(link.interface.wear is not None for link in problem.system.links):
        give = wear_rates(problem, limits)[bounds.dofs // problem.d] / bounds.weight
    return Balance(*at, from_committed, friction, give)


def wear_rates(
    problem: ContactProblem, limits: SlipLimits | None, *, implicit: bool = True
) -> Floats:
    """Wear per multiplier lambda_j (owned nodes,), of implicit or explicit wear; collective."""
    found, slid = np.zeros((2, problem.n))
    if limits is not None:
        slid[limits.nodes] = np.linalg.norm(limits.vectors(limits.slip) + limits.beside, axis=1)
    for link in problem.system.links:
        worn, nodes = cast(Any, link.interface), link.nodes
        if worn.wear is not None and worn.wear.implicit == implicit:
            rates = worn.wear_rates(nodes, slid[nodes]) / growth(problem, link)
            found[nodes] = np.where(link.constrained[:, 0], rates, found[nodes])
    return found


def _present_limits(
    problem: ContactProblem, limits: Sequence[Floats | None]
) -> Sequence[Floats | None]:
    """Coefficients, and tractions per present circumference; collective."""
    if problem.solid.strain != "finite":
        return limits
    now: list[Floats | None] = []
    for link, limit in zip(problem.system.links, limits, strict=True):
        if limit is not None and link.acts_openly:
            limit = limit.copy()
            limit[link.nodes] *= growth(problem, link)
        now.append(limit)
    return now


def growth(problem: ContactProblem, link: Link) -> Floats:
    """Ratio (n,) of present to initial circumference at the slave nodes; collective.

    In axisymmetry D has the present section, but 2 pi r at X. On the axis the mean of other nodes
    of the facets; one elsewhere and at X.
    """
    kinematics, slave = problem.solid.kinematics, link.sides.slave
    u = None if link.interface.stays else problem.configuration
    if kinematics.radius is None or u is None:
        return np.ones(len(link.nodes))
    now, at_X = (kinematics.weight(x.T) for x in (coordinates(slave, u), slave.X))
    # zero on the axis, undefined beyond
    known = ~on_axis(kinematics, problem.V.mesh, slave.X) & (now > 0.0)
    factor = np.where(known, now / np.where(known, at_X, 1.0), 0.0)
    columns = np.stack([factor, known], axis=1)[slave.facets].sum(axis=1, keepdims=True)
    around = sum_at_nodes(slave, np.repeat(columns, slave.facets.shape[1], axis=1))
    mean = around[:, 0] / np.maximum(around[:, 1], 1.0)
    return np.where(known, factor, mean)[: slave.owned]


def support_slots(problem: ContactProblem) -> tuple[Ints, Ints]:
    """Owned prescribed dofs (m,), and their unknowns in y."""
    node, component = np.nonzero(problem.supports.owned)
    slots = problem.d * node + problem.system.slots()[node, component]
    return problem.d * node + component, slots


def linearise(
    problem: ContactProblem,
    balance: Balance,
    *,
    tangent: bool = True,
    shift: float = 0.0,
    pressure: Floats | None = None,
    moving: tuple[Floats, Floats | None, Sequence[Partners | None]] | None = None,
) -> Linearisation:
    """Assemble min 1/2 dy.K^ dy - r^.dy with its bounds at the present u; collective.

    With moving surfaces K^ = T^T (K + H) T_g is unsymmetric (`interfaces.moving_geometry`); with
    multigrid it is an operator, preconditioned by T^T K T.

    Args:
        tangent: assemble K anew; linear laws need it once.
        shift: multiple of the elastic stiffness added to an indefinite K.
        pressure: mean stresses of a linearisation.
        moving: for the exact tangent lambda_j (owned nodes,), tangential tractions (owned nodes,
            d), and the partners of each interface with friction.
    """
    T, K, geometry, direct = problem.system.transformation, problem.K, None, problem.linear.direct
    if moving is not None:
        multipliers, tangential, partners = moving
        with problem.timings("mortar"):
            moved = problem.vector(problem.owned_u - problem.committed.displacement)
            at = problem.u, multipliers, tangential, (moved, partners)
            geometry = problem.system.linearise_geometry(*at)
    spoilt = direct and T is None  # the elimination acts on K itself
    with problem.timings("assembly"):
        if tangent or spoilt or not K.isAssembled():
            first = balance.from_committed
            problem.terms.assemble_tangent(K, pressure, from_committed=first)
            if shift > 0.0:
                problem.solid.forms.add_elastic(K, shift)
        if geometry is not None:
            geometry.forces += problem.terms.skews()
    with problem.timings("transform"):
        A, b, diagonal, product = _reduced(problem, balance, geometry)
        bounds = balance.bounds
        lower, upper = problem.vector(), problem.vector()
        lower.set(PETSc.NINFINITY)
        upper.set(PETSc.INFINITY)
        lower.array[bounds.dofs] = np.maximum(bounds.lower, PETSc.NINFINITY)
        upper.array[bounds.dofs] = np.minimum(bounds.upper, PETSc.INFINITY)
    law = None
    if (limits := balance.limits) is not None:
        position = np.zeros(b.local_size, dtype=np.int32)
        position[bounds.dofs] = np.arange(len(bounds.dofs))
        law = Friction(position[limits.normal], limits.tangential, -limits.slip, *limits.left)
    give = balance.give
    if give is not None:  # without what is round-off beside the compliance of the bodies
        stiffness = np.abs(diagonal.array_r[bounds.dofs])
        give = np.where(give * stiffness > HALF_OF_DIGITS, give, 0.0)
    qp = BoundQP(
        *(A, b, lower, upper, bounds.dofs, law),
        definite=geometry is None,
        product=product,
        near=None if direct or geometry is None else problem.operator.matrix,
        extent=find_extent(problem.V.mesh, problem.u.x.array),
        give=give,
    )
    return Linearisation(qp, balance, diagonal, geometry)


def _reduced(
    problem: ContactProblem, balance: Balance, geometry: GeometryTangent | None
) -> tuple[PETSc.Mat, PETSc.Vec, PETSc.Vec, CongruentOperator | None]:
    """K^ and r^ after the elimination, its diagonal before, and K^ as an operator to factorise."""
    T, K = problem.system.transformation, problem.K
    held, operator, linear = balance.eliminated, problem.operator, problem.linear
    exact, direct = geometry is not None, linear.direct
    change = None if T is None or (direct and exact) else T.change
    formed = direct  # a factorisation needs the matrix
    if direct and not exact and not problem.system.driven:
        formed = interface_unknowns(K, change, linear.options) is None
    if not formed:
        operator.follow(change, held)
    if geometry is not None and T is not None:
        if direct:
            return *_eliminated(problem, balance, geometry.transform(K, T)), None
        at = geometry.follow(K, T, held, operator.diagonal)
        return *_lifted(problem, balance, at), None
    if not formed:
        return *_lifted(problem, balance, operator), operator if direct else None
    if T is not None and not T.formed:
        linear.clear()  # free the memory for the new product
    A = as_aij(K) if T is None else T.transform(K)
    return *_eliminated(problem, balance, A), None


def corrected(lin: Linearisation, solved: QPSolution) -> tuple[Linearisation, float]:
    """QP with the parts of gap rows that T_g neglects, at a solution; collective.

    Returns:
        The QP of the exact tangent with corrected bounds, and the largest force by their change.
    """
    assert lin.geometry is not None
    dofs, bounds, comm = lin.balance.bounds.dofs, lin.balance.bounds, lin.qp.comm
    closing = lin.geometry.closing(to_displacement(lin.geometry.trial, solved.x))
    found = np.where(closing != 0.0, closing - solved.x.array_r, 0.0)
    law, acting = lin.qp.friction, dofs[solved.active > 0]
    if law is not None:
        slips = law.some & law.acts(solved.active[law.normal] > 0)[:, None]
        acting = np.concatenate([acting, law.tangential[slips]])
    force = np.abs(lin.diagonal.array_r[acting] * found[acting])
    left = largest(comm, force)
    upper = lin.qp.upper.copy()
    upper.array[dofs] = np.minimum(bounds.upper - found[dofs], PETSc.INFINITY)
    if law is not None and lin.balance.limits is not None:
        law = replace(law, rest=-lin.balance.limits.slip - law.pick(found))
    return replace(lin, qp=replace(lin.qp, upper=upper, friction=law)), left


def _eliminated(
    problem: ContactProblem, balance: Balance, A: PETSc.Mat
) -> tuple[PETSc.Mat, PETSc.Vec, PETSc.Vec]:
    """Eliminate prescribed unknowns from A; return A, r^ after, and its diagonal before."""
    b, dy = balance.reduced.copy(), problem.vector()
    dy.array[balance.equal.dofs] = balance.equal.upper
    diagonal = A.getDiagonal()
    rows = (balance.eliminated + problem.first_dof).astype(PETSc.IntType)
    A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    A.zeroRowsColumns(rows, diag=diagonal.sum() / diagonal.getSize(), x=dy, b=b)
    return A, b, diagonal


def _lifted(
    problem: ContactProblem, balance: Balance, operator: OperatorOfBases
) -> tuple[PETSc.Mat, PETSc.Vec, PETSc.Vec]:
    """As `_eliminated`, for an operator."""
    dy, b = problem.vector(), balance.reduced.copy()
    dy.array[balance.equal.dofs] = balance.equal.upper
    if dy.norm(PETSc.NormType.INFINITY) != 0.0:  # zero once supports have their values
        operator.product(dy, b)
        b.aypx(-1.0, balance.reduced)
    b.array[balance.equal.dofs] = operator.scale * balance.equal.upper
    return operator.matrix, b, problem.operator.diagonal.copy()


def count_changes(lin: Linearisation, solved: QPSolution, start: Actives, limit: float) -> int:
    """Number of changes of the active set above a force ``limit``; collective."""
    bounds = lin.balance.bounds
    z = np.abs(solved.z.array_r[bounds.dofs])
    opening = np.abs(bounds.upper - solved.x.array_r[bounds.dofs])
    force = np.maximum(z, lin.diagonal.array_r[bounds.dofs] * opening)
    changed = ((start > 0) != (solved.active > 0)) & (force > limit)
    return int(lin.qp.comm.allreduce(int(changed.sum())))


def to_reduced(T: Transformation | None, forces: PETSc.Vec) -> PETSc.Vec:
    """Return T^T f; None is the identity; collective."""
    result = forces.copy()
    if T is not None:
        T.apply_transposed(forces, result)
    return result


def to_displacement(T: Transformation | None, dy: PETSc.Vec) -> PETSc.Vec:
    """Return T dy; None is the identity; collective."""
    du = dy.copy()
    if T is not None:
        T.apply(dy, du)
    return du
