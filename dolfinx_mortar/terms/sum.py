# SPDX-License-Identifier: MIT
"""The sum over bodies and terms: energy, forces and tangent of a problem."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.parallel import (
    any_rank,
    is_defined_here,
    is_ours,
    maximum,
    raised_together,
)
from dolfinx_mortar.arguments import array, check, instance, number
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.solid.mean_volume import VolumeStep
from dolfinx_mortar.solid.solid import Solid, add_first_forces, add_first_tangent
from dolfinx_mortar.solid.term import Term, ask_term
from dolfinx_mortar.terms.loads import PointTerm
from dolfinx_mortar.terms.weak_forms import DeadLoads

R = TypeVar("R")

NO_PLACE = (
    "an entry lies beyond the pattern of the matrix: declare the dofs in couplings, an array of "
    "global numbers for all that are coupled to each other"
)
OUT_OF_RANGE = 63  # PETSC_ERR_ARG_OUTOFRANGE
CALLED_WITH = {  # optional methods of a term
    "energy": (),
    "add_forces": ("F",),
    "add_tangent": ("K",),
    "skew": (),
    "begin": ("start", "end"),
    "commit": (),
    "roll_back": (),
    "meet": ("contact", "body"),
    "stride": (),
    "varies": ("K",),
}


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
    def every(self) -> list[Term]:
        """The bodies, then the other terms."""
        return [self.solid, *(term for _, term in self.named)]

    @property
    def _every(self) -> list[tuple[str, Term]]:
        return [("solid", self.solid), *self.named]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.solid.mesh.comm

    @property
    def linear(self) -> bool:
        """Whether the tangent is constant within a step."""
        return all(term.linear for term in self.every)

    def vary(self, K: PETSc.Mat) -> bool:
        """Whether the tangent may differ from K on any rank; collective."""
        found = [self._ask(f"{n}: varies()", t, partial(t.varies, K)) for n, t in self._stiff]
        found += [region.varying for region in self.solid.regions]
        return bool(any_rank(self.comm, any(found))[0])

    @property
    def _stiff(self) -> list[tuple[str, Term]]:
        return [(name, term) for name, term in self.named if term.has_tangent]

    @property
    def have_tangent(self) -> bool:
        """Whether a term other than the bodies has a tangent."""
        return bool(self._stiff)

    def energy(self, along: tuple[VolumeStep, float] | None = None) -> Energy | None:
        """J(u), None if a term has none; collective.

        `along` a step with its linearised volumes, see `Solid.energy`.
        """
        sums = np.zeros(3)
        for name, term in self._every:
            given = partial(self.solid.energy, along) if term is self.solid else term.energy
            addends = self._ask(name, term, partial(_addends, term, given))
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
            self._ask(f"{name}: add_forces()", term, partial(_add, term.add_forces, F))
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
        for name, term in self.named:
            if term.has_tangent:
                self._ask(f"{name}: add_tangent()", term, partial(_add, term.add_tangent, K))
        if not self._of_users:
            K.assemble()
            return
        K.assemble()
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        if K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["mallocs"] > before:
            raise ValueError(f"{self._of_users}: add_tangent(): {NO_PLACE}")
        if not np.isfinite(K.norm()):
            raise ValueError(
                f"{self._of_users}: add_tangent gives NaN or infinity at the present u"
            )

    def skews(self) -> list[PETSc.Mat]:
        """Antisymmetric parts, always of the same terms; collective."""
        found = [self._ask(f"{n}: skew()", term, term.skew) for n, term in self.named]
        return [A for A in found if A is not None]

    @property
    def _of_users(self) -> str:
        own = [name for name, term in self.named if term.has_tangent and not is_ours(term)]
        return "; ".join(own)

    def stiffness(self) -> PETSc.Mat:
        """Tangent of all terms but the bodies; collective.

        Raises:
            ValueError: on all ranks, for NaN, infinity, and a user's unsymmetric tangent.
        """
        K = self.create_matrix()
        K.zeroEntries()
        self.add_tangents(K)
        if self._of_users:
            self._check_symmetric(K)
        return K

    def _check_symmetric(self, K: PETSc.Mat) -> None:
        """Raise a ValueError on all ranks unless v.K w = w.K v for random v, w; collective."""
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
            for dofs in self._ask(f"{name}: couplings", term, partial(_couplings, term))
        ]
        if not any_rank(self.comm, bool(dense))[0]:
            return K
        self.solid.add_tangent(K)  # PETSc removes unset entries
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        with raised_together(self.comm):
            for name, dofs in dense:
                rows = _dofs(name, dofs, K.getSize()[0])
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
            self._ask(f"{name}: begin()", term, partial(term.begin, start, end))

    def meet(self, contact: Bools, body: Ints) -> None:
        """Pass `meet` to all terms, see `Term`; collective."""
        for name, term in self._every:
            self._ask(f"{name}: meet()", term, partial(term.meet, contact, body))

    def stride(self) -> float:
        """Upper bound of a node's motion in the present step; collective."""
        found = [self._ask(f"{n}: stride()", t, partial(_stride, t)) for n, t in self.named]
        return float(maximum(self.comm, max(found, default=0.0))[0])

    def check_energies(self) -> None:
        """Raise a ValueError on all ranks unless the energies of terms are finite at u; collective.

        Of users' terms without energy and dead loads, the forces are checked instead.
        """
        for name, term in self.named:
            if isinstance(term, DeadLoads):
                continue
            addends = self._ask(name, term, partial(_addends, term, term.energy))
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
            self._ask(f"{name}: commit()", term, term.commit)

    def roll_back(self) -> None:
        """Discard a failed step in all terms; not collective."""
        for term in self.every:
            term.roll_back()

    def _ask(self, name: str, term: Term, call: Callable[[], R]) -> R:
        """Call a method; raise its error on all ranks, with the term's name; collective."""
        return ask_term(self.comm, name, term, call)


def _add(method: Callable[[Any], object], to: PETSc.Vec | PETSc.Mat) -> None:
    returned = _within_pattern(partial(method, to))
    if returned is not None:
        raise ValueError(
            f"it returns a {type(returned).__name__}, which is not used: add to its argument, "
            "F.array[:] += .. or K.setValues(.., addv=True), and return nothing"
        )


def _within_pattern(call: Callable[[], R]) -> R:
    try:
        return call()
    except PETSc.Error as error:
        if error.ierr != OUT_OF_RANGE:
            raise
        raise ValueError(NO_PLACE) from error


def _addends(term: Term, energy: Callable[[], object]) -> Floats | None:
    given = energy()
    if given is None:
        return None
    remedy = "return this rank's share of the energy, a number, or None if there is no potential"
    rule = array(finite=False, remedy=remedy)
    return np.atleast_1d(check(f"{type(term).__name__}.energy()", given, rule))


def _stride(term: Term) -> float:
    return check("it", term.stride(), number("a finite length", least=0.0))


def _couplings(term: Term) -> Sequence[Any]:
    rule = instance((list, tuple), "give a list of arrays of global dofs, () for none")
    return list(check("it", term.couplings, rule))


def _dofs(name: str, dofs: object, n: int) -> np.ndarray:
    remedy = f"give arrays of global dofs, integers from 0 to {n - 1}"
    rule = array((None,), remedy=remedy, holds=lambda k: np.isin(k, np.arange(n)).all())
    return check(f"{name}: couplings: one", dofs, rule).astype(PETSc.IntType)


def check_terms(comm: MPI.Comm, terms: Any, u: fem.Function) -> list[Term]:
    """Check terms; a ValueError on all ranks names what is missing; collective."""
    with raised_together(comm):
        check("terms", terms, instance((list, tuple), "give a list of terms, [] for none"))
        for k, term in enumerate(terms):
            remedy = "give an instance of a subclass of dolfinx_mortar.Term"
            check(f"terms[{k}]", term, instance(Term, remedy))
            if any(term is other for other in terms[:k]):
                raise ValueError(f"terms holds the same object {term!r} twice: give it once")
            _check_signatures(k, term)
            _check_state(k, term, u.function_space)
            if isinstance(term, PointTerm):
                term.act_on(u)
    kinds = {f"terms[{k}]": _kind(term) for k, term in enumerate(terms)}
    check_same_on_all_ranks(comm, **kinds)
    return list(terms)


def _kind(term: Term) -> dict[str, Any]:
    names = "linear", "has_tangent"
    return {name: getattr(term, name) for name in names} | {"state": sorted(term.state)}


def _check_signatures(k: int, term: Term) -> None:
    for name, arguments in CALLED_WITH.items():
        signature = inspect.signature(getattr(term, name))
        try:
            signature.bind(*arguments)
        except TypeError as error:
            raise ValueError(
                f"terms[{k}], a {type(term).__name__}: {name}{signature} is called as "
                f"{name}({', '.join(arguments)}): {error}"
            ) from error


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
