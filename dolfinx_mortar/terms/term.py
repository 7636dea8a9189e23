# SPDX-License-Identifier: MIT
"""A term of the energy: what a class needs to take part in a contact problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Ints


class Term:
    """Energy Pi(u) that a step minimises with that of the bodies: the base of your own terms.

    Pass instances in ``ContactProblem(..., terms=[...])``. The problem adds up

        Pi(u),   F_i = dPi/du_i,   K_ij = d2Pi/du_i du_j

    of all its terms; `WeakForm` does this for UFL. Write here what UFL does not reach: forces
    between far points, tables, other programs. Of what is collective, a method may only do what
    all ranks reach: an error is raised on all of them after the call.

    Attributes:
        linear: whether K is constant in a step, so that it need not be assembled at every iterate.
        has_tangent: whether K is not zero.
        couplings: global dofs (k,) that K couples beyond the pattern of the mesh, an array for each
            dense block of k x k entries, the same on all ranks or each on one of them.
        state: Functions on ``solid.V`` or its scalar space, by name, that `commit` sets: what the
            next step starts from, and what a checkpoint holds.
    """

    linear: bool = False
    has_tangent: bool = True
    couplings: Sequence[Ints] = ()

    @property
    def state(self) -> Mapping[str, fem.Function]:
        """Functions that go on from step to step, by name."""
        return {}

    def energy(self) -> float | Floats | None:
        """Return this rank's share of Pi(u), or its addends; None if there is no potential.

        Then there is no line search: Newton's steps are whole.
        """
        return None

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add F_i to the internal forces, ``F.array`` of owned dofs or ``F.setValues`` of any."""
        raise NotImplementedError

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add K_ij, symmetric, with ``K.setValues(.., addv=True)``, on the pattern that K has."""
        raise NotImplementedError

    def begin(self, start: float, end: float) -> None:
        """Prepare a step.

        Args:
            start: load level of the committed state.
            end: load level of the step; that of `load_steps`, or ``level`` of `newton`.
        """

    def commit(self) -> None:
        """Make the converged step the state from which the next one starts."""

    def roll_back(self) -> None:
        """Forget a step that has failed; the committed state stands as it is."""


def check_terms(comm: MPI.Comm, terms: Any, V: fem.FunctionSpace) -> list[Term]:
    """Return terms as a list if they can take part; collective.

    Raises:
        ValueError: on all ranks, naming what is missing.
    """
    with raised_together(comm):
        if not isinstance(terms, Sequence) or isinstance(terms, str):
            raise ValueError(f"terms is {terms!r}: give a list of terms, [] for none")
        for k, term in enumerate(terms):
            if isinstance(term, type) or not isinstance(term, Term):
                raise ValueError(
                    f"terms[{k}] is {term!r}: give an instance of a subclass of dolfinx_mortar.Term"
                )
            if any(term is other for other in terms[:k]):
                raise ValueError(f"terms holds the same object {term!r} twice: give it once")
            for name in ("add_forces", "add_tangent"):
                if getattr(type(term), name) is getattr(Term, name):
                    raise ValueError(f"terms[{k}], a {type(term).__name__}, lacks {name}(): define")
            _check_state(k, term, V)
    return list(terms)


def _check_state(k: int, term: Term, V: fem.FunctionSpace) -> None:
    """Raise a ValueError unless the state of a term is made of nodal Functions on the mesh of V."""
    what = f"state of terms[{k}], a {type(term).__name__}"
    if not isinstance(term.state, Mapping):
        raise ValueError(f"{what}, is {term.state!r}: give a dictionary of Functions by name")
    nodes = V.dofmap.index_map
    for name, f in term.state.items():
        if not (isinstance(name, str) and name and "/" not in name):
            raise ValueError(f"{what}, has the name {name!r}: give a text without '/'")
        layout = f.function_space.dofmap.index_map if isinstance(f, fem.Function) else None
        if (
            layout is None
            or f.function_space.mesh is not V.mesh
            or ((layout.size_global, layout.size_local) != (nodes.size_global, nodes.size_local))
        ):
            raise ValueError(
                f"{what}: {name!r} is {f!r}: give a Function on solid.V or its scalar space"
            )
