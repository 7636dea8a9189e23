# SPDX-License-Identifier: MIT
"""External loads: a linear form of the virtual work, and a potential of the displacement.

One step minimises J(v) = Psi(v) + Pi(v) - f.v. Forces f that do not depend on the displacement are
the linear form `loads`; what depends on it (springs, elastic foundations, conservative pressure) is
the potential Pi, whose derivatives UFL takes, so that forces and tangent always fit.

Both get the weight of the kinematics, as do the integrals over the bodies: t in inner(t, v) * ds is
a traction whatever the kinematics, and the forces are those of the whole ring where these are
axisymmetric.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.spaces import check_real
from ufl.algorithms import estimate_total_polynomial_degree, expand_derivatives

REMEDY = "give its potential instead, ContactProblem(..., potential=...)"


class Loads:
    """External forces and potential of a problem, compiled once.

    Attributes:
        V: space of the displacement.
        has_potential: whether there is a potential.
        linear: whether the potential is at most quadratic in u, so that its tangent is constant.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        u: fem.Function,
        loads: ufl.Form | None = None,
        potential: ufl.Form | None = None,
        weight: Callable[[Any], Any] | None = None,
    ) -> None:
        """Check the arguments and compile all forms; collective.

        Args:
            V: vector Lagrange space of the displacement.
            u: displacement, a Function of V.
            loads: linear form of the external virtual work, without u.
            potential: functional of u in energy, for example ``0.5 * k * inner(u, u) * ds(3)``
                for a bed of springs; integrals over cells and exterior facets.
            weight: factor of all their integrals by the coordinates, 1 if not given.

        Raises:
            ValueError: if one of the forms cannot work, with the remedy.
        """
        check_loads(u, loads)
        check_potential(u, potential)
        loads, potential = (_weighted(form, V, weight) for form in (loads, potential))
        potential = None if potential is None else _with_one_rule(potential)
        self.V = V
        self.has_potential = potential is not None
        self._loads = None if loads is None else fem.form(loads)
        self._energy = None if potential is None else fem.form(potential)
        self._forces: Any = None
        self._tangent: Any = None
        self.linear = True
        if potential is not None:
            forces = ufl.derivative(potential, u, ufl.TestFunction(V))
            tangent = expand_derivatives(ufl.derivative(forces, u, ufl.TrialFunction(V)))
            self._forces = fem.form(forces)
            self._tangent = None if tangent.empty() else fem.form(tangent)
            self.linear = u not in tangent.coefficients()
        self._local = la.vector(V.dofmap.index_map, V.dofmap.bs)

    def assemble(self, f: PETSc.Vec) -> None:
        """Fill the owned part of f with the forces of the linear form at its coefficients."""
        f.array_w[:] = self._assembled(self._loads, f.local_size)

    def energy(self) -> float:
        """Return the potential Pi(u), the sum over all ranks; 0 without one."""
        if self._energy is None:
            return 0.0
        local = float(fem.assemble_scalar(self._energy))
        return float(self.V.mesh.comm.allreduce(local, op=MPI.SUM))

    def check_potential(self) -> None:
        """Raise a ValueError unless the potential is finite at the present u; collective."""
        energy = self.energy()
        if not np.isfinite(energy):
            raise ValueError(
                f"potential is {energy} at the present displacement: check its coefficients"
            )

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add dPi/du to the owned part of the internal forces F; collective."""
        if self._forces is not None:
            F.array_w[:] += self._assembled(self._forces, F.local_size)

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add the second derivative of Pi to an assembled K, on the pattern it has; collective.

        K stays symmetric; whether it stays definite is the potential's affair (a soft foundation
        is harmless, a load that grows with the displacement need not be).
        """
        if self._tangent is not None:
            fem_petsc.assemble_matrix(K, self._tangent)
            K.assemble()

    def _assembled(self, form: fem.Form | None, size: int) -> np.ndarray:
        """Return the owned values of a linear form, zero for none; collective."""
        self._local.array[:] = 0.0
        if form is not None:
            fem.assemble_vector(self._local.array, form)
            self._local.scatter_reverse(la.InsertMode.add)
        return self._local.array[:size]


def check_loads(u: fem.Function, loads: Any) -> None:
    """Raise ValueError if the loads depend on the displacement.

    They are assembled once at the start of a step; with the displacement inside, the answer would
    be that of forces of the step before.
    """
    if isinstance(loads, ufl.Form) and any(_is_displacement(u, c) for c in loads.coefficients()):
        raise ValueError(f"loads contain the displacement solid.u ({u.name}): {REMEDY}")


def check_potential(u: fem.Function, potential: Any) -> None:
    """Raise ValueError unless a potential is a functional of the displacement that can be added."""
    wanted = "give a functional of solid.u, for example 0.5 * k * inner(u, u) * ds"
    if potential is None:
        return
    if isinstance(potential, fem.Form):
        raise ValueError(f"potential is a compiled form: {wanted}, in UFL as before fem.form")
    if not isinstance(potential, ufl.Form):  # its repr may fill pages
        raise ValueError(f"potential is a {type(potential).__name__}: {wanted}")
    check_real("potential", *potential.coefficients(), *potential.constants())
    if potential.arguments():
        count = len(potential.arguments())
        raise ValueError(f"potential has {count} test or trial functions, not none: {wanted}")
    kinds = sorted({i.integral_type() for i in potential.integrals()} - {"cell", "exterior_facet"})
    if kinds:
        raise ValueError(
            f"potential: integrals over {', '.join(kinds)}; only cells (dx) and exterior facets "
            "(ds) are possible"
        )
    _check_spaces(u, potential)


def _check_spaces(u: fem.Function, potential: ufl.Form) -> None:
    """Raise ValueError unless a potential contains u itself, and lives on its mesh only."""
    coefficients = potential.coefficients()
    parts = [c for c in coefficients if c is not u and _is_displacement(u, c)]
    if parts:
        raise ValueError("potential contains u.sub(i), which UFL cannot differentiate: write u[i]")
    domain = u.function_space.mesh.ufl_domain()
    if any(other != domain for other in potential.ufl_domains()):
        raise ValueError("potential is on another mesh than solid.u: integrate over solid.mesh")
    for c in coefficients:
        if c.ufl_function_space().ufl_domain() != domain:
            raise ValueError(f"potential: the Function {c} is on another mesh than solid.u")
    if not any(c is u for c in coefficients):
        raise ValueError(
            "potential does not contain the displacement solid.u, so it exerts no force: write it "
            "with that very Function"
        )


def _weighted(
    form: ufl.Form | None, V: fem.FunctionSpace, weight: Callable[[Any], Any] | None
) -> ufl.Form | None:
    """Return a form with a factor in all integrals."""
    if form is None or weight is None:
        return form
    factor = ufl.as_ufl(weight(ufl.SpatialCoordinate(V.mesh)))
    return ufl.Form([i.reconstruct(integrand=factor * i.integrand()) for i in form.integrals()])


def _with_one_rule(potential: ufl.Form) -> ufl.Form:
    """Return a functional whose derivatives are integrated at the same points as itself.

    UFL chooses the rule by the integrand, and chooses another for the derivative of a function
    that is no polynomial: forces would then not be the derivative of the energy that is computed.
    """
    integrals = []
    for integral in expand_derivatives(potential).integrals():
        metadata = dict(integral.metadata())
        if metadata.get("quadrature_degree", -1) in (-1, "auto"):
            degree = estimate_total_polynomial_degree(integral.integrand())
            metadata["quadrature_degree"] = degree
        integrals.append(integral.reconstruct(metadata=metadata))
    return ufl.Form(integrals)


def _is_displacement(u: fem.Function, coefficient: Any) -> bool:
    """Tell whether a coefficient is u or shares its values, as u.sub(i) does; also without any."""
    return isinstance(coefficient, fem.Function) and (coefficient.x._cpp_object is u.x._cpp_object)
