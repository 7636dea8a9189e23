# SPDX-License-Identifier: MIT
"""A term of the energy."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from dolfinx_mortar.algebra.csr import add_blocks
from dolfinx_mortar.algebra.parallel import is_ours, named, raised_together
from dolfinx_mortar.common.arrays import Bools, Floats, Ints


class Term(ABC):
    """Energy Pi(u), a part of the minimised energy: the base of bodies, loads and your own terms.

    Pass instances of yours in ``ContactProblem(..., terms=[...])``. The problem adds up

        Pi(u),   F_i = dPi/du_i,   K_ij = d2Pi/du_i du_j

    of all its terms; `WeakForm` does this for UFL. Write a class for forces between distant points,
    tables, other programs; it has to define `add_forces` and `add_tangent`. All ranks must reach
    the collective calls of a method: an error of one rank is raised on all after the call.

    Attributes:
        linear: whether K is constant in a step, and assembled once.
        has_tangent: whether K is not zero.
        couplings: global dofs (k,) that K couples beyond the pattern of the mesh, an array for each
            dense block of k x k entries, the same on all ranks or each on one of them.
        state: Functions on ``solid.V`` or its scalar space, by name, set by `commit`: the start of
            the next step, and part of a checkpoint.
    """

    linear: bool = False
    has_tangent: bool = True
    couplings: Sequence[Ints] = ()

    @property
    def state(self) -> Mapping[str, fem.Function]:
        """Functions of the committed state, by name."""
        return {}

    @property
    def identity(self) -> Mapping[str, Any]:
        """Data, as JSON, on which the meaning of the state depends; a checkpoint refuses others."""
        return {}

    def energy(self) -> float | Floats | None:
        """This rank's share of Pi(u), or its addends; None without a potential.

        Then there is no line search: Newton's method takes whole steps.
        """
        return None

    @abstractmethod
    def add_forces(self, F: PETSc.Vec) -> None:
        """Add F_i to the internal forces, ``F.array`` of owned dofs or ``F.setValues`` of any."""

    @abstractmethod
    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add K_ij, symmetric, with ``K.setValues(.., addv=True)``, within the pattern of K."""

    def skew(self) -> PETSc.Mat | None:
        """Antisymmetric part of dF/du, or None; collective.

        Not part of `add_tangent`; unsymmetric tangents of moving surfaces take it.
        """
        return None

    def meet(self, contact: Bools, body: Ints) -> None:
        """Receive the places of contacts, when a problem is made; collective.

        Args:
            contact: (owned nodes,) nodes of sides that can open.
            body: (owned nodes,) numbers of the connected bodies.
        """

    def stride(self) -> float:
        """Upper bound of a node's motion in the present step, as far as the term knows."""
        return 0.0

    def varies(self, K: PETSc.Mat) -> bool:
        """Whether the tangent of a linear term may differ from that of the last step."""
        return True

    def begin(self, start: float, end: float) -> None:
        """Prepare a step.

        Args:
            start: load level of the committed state.
            end: load level of the step; that of `load_steps`, or ``level`` of `newton`.
        """

    def commit(self) -> None:
        """Make the converged step the start of the next one.

        An error undoes the step of all terms: ``state`` is restored.
        """

    def roll_back(self) -> None:
        """Discard a failed step; the committed state remains."""


R = TypeVar("R")


def ask_term(comm: MPI.Comm, name: str, term: Term, call: Callable[[], R]) -> R:
    """Call a term; an error of a user's on one rank is raised on all; collective."""
    if is_ours(term):
        return call()
    with raised_together(comm), named(name):
        return call()


def create_vector(V: fem.FunctionSpace) -> la.Vector:
    """Vector of V, with ghosts."""
    return la.vector(V.dofmap.index_map, V.dofmap.index_map_bs)


def assemble(form: fem.Form, vector: la.Vector) -> Floats:
    """Assemble a linear form; return a view of owned values; collective."""
    vector.array[:] = 0.0
    fem.assemble_vector(vector.array, form)
    vector.scatter_reverse(la.InsertMode.add)
    return vector.array[: vector.block_size * vector.index_map.size_local]


class MatrixForm:
    """A bilinear form with the same matrix each time, to the last bit: messages summed by rank.

    `form` is Any because dolfinx annotates one overload only.
    """

    def __init__(self, form: Any) -> None:
        self.form = form
        self._sums: Any = None

    def add_to(self, K: PETSc.Mat) -> None:
        """Add the matrix to K, to be assembled afterwards; collective."""
        alone = K.getType() == "seqaij" and K.isAssembled()
        if K.comm.size <= 2 and not alone:
            fem_petsc.assemble_matrix(K, self.form)
            return
        if self._sums is None:
            self._sums = fem.create_matrix(self.form)
        sums = self._sums
        sums.set_value(0.0)
        fem.assemble_matrix(sums, self.form)
        sums.scatter_reverse()
        start = sums.indptr[: sums.index_map(0).size_local + 1].astype(PETSc.IntType)
        columns = sums.index_map(1).local_to_global(sums.indices[: start[-1]])
        columns, d = columns.astype(PETSc.IntType), sums.block_size
        blocks = sums.data[: start[-1] * d[0] * d[1]].reshape(-1, *d)
        if alone:
            add_blocks(K, start, columns, blocks)
        else:
            K.setValuesBlockedCSR(start, columns, blocks, addv=True)
