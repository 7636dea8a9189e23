# SPDX-License-Identifier: MIT
"""Terms in UFL: dead loads, and weak forms of the displacement.

Both have the weight of the kinematics: t in inner(t, v) * ds is a traction, and forces in
axisymmetry are those of the whole ring.
"""

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import check_real
from dolfinx_mortar.common.tags import check_measures
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import MatrixForm, Term, assemble, create_vector
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

REMEDY = "give its potential instead, ContactProblem(..., potential=...)"


class DeadLoads(Term):
    """Forces independent of the displacement, assembled at the start of a step: Pi(u) = -f.u."""

    linear = True
    has_tangent = False

    def __init__(self, solid: Solid, loads: ufl.Form) -> None:
        """Check and compile a linear form, or raise a ValueError with the remedy; collective."""
        check_form(solid.u, "loads", loads, arguments=1, dead=True)
        self._u = solid.u
        self._form = fem.form(weighted(loads, solid))
        self._vector = create_vector(solid.V)
        self.f = assemble(self._form, self._vector)  # (n,) at owned dofs, a view

    def begin(self, start: float, end: float) -> None:
        """Assemble the forces; collective."""
        assemble(self._form, self._vector)

    def energy(self) -> Floats:
        """Addends -f_i u_i of this rank."""
        return -self.f * self._u.x.array[: self.f.size]

    def add_forces(self, F: PETSc.Vec) -> None:
        """Subtract f."""
        F.array_w[:] -= self.f

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add nothing."""


class WeakForm(Term):
    """A functional Pi(u), or the residual of a weak form, added to that of the bodies.

    With ``energy`` forces and tangent are its first and second derivative. With ``residual``, a
    linear form R(u; v), the forces are R(u; phi_i) and the tangent is the symmetric part of dR/du:
    Newton's method is quadratic if R has a potential, else linear, except with the exact tangent of
    contact, which includes the antisymmetric part.

    Subclasses may have a state: Functions in the form set by `commit`, Constants set by `begin`
    (see the guide).

    Args:
        solid: the bodies, whose ``solid.u`` is in the form.
        energy: functional of ``solid.u``, for example ``0.5 * k * inner(u, u) * ds(3)`` for a bed
            of springs; integrals over cells and exterior facets, times the weight of the solid's
            kinematics.
        residual: linear form of a test function on ``solid.V`` instead.

    Raises:
        ValueError: naming the error and the remedy.
    """

    def __init__(
        self, solid: Solid, *, energy: ufl.Form | None = None, residual: ufl.Form | None = None
    ) -> None:
        """Check and compile the forms; collective."""
        check("WeakForm: solid", solid, instance(Solid, "give the Solid of the bodies"))
        u, V = solid.u, solid.V
        check_same_on_all_ranks(V.mesh.comm, energy=energy, residual=residual)
        name, form = ("energy", energy) if residual is None else ("residual", residual)
        if (energy is None) == (residual is None):
            raise ValueError("WeakForm: give either energy= or residual=")
        check_form(u, name, form, arguments=0 if residual is None else 1)
        form = _with_one_rule(weighted(form, solid))
        forces = ufl.derivative(form, u, ufl.TestFunction(V)) if residual is None else form
        du = ufl.TrialFunction(V)
        tangent = expand_derivatives(ufl.derivative(forces, u, du))
        self._asymmetric: ufl.Form | None = None
        self._skew: tuple[MatrixForm, PETSc.Mat] | None = None
        if residual is not None and not tangent.empty():
            self._asymmetric = tangent
            tangent = expand_derivatives(0.5 * (tangent + ufl.adjoint(tangent)))
        self.u = u
        self.linear = u not in tangent.coefficients()
        self._energy = fem.form(form) if residual is None else None
        self._forces = fem.form(forces)
        self._tangent = None if tangent.empty() else MatrixForm(fem.form(tangent))
        self._vector = create_vector(V)
        self._given = {name: form}

    def given(self) -> Mapping[str, Any]:
        """Arguments that must agree on all ranks, see `agreement`."""
        return self._given

    def _update(self) -> None:
        """Update the coefficients before an assembly; collective."""

    def energy(self) -> float | None:
        """Return this rank's share of Pi(u), None for a residual."""
        return None if self._energy is None else float(fem.assemble_scalar(self._energy))

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add dPi/du or R(u; .) to the owned part of F; collective."""
        self._update()
        F.array_w[:] += assemble(self._forces, self._vector)[: F.local_size]

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add the second derivative; collective."""
        if self._tangent is not None:
            self._update()
            self._tangent.add_to(K)

    def skew(self) -> PETSc.Mat | None:
        """Antisymmetric part of dR/du, valid until the next call; collective."""
        if self._asymmetric is None:
            return None
        if self._skew is None:
            half = expand_derivatives(0.5 * (self._asymmetric - ufl.adjoint(self._asymmetric)))
            form = fem.form(half)
            self._skew = MatrixForm(form), fem_petsc.create_matrix(form)
        self._update()
        part, A = self._skew
        A.zeroEntries()
        part.add_to(A)
        A.assemble()
        return A


WANTED = (
    "give a functional of solid.u, for example 0.5 * k * inner(u, u) * ds",
    "give a linear form of solid.u and a test function, for example k * inner(u, v) * ds",
    "give a linear form, for example inner(t, v) * ds",
)


def check_form(
    u: fem.Function, name: str, form: Any, *, arguments: int = 0, dead: bool = False
) -> None:
    """Raise a ValueError unless a form over cells and exterior facets can be added; collective.

    `arguments`: number of test functions; `dead`: u is forbidden.
    """
    wanted = WANTED[arguments + dead]
    if not isinstance(form, ufl.Form):  # its repr may fill pages
        compiled = "compiled form, not in UFL" if isinstance(form, fem.Form) else ""
        raise ValueError(f"{name} is a {compiled or type(form).__name__}: {wanted}")
    check_real(name, *form.coefficients(), *form.constants())
    count = len(form.arguments())
    if count != arguments:
        raise ValueError(f"{name} has {count} test or trial functions: {wanted}")
    kinds = sorted({i.integral_type() for i in form.integrals()} - {"cell", "exterior_facet"})
    if kinds and not dead:
        raise ValueError(
            f"{name}: integrals over {', '.join(kinds)}; only cells (dx) and exterior facets "
            "(ds) are possible"
        )
    mine = [c for c in form.coefficients() if _is_displacement(u, c)]
    if dead and mine:
        raise ValueError(f"{name} contain the displacement solid.u ({u.name}): {REMEDY}")
    if any(c is not u for c in mine):
        raise ValueError(f"{name} contains u.sub(i), which UFL cannot differentiate: write u[i]")
    V = u.function_space
    if any(v.ufl_function_space() != V.ufl_function_space() for v in form.arguments()):
        raise ValueError(
            f"{name}: the test function belongs to another space; make it with "
            "TestFunction(u.function_space)"
        )
    others = {c.ufl_function_space().ufl_domain() for c in form.coefficients()}
    if {*others, *form.ufl_domains()} != {V.mesh.ufl_domain()}:
        raise ValueError(f"{name} is, or has a Function, on another mesh than solid.u")
    if not mine and not dead:
        raise ValueError(
            f"{name} does not contain the displacement solid.u, so it exerts no force: write it "
            "with that very Function"
        )
    check_measures(name, form, V.mesh)


def weighted(form: ufl.Form, solid: Solid) -> ufl.Form:
    """A form times the weight of the kinematics."""
    kinematics = solid.kinematics
    if kinematics.unweighted:
        return form
    factor = ufl.as_ufl(kinematics.weight(ufl.SpatialCoordinate(solid.mesh)))
    return ufl.Form([i.reconstruct(integrand=factor * i.integrand()) for i in form.integrals()])


def _with_one_rule(form: ufl.Form) -> ufl.Form:
    """A form whose derivatives have its own quadrature."""
    integrals = []
    for integral in expand_derivatives(form).integrals():
        metadata = dict(integral.metadata())
        if metadata.get("quadrature_degree", -1) in (-1, "auto"):
            degree = estimate_total_polynomial_degree(integral.integrand())
            metadata["quadrature_degree"] = degree
        integrals.append(integral.reconstruct(metadata=metadata))
    return ufl.Form(integrals)


def _is_displacement(u: fem.Function, coefficient: Any) -> bool:
    """Whether a coefficient is u or shares its values, as u.sub(i) does."""
    return isinstance(coefficient, fem.Function) and (coefficient.x._cpp_object is u.x._cpp_object)
