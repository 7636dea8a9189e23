# SPDX-License-Identifier: MIT
"""The present factorisation or multigrid set-up, and its renewal as soon as that is cheaper.

Residuals decide, not clocks: the same on all ranks.
"""

import ctypes
from dataclasses import dataclass
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import CongruentOperator, decouple
from dolfinx_mortar.algebra.csr import call, has
from dolfinx_mortar.algebra.parallel import free_unused
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Floats, Ints
from dolfinx_mortar.qp.bound_qp import BoundQP
from dolfinx_mortar.qp.operator import Operator, count_negative
from dolfinx_mortar.qp.options import SolverOptions

# Excess iterations worth a renewal: a factorisation in 2D costs 5 to 7 solves, a multigrid set-up
# in 3D 25 to 50.
RENEWAL_COST = {"direct": 6, "iterative": 80}
# INFOG(1) of MUMPS: workspace too small; ICNTL(14) is the percentage above its estimate.
WORKSPACE_ERRORS = (-8, -9)
WORKSPACE = "mat_mumps_icntl_14"
# INFOG(1): no memory, or not within its limit; and PETSc's PC_FACTOR_OUTMEMORY.
MEMORY_ERRORS, OUT_OF_MEMORY = (-7, -13, -18, -19, -20), 3


@dataclass
class LinearCounts:
    """Costs so far."""

    symbolic: int = 0  # analyses of a pattern
    factorisations: int = 0  # numeric factorisations or preconditioner set-ups
    iterations: int = 0  # applications of the factorisation or preconditioner
    seconds_factor: float = 0.0
    seconds_solve: float = 0.0


class Renewal:
    """When to renew: `after` so many iterations above those of a new one.

    With a factorisation one solve decides, with multigrid the sum of all.
    """

    def __init__(self, after: int, direct: bool) -> None:
        self.after, self.direct = after, direct
        self.fresh_rate = 0.0  # log reduction per iteration when new
        self.excess = 0.0  # iterations above those of a new one

    def is_far(self, different: int) -> bool:
        """Whether to renew at once, for so many unknowns newly fixed or free."""
        return (different if self.direct else self.excess) > self.after

    def learn(self, norms: Floats, *, stale: bool) -> None:
        """Observe the residual norms of a solve."""
        its, reached = max(len(norms) - 1, 0), 0.0
        if its > 0 and norms[0] > 0.0:
            reached = float(np.log(max(norms[-1] / norms[0], TINY)))
        if not stale:
            self.fresh_rate, self.excess = reached / its if its else self.fresh_rate, 0.0
        elif self.fresh_rate < 0.0:
            self.excess += its - reached / self.fresh_rate


@dataclass(frozen=True)
class Change:
    """Unknowns v of multigrid for one set of fixed unknowns."""

    E: PETSc.Mat | None  # (n, n) x = (I - E) v; None for E = 0
    matrix: PETSc.Mat  # (n, n) of the QP in v, fixed unknowns decoupled; maybe of type python


class Unknowns(Protocol):
    """Unknowns v of multigrid for each set of fixed unknowns."""

    def change(self, held: Ints) -> Change:
        """Unknowns for the present geometry; collective."""

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """Near null space, zero where decoupled; collective."""


class OwnUnknowns:
    """The unknowns v = x."""

    def __init__(self, A: PETSc.Mat) -> None:
        self.operator = CongruentOperator(A)

    def change(self, held: Ints) -> Change:
        """Unknowns v = x; collective."""
        self.operator.follow(None, held)
        return Change(None, self.operator.matrix)

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """None: PETSc takes constants."""
        return []


def orthonormal(vectors: list[PETSc.Vec]) -> list[PETSc.Vec]:
    """Orthonormal basis of vectors, which are overwritten; collective."""
    basis: list[PETSc.Vec] = []
    for vector in vectors:
        whole = vector.norm()
        for _ in range(2):
            for other in basis:
                vector.axpy(-other.dot(vector), other)
        if vector.norm() > HALF_OF_DIGITS * whole:
            vector.normalize()
            basis.append(vector)
    return basis


class Multigrid:
    """PETSc PC of type python, M^-1 in unknowns v that may differ from x.

    Coarse functions of the relative motion would couple open contacts. So a matrix B in other
    unknowns v may be used,

        x = (I - E) v,      M^-1 = (I - E) B^-1 (I - E)^T on free unknowns,

    of an earlier set, geometry and tangent. With GAMG the finest level uses the present matrix;
    with other PCs each changed unknown costs about one iteration, and unknowns fixed in B but free
    now have the mean diagonal. `prefix` is that of the PC for B^-1.
    """

    def __init__(self, A: PETSc.Mat, prefix: str) -> None:
        self.inner = PETSc.PC().create(A.comm)
        self.inner.setOptionsPrefix(prefix)
        self.inner.setFromOptions()
        self.B: PETSc.Mat | None = None
        self.E: PETSc.Mat | None = None
        self.held: Ints = np.empty(0, dtype=np.int32)  # in the present matrix
        self.negative = 0  # negative eigenvalues on the coarsest level
        self._r, self._v = A.createVecRight(), A.createVecRight()

    @property
    def follows(self) -> bool:
        """Whether the finest level uses the present matrix."""
        return bool(self.inner.getType() == PETSc.PC.Type.GAMG)

    def clear(self) -> None:
        """Free the matrices of the inner PC."""
        self.inner.reset()
        self.B = self.E = None

    def renew(
        self, change: Change, motions: list[PETSc.Vec], held: Ints, *, definite: bool
    ) -> None:
        """Set up with another matrix B; collective.

        `motions`, the near null space, are overwritten; `held` are fixed in B.
        """
        self.E, self.held, inner, B = change.E, held, self.inner, change.matrix.copy()
        free_unused(B.comm.tompi4py())
        B.setOption(PETSc.Mat.Option.SPD, definite)
        if basis := orthonormal(motions):
            B.setBlockSize(basis[0].getBlockSize())
            B.setNearNullSpace(PETSc.NullSpace().create(vectors=basis, comm=B.comm))
        inner.setFromOptions()
        inner.setUseAmat(self.follows)
        inner.setOperators(change.matrix if self.follows else B, B)
        inner.setReusePreconditioner(False)
        inner.setFailedReason(PETSc.PC.FailedReason.NOERROR)  # PETSc keeps an earlier one
        inner.setUp()
        self.B, self.negative = B, 0
        if self.follows:
            levels = [inner.getMGSmoother(level) for level in range(inner.getMGLevels())]
            for level in levels[:-1]:
                product = ctypes.c_void_p(level.getOperators()[0].handle)
                call("MatProductClear", product)  # frees its factors
            self.negative = count_negative(levels[0].getOperators()[1]) if definite else 0
            if len(levels) > 1 and levels[-1].getPC().getType() == PETSc.PC.Type.JACOBI:
                self.B = PETSc.Mat().createDiagonal(B.getDiagonal())  # all that it needs
                for user in (levels[-1], inner):
                    user.setOperators(change.matrix, self.B)
        inner.setReusePreconditioner(True)

    def follow(self, change: Change, held: Ints) -> None:
        """Set the present fixed unknowns and v; collective."""
        assert self.B is not None, "not set up"
        self.E, self.held = change.E, held
        self.B.setDiagonal(change.matrix.getDiagonal())

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Set z = M^-1 r."""
        r.copy(self._r)
        if self.E is not None:
            self.E.multTranspose(r, self._v)
            self._r.axpy(-1.0, self._v)
        self.inner.apply(self._r, self._v)
        self._v.copy(z)
        if self.E is not None:
            self.E.mult(self._v, self._r)
            z.axpy(-1.0, self._r)
        z.array[self.held] = 0.0


def set_apart(qp: BoundQP, options: SolverOptions) -> Ints | None:
    """Unknowns G, with bounds or friction or of C, to leave for last; None on several ranks."""
    if not qp.definite or qp.scalars is not None:
        return None
    if qp.product is not None:
        return interface_unknowns(qp.product.K, qp.product.C, options)
    return _few(qp.A, qp.held, options)


def interface_unknowns(K: PETSc.Mat, C: PETSc.Mat | None, options: SolverOptions) -> Ints | None:
    """Unknowns of C, if (I + C)^T K (I + C) need not be formed; see `set_apart`."""
    if C is None or C.comm.size > 1:
        return None
    start, columns = C.getRowIJ()
    rows = np.flatnonzero(np.diff(start) > 0)
    return _few(K, np.union1d(rows, columns).astype(np.int32), options)


def _few(A: PETSc.Mat, unknowns: Ints, options: SolverOptions) -> Ints | None:
    options.definite = True
    used = options["pc_type"], options["pc_factor_mat_solver_type"]
    if used != ("cholesky", "mumps") or not has("MatFactorSetSchurIS") or A.getType() != "seqaij":
        return None
    few = 0 < unknowns.size**2 <= 2 * A.getInfo()["nz_used"] and unknowns.size < A.getSize()[0]
    return unknowns if few else None


class SchurComplement:
    """S = A_GG - A_GI A_II^-1 A_IG, of a factorisation by MUMPS that leaves G (k,) for last.

    One factorisation serves all active sets; if A = T^T K T with T = I + C, C in G x G, that of K
    and T^T S T all geometries. Solves fix G.
    """

    def __init__(self, unknowns: Ints, product: CongruentOperator) -> None:
        self.unknowns, self.product, self.prepared = unknowns, product, False
        self.S: Floats = np.zeros((0, 0))
        self._decoupled: Ints = np.empty(0, dtype=np.int32)  # of the copied K
        self._K: PETSc.Mat | None = None

    @property
    def state(self) -> int:
        """Changes with the values of the factorised matrix."""
        same = self._K is None or np.array_equal(self._decoupled, self._elsewhere())
        return int(self.product.K.stateGet()) if same else -1

    def matrix(self) -> PETSc.Mat:
        """Matrix to be factorised."""
        if self._K is None:
            self._K = self.product.K.duplicate(copy=True)
            self._K.setOption(PETSc.Mat.Option.SPD, True)
            self._K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        else:
            self.product.K.copy(self._K, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._decoupled = self._elsewhere()
        decouple(self._K, self._decoupled, self.product.scale)
        return self._K

    def _elsewhere(self) -> Ints:
        return np.setdiff1d(self.product.decoupled, self.unknowns)

    def prepare(self, pc: PETSc.PC) -> None:
        """Leave G for last in the first factorisation of a PC."""
        if self.prepared:
            return
        self.prepared = True
        pc.setFactorSetUpSolverType()
        last = PETSc.IS().createGeneral(self.unknowns.astype(PETSc.IntType), comm=pc.comm)
        factor = ctypes.c_void_p(pc.getFactorMatrix().handle)
        call("MatFactorSetSchurIS", factor, ctypes.c_void_p(last.handle))

    def read(self, pc: PETSc.PC) -> None:
        """Take S; zeros for its inverse fix G in solves."""
        factor, S = ctypes.c_void_p(pc.getFactorMatrix().handle), ctypes.c_void_p()
        first, inverted = ctypes.POINTER(ctypes.c_double)(), 2  # MAT_FACTOR_SCHUR_INVERTED
        call("MatFactorGetSchurComplement", factor, ctypes.byref(S), None)
        call("MatDenseGetArray", S, ctypes.byref(first))
        entries = np.ctypeslib.as_array(first, shape=(self.unknowns.size,) * 2).T
        self.S = np.tril(entries) + np.tril(entries, -1).T  # MUMPS gives its lower part
        entries[:] = 0.0
        call("MatDenseRestoreArray", S, ctypes.byref(first))
        call("MatFactorRestoreSchurComplement", factor, ctypes.byref(S), inverted)

    def destroy(self) -> None:
        """Free the copy of K."""
        if self._K is not None:
            self._K.destroy()


class Preconditioner:
    """Factorisation or multigrid of an earlier matrix and set, as preconditioner of an operator."""

    def __init__(
        self,
        operator: Operator,
        ksp: PETSc.KSP,
        options: SolverOptions,
        unknowns: Unknowns | None,
        schur: SchurComplement | None = None,
    ) -> None:
        self.operator, self.ksp, self.options = operator, ksp, options
        self.schur = schur
        self.comm = ksp.comm.tompi4py()
        self.unknowns = OwnUnknowns(operator.A) if unknowns is None else unknowns
        self.held: Ints | None = None  # at its set-up
        self._state = -1  # of A at that time
        # state of A, and fixed unknowns, on multigrid's finest level
        self._followed: tuple[int, Ints] = (-1, np.empty(0, dtype=np.int32))
        self.multigrid: Multigrid | None = None
        self.pc = ksp.getPC()
        if not options.direct:
            self.multigrid = Multigrid(operator.A, options.prefix)
            self.pc = self.multigrid.inner
            ksp.setPC(PETSc.PC().createPython(self.multigrid, comm=ksp.comm))

    @property
    def description(self) -> str:
        """Name of the method."""
        name = str(self.pc.getType())
        return f"{name} ({self.pc.getFactorSolverType()})" if self.options.direct else name

    def serves(self, apart: Ints | None) -> bool:
        """Whether it serves where only these unknowns are fixed."""
        if self.schur is None or apart is None:
            return self.schur is None and apart is None
        return np.array_equal(apart, self.schur.unknowns)

    def is_of(self, held: Ints) -> bool:
        """Whether it is that of the present A and fixed unknowns (collective)."""
        same = self.held is not None and (self.schur is not None or np.array_equal(self.held, held))
        return self._state == self._present() and self.comm.allreduce(same, op=MPI.LAND)

    def _present(self) -> int:
        return self.operator.state if self.schur is None else self.schur.state

    def differences(self, held: Ints) -> int | None:
        """Number of differing fixed unknowns, or None (collective)."""
        if self.held is None:
            return None
        return int(self.comm.allreduce(np.setxor1d(self.held, held).size))

    def clear(self) -> None:
        """Free it, also in PCs with other references; collective."""
        self.ksp.getPC().reset()
        if self.schur is not None:
            self.schur.destroy()
        if self.multigrid is not None:
            self.multigrid.clear()

    def renew(self, held: Ints, counts: LinearCounts) -> str:
        """Set up again; return the cause of a failure, or "" (collective)."""
        if self.multigrid is not None:
            self.multigrid.clear()  # two at a time need twice the memory
        free_unused(self.comm)
        if self.multigrid is None:
            self._factorise(counts)
        else:
            with self.options.database(self.options.prefix):
                change = self.unknowns.change(held)
                motions, definite = self.unknowns.motions(change), self.operator.definite
                self.multigrid.renew(change, motions, held, definite=definite)
                self._followed = self.operator.state, held.copy()
            counts.factorisations += 1
        self.held, self._state = held.copy(), self._present()
        if self.pc.getFailedReason() == 0:
            if self.schur is not None and self.schur.prepared:
                self.schur.read(self.pc)
            return ""
        self.held = None
        why = describe_failure(self.pc)
        if self.multigrid is None:
            self._reset()  # PETSc would use a failed factor of the same matrix
        return why

    def follow(self, held: Ints) -> None:
        """Set the fixed unknowns and the matrix of multigrid; collective."""
        if self.multigrid is None:
            return
        if not self.multigrid.follows:
            self.multigrid.held = held
            return
        now = self.operator.state
        same = self._followed[0] == now and np.array_equal(self._followed[1], held)
        if not self.comm.allreduce(same, op=MPI.LAND):
            self.multigrid.follow(self.unknowns.change(held), held)
            self._followed = now, held.copy()

    def _factorise(self, counts: LinearCounts) -> None:
        """Factorise, with more workspace if MUMPS had too little."""
        self.pc.setReusePreconditioner(False)
        factorised = self.operator.factorised if self.schur is None else self.schur.matrix()
        self.ksp.setOperators(self.operator.matrix, factorised)
        while True:
            with self.options.database(self.options.prefix):
                if self.schur is not None:
                    self.schur.prepare(self.pc)
                self.pc.setUp()
            counts.factorisations += 1
            if mumps_error(self.pc) not in WORKSPACE_ERRORS:
                break
            twice = 2 * max(int(self.pc.getFactorMatrix().getMumpsIcntl(14)), 20)
            self.options.grown[WORKSPACE] = twice
            if self.options[WORKSPACE] != str(twice):
                break  # the user's options database takes precedence
            self._reset()
            self.ksp.setOperators(self.operator.matrix, factorised)
            counts.symbolic += 1
        self.pc.setReusePreconditioner(True)

    def _reset(self) -> None:
        self.pc.reset()
        if self.schur is not None:
            self.schur.prepared = False


def mumps_error(pc: PETSc.PC) -> int | None:
    """INFOG(1) of MUMPS, or None."""
    direct = pc.getType() in ("cholesky", "lu")
    if not direct or pc.getFactorSolverType() != "mumps":
        return None
    return int(pc.getFactorMatrix().getMumpsInfog(1))


def describe_failure(pc: PETSc.PC) -> str:
    """Codes of a failure and the remedy."""
    code = mumps_error(pc)
    reason = f"(PETSc reason {pc.getFailedReason()}"
    reason += ")" if code is None else f", MUMPS INFOG(1) = {code})"
    if code in WORKSPACE_ERRORS:
        return (
            f"{reason}. PETSc's options database has -{pc.getOptionsPrefix()}{WORKSPACE}, which "
            "keeps the workspace too small: raise it, or leave it out."
        )
    if code in MEMORY_ERRORS or pc.getFailedReason() == OUT_OF_MEMORY:
        return (
            f"{reason}. It does not fit into memory. Use an iterative solver, as is the default in "
            '3D: petsc_options={"ksp_type": "cg", "pc_type": "gamg"}; or more ranks on more '
            "machines."
        )
    return (
        f"{reason}. Most often a body is held by nothing: add a Dirichlet condition or a contact "
        "that holds it, or check the material constants."
    )
