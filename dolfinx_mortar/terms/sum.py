# SPDX-License-Identifier: MIT
"""The sum over bodies and terms: energy, forces and tangent of a problem."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.csr import owned_rows
from dolfinx_mortar.algebra.parallel import (
    any_rank,
    is_defined_here,
    is_ours,
    maximum,
    raised_together,
)
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import array, check, instance, number
from dolfinx_mortar.common.arrays import QUARTER_OF_DIGITS, ROUND_OFF, TINY, Bools, Floats, Ints
from dolfinx_mortar.solid.mean_volume import VolumeStep
from dolfinx_mortar.solid.solid import Solid, add_first_forces, add_first_tangent
from dolfinx_mortar.solid.term import Term, ask_term
from dolfinx_mortar.terms.loads import PointTerm

NO_PLACE = (
    "an entry lies beyond the pattern of the matrix: declare the dofs in couplings, an array of "
    "global numbers for all that are coupled to each other"
)
OUT_OF_RANGE = 63  # PETSC_ERR_ARG_OUTOFRANGE


@dataclass(frozen=True)
class Energy:
    """J(u), and the sum of the absolute values of its addends."""

    value: float
    terms: float


@dataclass(frozen=True)
class Terms:
    """J(u) = Psi(u) + sum_k Pi_k(u), its first and second derivative; Psi of the bodies."""

    solid: Solid
    named: Sequence[tuple[str, Term]]  # Pi_k, with their names in messages

    @property
    def _every(self) -> list[tuple[str, Term]]:
        """The bodies, then the other terms."""
        return [("solid", self.solid), *self.named]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.solid.mesh.comm

    @property
    def linear(self) -> bool:
        """Whether the tangent is constant within a step."""
        return all(term.linear for _, term in self._every)

    def vary(self, K: PETSc.Mat) -> bool:
        """Whether the tangent may differ from K on any rank; collective."""
        found = [self._ask(name, term, Term.varies, K) for name, term in self.stiff]
        found += [region.varying for region in self.solid.regions]
        return bool(any_rank(self.comm, any(found))[0])

    @property
    def stiff(self) -> list[tuple[str, Term]]:
        """Terms other than the bodies that have a tangent."""
        return [(name, term) for name, term in self.named if term.has_tangent]

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> Energy | None:
        """J(u), None if a term has none; collective.

        `along` a step with its linearised volumes, see `Solid.energy`.
        """
        sums = np.zeros(3)
        for name, term in self._every:
            given = (along,) if term is self.solid else ()
            addends = self._ask(name, term, Term.energy, *given, then=_addends)
            sums += (0, 0, 1) if addends is None else (addends.sum(), np.abs(addends).sum(), 0)
        self.comm.Allreduce(MPI.IN_PLACE, sums)
        return None if sums[2] > 0.0 else Energy(sums[0], sums[1])

    def assemble_forces(self, F: PETSc.Vec, *, from_committed: bool = False) -> float:
        """Fill F with dJ/du; return the largest norm of the forces of a term; collective.

        Not of the bodies, whose scale are unassembled element forces. `from_committed`: see
        `Solid.add_first_forces`.
        """
        F.array_w[:] = 0.0
        if from_committed:
            add_first_forces(self.solid, F)
        else:
            self.solid.add_forces(F)
        one, largest = F.duplicate(), 0.0
        for name, term in self.named:
            one.array_w[:] = 0.0
            self.add_forces([(name, term)], one)
            if not is_ours(term) and not np.isfinite(one.norm()):
                raise ValueError(f"{name}: add_forces gives NaN or infinity at the present u")
            largest = max(largest, float(one.norm()))
            F.axpy(1.0, one)
        return largest

    def add_forces(self, named: Sequence[tuple[str, Term]], F: PETSc.Vec) -> None:
        """Add the forces of some terms; collective."""
        for name, term in named:
            self._ask(name, term, Term.add_forces, F, then=_nothing)
        F.assemble()

    def assemble_tangent(
        self, K: PETSc.Mat, pressure: Floats | None = None, *, from_committed: bool = False
    ) -> None:
        """Fill K with d2J/du2, symmetric; collective.

        `pressure`: see `Solid.add_tangent`; `from_committed`: see `Solid.add_first_tangent`.
        """
        K.zeroEntries()
        if from_committed:
            add_first_tangent(self.solid, K)
        else:
            self.solid.add_tangent(K, pressure)
        self.add_tangents(K)

    def add_tangents(self, K: PETSc.Mat) -> None:
        """Add tangents of all terms but the bodies; a ValueError for NaN, infinity; collective."""
        if self._of_users:
            K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        before = K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["mallocs"]
        for name, term in self.stiff:
            self._ask(name, term, Term.add_tangent, K, then=_nothing)
        K.assemble()
        if not self._of_users:
            return
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        if K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["mallocs"] > before:
            raise ValueError(f"{self._of_users}: add_tangent(): {NO_PLACE}")
        if not np.isfinite(K.norm()):
            raise ValueError(
                f"{self._of_users}: add_tangent gives NaN or infinity at the present u"
            )

    def skews(self) -> list[PETSc.Mat]:
        """Antisymmetric parts, always of the same terms; collective."""
        found = [self._ask(name, term, Term.skew) for name, term in self.named]
        return [A for A in found if A is not None]

    @property
    def _of_users(self) -> str:
        return "; ".join(name for name, term in self.stiff if not is_ours(term))

    def stiffness(self) -> PETSc.Mat:
        """Tangent of all terms but the bodies; collective.

        Raises:
            ValueError: on all ranks, for NaN, infinity, and a user's unsymmetric tangent.
        """
        K = self.create_matrix()
        K.zeroEntries()
        self.add_tangents(K)
        if not self._of_users:
            return K
        # v.K w = w.K v for random v, w
        v, w = K.createVecs()
        rng = np.random.default_rng(self.comm.rank)
        v.array[:], w.array[:] = rng.normal(size=(2, v.local_size))
        skew = abs(v.dot(K * w) - w.dot(K * v))
        if skew > QUARTER_OF_DIGITS * K.norm():
            raise ValueError(
                f"{self._of_users}: add_tangent() is not symmetric, |K - K^T| is about "
                f"{skew / K.norm():.2g} |K|: K has to be the second derivative of an energy, which "
                "is symmetric; if there is no energy, add the symmetric part"
            )
        return K

    def resistance(self) -> Callable[[PETSc.Vec], Floats]:
        """Return v -> forces of the terms under v, over the largest entry of each row of K."""
        if not self.stiff:
            return lambda v: np.zeros(0)
        self.check_energies()
        K = self.stiffness()
        least = max(ROUND_OFF * K.norm(PETSc.NormType.INFINITY), TINY)
        scale = np.maximum(abs(owned_rows(K)).max(axis=1).toarray().ravel(), least)
        return lambda v: np.asarray((K * v).array_r / scale)

    def create_matrix(self, *, blocks: bool = False) -> PETSc.Mat:
        """Matrix with the pattern of the mesh and the couplings of terms; collective.

        `blocks` stores d x d blocks, unless a user's tangent is added: faster, but without sums and
        products of matrices.
        """
        ours = all(is_defined_here(type(term).add_tangent) for _, term in self.named)
        K = self.solid.create_matrix("baij" if blocks and ours else "aij")
        dense = [
            (name, dofs)
            for name, term in self.named
            for dofs in ask_term(self.comm, f"{name}: couplings", term, partial(_couplings, term))
        ]
        if not any_rank(self.comm, bool(dense))[0]:
            return K
        self.solid.add_tangent(K)  # PETSc removes unset entries
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        n = K.getSize()[0]
        remedy = f"give arrays of global dofs, integers from 0 to {n - 1}"
        rule = array((None,), remedy=remedy, holds=lambda k: np.isin(k, np.arange(n)).all())
        with raised_together(self.comm):
            for name, dofs in dense:
                rows = check(f"{name}: couplings: one", dofs, rule).astype(PETSc.IntType)
                K.setValues(rows, rows, np.zeros((rows.size, rows.size)), addv=True)
        K.assemble()
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        K.zeroEntries()
        return K

    def begin(self, start: float, end: float) -> None:
        """Prepare a step; a ValueError for infinite or NaN forces or energies; collective."""
        self.prepare(self._every, start, end)
        self.check_energies()

    def prepare(self, named: Sequence[tuple[str, Term]], start: float, end: float) -> None:
        """Prepare a step of some terms; collective."""
        for name, term in named:
            self._ask(name, term, Term.begin, start, end)

    def meet(self, contact: Bools, body: Ints) -> None:
        """Pass `meet` to all terms, see `Term`; collective."""
        for name, term in self._every:
            self._ask(name, term, Term.meet, contact, body)

    def stride(self) -> float:
        """Upper bound of a node's motion in the present step; collective."""
        length = partial(check, "it", rule=number("a finite length", least=0.0))
        found = [self._ask(name, term, Term.stride, then=length) for name, term in self.named]
        return float(maximum(self.comm, max(found, default=0.0))[0])

    def check_energies(self) -> None:
        """Raise a ValueError on all ranks unless the energies of terms are finite at u; collective.

        Of ours without energy, the forces are checked instead.
        """
        for name, term in self.named:
            addends = self._ask(name, term, Term.energy, then=_addends)
            if addends is None and is_ours(term):
                F = self.solid.u.x.petsc_vec.duplicate()
                F.set(0.0)
                term.add_forces(F)
                addends = F.array_r
            total = self.comm.allreduce(0.0 if addends is None else float(addends.sum()))
            if not np.isfinite(total):
                raise ValueError(
                    f"{name} is {total} at the present displacement: check its coefficients"
                )

    def commit(self) -> None:
        """Commit the state of all terms; collective."""
        for name, term in self._every:
            self._ask(name, term, Term.commit)

    def roll_back(self) -> None:
        """Discard a failed step in all terms; not collective."""
        for _, term in self._every:
            term.roll_back()

    def _ask(
        self,
        name: str,
        term: Term,
        method: Callable[..., Any],
        *given: Any,
        then: Callable[[Any], Any] = lambda found: found,
    ) -> Any:
        """Result of a method, after a check; its errors on all ranks, with its name; collective."""
        own = method.__name__

        def call() -> Any:
            try:
                return then(getattr(term, own)(*given))
            except PETSc.Error as error:
                if error.ierr != OUT_OF_RANGE:
                    raise
                raise ValueError(NO_PLACE) from error

        return ask_term(self.comm, f"{name}: {own}()", term, call)


def _nothing(returned: object) -> None:
    if returned is not None:
        raise ValueError(
            f"it returns a {type(returned).__name__}, which is not used: add to its argument, "
            "F.array[:] += .. or K.setValues(.., addv=True), and return nothing"
        )


def _addends(given: object) -> Floats | None:
    if given is None:
        return None
    remedy = "return this rank's share of the energy, a number, or None if there is no potential"
    return np.atleast_1d(check("it", given, array(finite=False, remedy=remedy)))


def _couplings(term: Term) -> Sequence[Any]:
    rule = instance((list, tuple), "give a list of arrays of global dofs, () for none")
    return list(check("it", term.couplings, rule))


def check_terms(comm: MPI.Comm, terms: Any, u: fem.Function) -> list[Term]:
    """Check terms; a ValueError on all ranks names what is missing; collective."""
    with raised_together(comm):
        check("terms", terms, instance((list, tuple), "give a list of terms, [] for none"))
        for k, term in enumerate(terms):
            remedy = "give an instance of a subclass of dolfinx_mortar.Term"
            check(f"terms[{k}]", term, instance(Term, remedy))
            if any(term is other for other in terms[:k]):
                raise ValueError(f"terms holds the same object {term!r} twice: give it once")
            _check_state(k, term, u.function_space)
            if isinstance(term, PointTerm):
                term.act_on(u)
    names = "linear", "has_tangent"
    kinds = [{n: getattr(t, n) for n in names} | {"state": sorted(t.state)} for t in terms]
    check_same_on_all_ranks(comm, terms=kinds)
    return list(terms)


def _check_state(k: int, term: Term, V: fem.FunctionSpace) -> None:
    """Raise a ValueError unless a state is nodal Functions on the mesh of V."""
    what = f"state of terms[{k}], a {type(term).__name__}"
    check(what, term.state, instance(Mapping, "give a dictionary of Functions by name"))
    nodes = V.dofmap.index_map
    sizes = nodes.size_global, nodes.size_local
    for name, f in term.state.items():
        if not (isinstance(name, str) and name and "/" not in name):
            raise ValueError(f"{what}, has the name {name!r}: give a text without '/'")
        on = f.function_space if isinstance(f, fem.Function) else None
        layout = on.dofmap.index_map if on is not None and on.mesh is V.mesh else None
        fits = layout is not None and (layout.size_global, layout.size_local) == sizes
        if not fits:
            raise ValueError(
                f"{what}: {name!r} is {f!r}: give a Function on solid.V or its scalar space"
            )
