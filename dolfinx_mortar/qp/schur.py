# SPDX-License-Identifier: MIT
"""A factorisation by MUMPS that leaves some unknowns for last: their Schur complement is dense.

With bounded unknowns B last, A is factorised up to S = A_BB - A_BI A_II^-1 A_IB. Which of them are
held concerns S alone, so that one factorisation serves all active sets, each for a Cholesky
factorisation of order k = |B|. Numeric factorisation and solve cost 1.0 to 1.1 of those without
(5 and 47 thousand unknowns with k = 51 and 133; 1.5 and 1.1 at 182 thousand, k = 209). The analysis
takes half the time and less, since MUMPS then orders by minimum degrees.

PETSc has this on one rank only, and petsc4py 3.22 does not wrap it.
"""

from __future__ import annotations

import ctypes

from petsc4py import PETSc

import numpy as np
from scipy.linalg import cho_factor

from dolfinx_mortar.arrays import EPS, Floats, Ints
from dolfinx_mortar.qp.bound_qp import BoundQP
from dolfinx_mortar.qp.options import SolverOptions

# Symbols are looked up in the libraries that petsc4py itself is linked with.
_lib = ctypes.CDLL(PETSc.__file__)
_at = ctypes.byref


def _call(name: str, *arguments: object) -> None:
    """Call a PETSc function and raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def set_apart(qp: BoundQP, options: SolverOptions) -> Ints | None:
    """Return the unknowns that a factorisation may leave for last; None for an ordinary one.

    These are the bounded ones, ascending, on one rank, without friction (which holds others, too),
    if S has no more entries than A, and if PETSc's library shows the function.
    """
    if not hasattr(_lib, "MatFactorSetSchurIS"):  # a petsc4py that hides its symbols
        return None
    k = qp.bounded.size
    mumps = options["pc_type"] == "cholesky" and options["pc_factor_mat_solver_type"] == "mumps"
    serial = qp.comm.size == 1 and qp.definite and qp.friction is None
    if not (serial and mumps and 0 < k < qp.A.getSize()[0]):
        return None
    return np.sort(qp.bounded) if k**2 <= qp.A.getInfo()["nz_used"] else None


class SchurComplement:
    """The Schur complement in a factorisation, with some of its unknowns held.

    Args:
        unknowns: (k,) of the matrix, ascending.

    Attributes:
        unknowns: as above.
        S: (k, k) symmetric, of the last factorisation.
        prepared: whether the PC knows of it.
    """

    def __init__(self, unknowns: Ints) -> None:
        """Store the unknowns."""
        self.unknowns = unknowns
        self.S: Floats = np.zeros((0, 0))
        self.prepared = False
        self._held: Ints | None = None

    def prepare(self, pc: PETSc.PC) -> None:
        """Leave the unknowns for last in the first factorisation of a PC."""
        if self.prepared:
            return
        self.prepared = True
        pc.setFactorSetUpSolverType()
        last = PETSc.IS().createGeneral(self.unknowns.astype(PETSc.IntType), comm=pc.comm)
        factor = ctypes.c_void_p(pc.getFactorMatrix().handle)
        _call("MatFactorSetSchurIS", factor, ctypes.c_void_p(last.handle))

    def read(self, pc: PETSc.PC) -> None:
        """Take S from a new factorisation; nothing is held in it yet."""
        with _Entries(pc, self.unknowns.size) as entries:
            lower = np.tril(entries)  # all that MUMPS gives
            self.S = lower + np.tril(lower, -1).T
        self._held = None

    def hold(self, pc: PETSc.PC, held: Ints) -> None:
        """Hold these of the unknowns in the next solves: x = 0 there.

        Raises:
            LinAlgError: if S without them is not positive definite.
        """
        if self._held is not None and np.array_equal(self._held, held):
            return
        on = np.isin(self.unknowns, held)
        free = ~on
        cho_factor(self.S[np.ix_(free, free)])  # PETSc would stop in the solve
        changed = np.where(on[:, None] | on, 0.0, self.S)
        changed[on, on] = np.abs(np.diag(self.S)).max() / EPS**2  # x = 0 up to round-off
        with _Entries(pc, self.unknowns.size) as entries:
            entries[:] = changed
        self._held = held.copy()


class _Entries:
    """The entries (k, k) of S in a factorisation, which factorises them anew afterwards."""

    def __init__(self, pc: PETSc.PC, k: int) -> None:
        self.factor, self.k = ctypes.c_void_p(pc.getFactorMatrix().handle), k
        self.S, self.first = ctypes.c_void_p(), ctypes.POINTER(ctypes.c_double)()

    def __enter__(self) -> Floats:
        status = ctypes.c_int()
        _call("MatFactorGetSchurComplement", self.factor, _at(self.S), _at(status))
        _call("MatDenseGetArray", self.S, _at(self.first))
        return np.ctypeslib.as_array(self.first, shape=(self.k, self.k)).T

    def __exit__(self, *_: object) -> None:
        _call("MatDenseRestoreArray", self.S, _at(self.first))
        unfactored = 0  # MAT_FACTOR_SCHUR_UNFACTORED
        _call("MatFactorRestoreSchurComplement", self.factor, _at(self.S), unfactored)
