# SPDX-License-Identifier: MIT
"""A factorisation by MUMPS that leaves some unknowns for last: their Schur complement is dense.

With unknowns G last, A is factorised up to S = A_GG - A_GI A_II^-1 A_IG. Which of them are held
concerns S alone, so that one factorisation serves all active sets. Numeric factorisation and solve
cost 1.0 to 1.1 of those without (5 and 47 thousand unknowns with 51 and 133 in G; 1.5 and 1.1 at
182 thousand, 209). The analysis takes half the time and less, since MUMPS then orders by minimum
degrees.

If A = T^T K T with T = I + C, and C in G x G, it is K that is factorised, and T^T S T the Schur
complement of A: then one factorisation serves all geometries, too, and A is never formed. G are
the unknowns of both sides: 784 of 50 thousand, where numeric factorisation and solve take 117 and
17 ms, those of A 116 and 17, its analysis 29 and 204, and the product T^T K T 14 in each geometry.

PETSc has this on one rank only, and petsc4py 3.22 does not wrap it.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, lapack, solve_triangular
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu

from dolfinx_mortar.algebra.congruence import CongruentOperator, decouple
from dolfinx_mortar.algebra.csr import call, csr_of, has
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.qp.bound_qp import BoundQP
from dolfinx_mortar.qp.options import SolverOptions

_at = ctypes.byref


def set_apart(qp: BoundQP, options: SolverOptions) -> Ints | None:
    """Return the unknowns that a factorisation may leave for last; None for an ordinary one.

    These are those with bounds or friction, and those of C if A is a product, ascending, on one
    rank, if S has no more entries than A, and if PETSc's library shows the
    function.
    """
    if not qp.definite:
        return None
    if qp.product is not None:
        return interface_unknowns(qp.product.K, qp.product.C, options)
    return _few(qp.A, qp.held, options)


def interface_unknowns(K: PETSc.Mat, C: PETSc.Mat | None, options: SolverOptions) -> Ints | None:
    """Return the unknowns of C, if (I + C)^T K (I + C) need not be formed; see `set_apart`."""
    if C is None or C.comm.size > 1:
        return None
    start, columns = C.getRowIJ()
    on = np.diff(start) > 0
    on[columns] = True
    return _few(K, np.flatnonzero(on).astype(np.int32), options, 2)


def _few(A: PETSc.Mat, unknowns: Ints, options: SolverOptions, share: int = 1) -> Ints | None:
    """Return these unknowns of a matrix if they may be left for last."""
    if not has("MatFactorSetSchurIS"):  # a petsc4py that hides its symbols
        return None
    used = options.of_definite("pc_type"), options.of_definite("pc_factor_mat_solver_type")
    mumps = used == ("cholesky", "mumps")
    few = A.comm.size == 1 and 0 < unknowns.size < A.getSize()[0]
    if not (mumps and few and A.getType() == "seqaij"):
        return None
    return unknowns if unknowns.size**2 <= share * A.getInfo()["nz_used"] else None


class _Change:
    """T = 1 + C for C (k, k) with few rows F (s, k) in the places E: T^-1 = 1 - E (1 + F E)^-1 F.

    Args:
        C: its entries.
        d: size of the diagonal blocks that 1 + F E has unless sides refer to their own nodes.
    """

    def __init__(self, C: csr_array, d: int = 1) -> None:
        self.C, self.places = C, np.flatnonzero(np.diff(C.indptr)).astype(np.int32)
        self._back = _divided(C[self.places], self.places, d)  # (s, k)

    def solve(self, x: Floats) -> Floats:
        """Return T^-1 x (k,)."""
        y = x.copy()
        y[self.places] -= self._back @ x
        return y

    def solve_transposed(self, x: Floats) -> Floats:
        """Return T^-T x (k,)."""
        return np.asarray(x - self._back.T @ x[self.places])

    def solve_rows(self, M: Floats, rows: Ints) -> Floats:
        """Return some rows (m,) of T^-1 M (m, j)."""
        found, on = M[rows], np.isin(rows, self.places)
        found[on] -= (self._back @ M)[np.searchsorted(self.places, rows[on])]
        return found

    def congruent(self, M: Floats, *, transposed: bool = False) -> Floats:
        """Return T M T^T, or T^T M T, for symmetric M (k, k)."""
        C = self.C.T if transposed else self.C
        half = M + C @ M
        return np.asarray(half.T + C @ half.T)


def _divided(F: csr_array, places: Ints, d: int) -> csr_array:
    """Return (1 + F E)^-1 F (s, k) for F (s, k), E being the columns of its rows, the places (s,).

    By d x d blocks where 1 + F E has no others: 282 rows take .5 ms so, and 2.6 ms by LU.
    """
    s = places.size
    position = np.full(F.shape[1], -1, dtype=np.int32)
    position[places] = np.arange(s)
    columns, rows = position[F.indices], np.repeat(np.arange(s), np.diff(F.indptr))
    on = columns >= 0
    i, j, values = rows[on], columns[on], F.data[on]
    if s % d == 0 and np.array_equal(i // d, j // d):
        blocks = np.tile(np.eye(d), (s // d, 1, 1))
        blocks[i // d, i % d, j % d] += values
        others = np.repeat(np.arange(s).reshape(-1, 1, d), d, axis=1)
        inverse = np.linalg.inv(blocks).ravel(), others.ravel(), np.arange(0, d * s + 1, d)
        return csr_array(inverse, (s, s)) @ F
    inner = csc_array((values, (i, j)), (s, s)) + eye_array(s, format="csc")
    return csr_array(splu(inner).solve(F.toarray()))


@dataclass(frozen=True)
class _Basis:
    """T on G, and rows of T^-1 times the inverse of S, from which all sets of held unknowns follow.

    With S of K definite and R its inverse, those of y that are held, w = N u, leave

        R - (N R)^T (N R N^T)^-1 N R,

    and (N R N^T)^-1 is the Schur complement of A on them.
    """

    T: _Change | None  # None for 1
    known: Ints  # places in G (m,) of which there are rows
    NR: Floats  # (m, k)
    NRN: Floats  # (m, m)


class SchurComplement:
    """The Schur complement in a factorisation, with some of its unknowns held.

    Args:
        unknowns: (k,) of the matrix, ascending.
        bounded: those of them that may be held, ascending.
        product: the matrix, if K is factorised in its place.

    Attributes:
        unknowns, bounded: as above.
        prepared: whether the PC knows of it.
        S: (k, k) symmetric, of the last factorisation.
        R: (k, k) its inverse; None where only contact holds a body.
    """

    def __init__(
        self, unknowns: Ints, bounded: Ints, product: CongruentOperator | None = None
    ) -> None:
        self.unknowns, self.bounded, self.product = unknowns, bounded, product
        self.R: Floats | None = None
        self.prepared = False
        self.S: Floats = np.zeros((0, 0))
        self._basis: _Basis | None = None
        self._state = -1  # of the product
        self._held: Ints | None = None
        self._decoupled: Ints = np.empty(0, dtype=np.int32)  # unknowns of A when K was copied
        self._K: PETSc.Mat | None = None

    # -- the factorisation -----------------------------------------------------------------------

    def state(self, A: PETSc.Mat) -> int:
        """Return a number that changes with the values of what is factorised; -1 if that is old."""
        if self.product is None:
            return int(A.stateGet())
        before, now = self._decoupled, self.product.decoupled
        same = self._K is None or np.array_equal(before, now)
        same = same or np.array_equal(self._elsewhere(before), self._elsewhere(now))
        return int(self.product.K.stateGet()) if same else -1

    def matrix(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return the matrix to be factorised."""
        if self.product is None:
            return A
        if self._K is None:
            self._K = self.product.K.duplicate(copy=True)
            self._K.setOption(PETSc.Mat.Option.SPD, True)
            self._K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        else:
            self.product.K.copy(self._K, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._decoupled = self.product.decoupled.copy()
        decouple(self._K, self._elsewhere(self._decoupled), self.product.scale)
        return self._K

    def _elsewhere(self, decoupled: Ints) -> Ints:
        """Return which of them are decoupled in K, too."""
        return np.setdiff1d(decoupled, self.unknowns)

    def prepare(self, pc: PETSc.PC) -> None:
        """Leave the unknowns for last in the first factorisation of a PC."""
        if self.prepared:
            return
        self.prepared = True
        pc.setFactorSetUpSolverType()
        last = PETSc.IS().createGeneral(self.unknowns.astype(PETSc.IntType), comm=pc.comm)
        factor = ctypes.c_void_p(pc.getFactorMatrix().handle)
        call("MatFactorSetSchurIS", factor, ctypes.c_void_p(last.handle))

    def read(self, pc: PETSc.PC) -> None:
        """Take S from a new factorisation; nothing is held in it yet."""
        with _Entries(pc, self.unknowns.size) as entries:
            self.S = _mirrored(entries)  # MUMPS gives its lower part
        self._held = self._basis = self.R = None
        factor, failed = lapack.dpotrf(self.S, lower=True)
        pivots = np.diag(factor) ** 2
        if not failed and (pivots > HALF_OF_DIGITS * np.diag(self.S)).all():
            self.R = _mirrored(lapack.dpotri(factor, lower=True, overwrite_c=True)[0])

    def destroy(self) -> None:
        """Free the copy of K."""
        if self._K is not None:
            self._K.destroy()

    # -- in the unknowns of A --------------------------------------------------------------------

    @property
    def basis(self) -> _Basis:
        """T and what follows from it, at present."""
        state = -1 if self.product is None else int(self.product.matrix.stateGet())
        if self._basis is None or state != self._state:
            self._basis, self._state, self._held = self._transformed(), state, None
        return self._basis

    def _transformed(self) -> _Basis:
        k, T = self.unknowns.size, None
        known = np.flatnonzero(self._holds(self.bounded)).astype(np.int32)
        nothing = np.zeros((0, 0))
        if self.product is not None and self.product.C is not None:
            start, columns, values = csr_of(self.product.C)
            places = np.searchsorted(self.unknowns, columns)
            rows = np.append(start[self.unknowns], start[-1])
            d = self.product.K.getBlockSize()
            C = csr_array((values, places, rows), shape=(k, k))
            C.eliminate_zeros()  # half of its pattern, which provides for sliding
            T = _Change(C, d)
        if self.R is None:
            return _Basis(T, known, nothing, nothing)
        if T is None:
            return _Basis(T, known, self.R[known], self.R[np.ix_(known, known)])
        NR = T.solve_rows(self.R, known)
        return _Basis(T, known, NR, T.solve_rows(NR.T, known))

    def _holds(self, held: Ints) -> Bools:
        """Tell which of G are these unknowns, or decoupled."""
        if self.product is None:
            return np.isin(self.unknowns, held)
        marks = np.zeros(self.product.K.getSize()[0], dtype=bool)
        marks[held] = marks[self.product.decoupled] = True
        return marks[self.unknowns]

    def model(self) -> Floats:
        """Return the Schur complement of A on the bounded unknowns (m, m).

        Raises:
            LinAlgError: if A is not positive definite with them held.
        """
        if not self.prepared:
            raise LinAlgError("nothing is factorised")
        on = np.flatnonzero(self._holds(self.bounded))
        out = np.isin(self.unknowns[on], self.bounded)
        if self.R is not None:
            return np.asarray(_inverse(self.basis.NRN)[np.ix_(out, out)])
        S = self._transform(self.S, transposed=True)
        rest = np.setdiff1d(np.arange(self.unknowns.size), on)
        on = on[out]
        inner = S[np.ix_(on, on)]
        if not rest.size:
            return np.asarray(inner)
        coupling = S[np.ix_(rest, on)]
        factor = cho_factor(S[np.ix_(rest, rest)])
        return np.asarray(inner - coupling.T @ cho_solve(factor, coupling))

    def _transform(self, M: Floats, *, transposed: bool = False) -> Floats:
        T = self.basis.T
        return M if T is None else T.congruent(M, transposed=transposed)

    def hold(self, pc: PETSc.PC, held: Ints) -> None:
        """Hold these of the unknowns in the next solves: x = 0 there.

        Raises:
            LinAlgError: if S without them is not positive definite.
        """
        basis = self.basis  # first: another geometry forgets what is held
        if self._held is not None and np.array_equal(self._held, held):
            return
        holds = self._holds(held)
        change = None if self.R is None else self._change_by(basis, holds)
        if self.R is None or change is None:
            self.R = change = None
            S = self._transform(self.S, transposed=True)
            free, inverse = np.flatnonzero(~holds), np.zeros_like(S)
            if free.size:
                inverse[np.ix_(free, free)] = _inverse(S[np.ix_(free, free)])
            inverse = self._transform(inverse)
        else:
            inverse = self.R
        with _Entries(pc, self.unknowns.size) as entries:
            np.subtract(inverse, 0.0 if change is None else change, out=entries.T)  # column order
        self._held = held.copy()

    @staticmethod
    def _change_by(basis: _Basis, holds: Bools) -> Floats | None:
        """Return by how much R is smaller with some of G held; None if half of the digits go.

        As where contact holds a body that else could nearly move: R is then mostly that motion.
        """
        on = holds[basis.known]
        if not on.any():
            return np.zeros(1)
        NRN = basis.NRN[np.ix_(on, on)]
        factor, failed = lapack.dpotrf(NRN, lower=True)
        if failed or (np.diag(factor) ** 2 <= HALF_OF_DIGITS * np.diag(NRN)).any():
            return None
        part = solve_triangular(factor, basis.NR[on], lower=True)
        return np.asarray(part.T @ part)

    # -- the PC ----------------------------------------------------------------------------------

    def solver(self, pc: PETSc.PC) -> PETSc.PC:
        """Return a PC that applies A^-1 by the factorisation, itself unless A is a product."""
        if self.product is None:
            return pc
        return PETSc.PC().createPython(_Product(self, pc), comm=pc.comm)


def _inverse(M: Floats) -> Floats:
    """Return the inverse of a symmetric positive definite matrix.

    Raises:
        LinAlgError: for others.
    """
    lower, info = lapack.dpotri(cho_factor(M, lower=True)[0], lower=True)
    if info:
        raise LinAlgError("the matrix is singular")
    return _mirrored(lower)


def _mirrored(lower: Floats) -> Floats:
    """Return the symmetric matrix of which this is the lower part."""
    lower = np.tril(lower)
    total = lower + lower.T
    np.fill_diagonal(total, np.diag(lower))
    return np.asarray(total)


class _Product:
    """Context of a PC of type python: T^-1 K^-1 T^-T with held unknowns."""

    def __init__(self, schur: SchurComplement, pc: PETSc.PC) -> None:
        self.schur, self.pc = schur, pc

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y = A^-1 r (called by PETSc)."""
        schur, product = self.schur, self.schur.product
        assert product is not None
        G, out, basis = schur.unknowns, product.decoupled, schur.basis
        f = r.copy()
        f.array[out] = 0.0
        if basis.T is not None:
            f.array[G] = basis.T.solve_transposed(f.array_r[G])
        self.pc.apply(f, y)
        if basis.T is not None:
            y.array[G] = basis.T.solve(y.array_r[G])
        y.array[out] = r.array_r[out] / product.scale


class _Entries:
    """The entries (k, k) of S in a factorisation, which then takes them for its inverse."""

    def __init__(self, pc: PETSc.PC, k: int) -> None:
        self.factor, self.k = ctypes.c_void_p(pc.getFactorMatrix().handle), k
        self.S, self.first = ctypes.c_void_p(), ctypes.POINTER(ctypes.c_double)()

    def __enter__(self) -> Floats:
        status = ctypes.c_int()
        call("MatFactorGetSchurComplement", self.factor, _at(self.S), _at(status))
        call("MatDenseGetArray", self.S, _at(self.first))
        return np.ctypeslib.as_array(self.first, shape=(self.k, self.k)).T

    def __exit__(self, *_: object) -> None:
        call("MatDenseRestoreArray", self.S, _at(self.first))
        inverted = 2  # MAT_FACTOR_SCHUR_INVERTED
        call("MatFactorRestoreSchurComplement", self.factor, _at(self.S), inverted)
