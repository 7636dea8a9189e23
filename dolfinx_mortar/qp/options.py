# SPDX-License-Identifier: MIT
"""Options of a linear solver: kept out of PETSc's database, checked early, reported if unused."""

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import call
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arguments import Rule, check, check_optional, instance

DEFAULTS = {
    "ksp_type": "cg",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    # PETSc's estimate by CG reads what was never written where a matrix is indefinite, and may be
    # an error on one rank only (3.22 to 3.24, cgeig.c); GMRES estimates without.
    "pc_gamg_esteig_ksp_type": "gmres",
}
GENERAL = {"ksp_type": "gmres", "pc_type": "lu"}
# In 3D. The threshold drops round-off; a third smoothing step saves a third of the iterations;
# Chebyshev's interval ends at 1.2, as later tangents may exceed 1.1.
MULTIGRID = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.005,
    "mg_levels_ksp_max_it": 3,
    "mg_levels_ksp_chebyshev_esteig": "0,0.1,0,1.2",
    "ksp_max_it": 500,
}
DIRECT = ("cholesky", "lu")
# First letters of options that choose or limit a method.
OF_METHODS = ("pc_", "mg_", "ksp_type", "ksp_max_it")
# PETSc reads them, but our convergence test ends the iteration.
OVERRULED = {"ksp_rtol", "ksp_atol", "ksp_divtol"}
VALUES = (str, int, float, bool, np.number, type(None))


class SolverOptions:
    """PETSc options under a prefix, over defaults; the user's options database takes precedence.

    `definite`: whether the defaults are those of definite matrices; `grown`: enlarged workspaces.
    """

    def __init__(
        self, prefix: str, options: Mapping[str, Any] | None, *, multigrid: bool = False
    ) -> None:
        self.prefix = prefix
        self.given = dict(options or {})
        self.grown: dict[str, Any] = {}
        self.definite = True
        self.multigrid = multigrid
        ours = DEFAULTS | MULTIGRID
        self._unread = {k for k, v in self.given.items() if k not in ours or v != ours[k]}

    def __getitem__(self, key: str) -> str:
        return str(PETSc.Options(self.prefix).getString(key, str(self.values[key])))

    @property
    def values(self) -> dict[str, Any]:
        """The options over the defaults."""
        methods = DEFAULTS if self.definite else DEFAULTS | GENERAL
        values = methods | (MULTIGRID if self.multigrid else {}) | self.given | self.grown
        if not self.definite and values["pc_type"] == DEFAULTS["pc_type"]:
            values["pc_type"] = GENERAL["pc_type"]  # Cholesky reads one half of a matrix
        return values

    @property
    def direct(self) -> bool:
        """Whether the preconditioner is a factorisation."""
        return self["pc_type"] in DIRECT

    @property
    def chosen(self) -> bool:
        """Whether the user has chosen the method, also by PETSc's options database."""
        names = {*self.given, *PETSc.Options(self.prefix).getAll()}
        return any(name.startswith(OF_METHODS) for name in names)

    @contextmanager
    def database(self, prefix: str) -> Iterator[None]:
        """Put the options into PETSc's database in a block."""
        opts, used, values = PETSc.Options(prefix), ctypes.c_int(0), self.values
        read = {key for key in values if opts.hasName(key)}
        mine = [key for key in values if key not in read]
        for key in mine:
            opts.setValue(key, values[key])
        try:
            yield
        finally:
            for key in mine:
                name = f"{prefix}{key}".encode()
                call("PetscOptionsUsed", None, name, ctypes.byref(used))
                read |= {key} if used.value else set()
                opts.delValue(key)
            self._unread -= read - OVERRULED if prefix == self.prefix else read

    def unread(self) -> list[str]:
        """The user's options that PETSc has not read."""
        return sorted(self._unread)


def check_options(comm: MPI.Comm, prefix: str, options: Mapping[str, Any] | None) -> None:
    """Check options by a small matrix on each rank (collective).

    Raises:
        ValueError: on all ranks, for options (without prefix) that are no mapping to numbers and
            strings, or that PETSc refuses.
    """
    check("comm", comm, instance(MPI.Comm, "give an MPI communicator, such as MPI.COMM_WORLD"))
    with raised_together(comm):
        check("petsc_options_prefix", prefix, instance(str, "give a text, such as 'contact_'"))
        check_optional("petsc_options", options, NAMED)
        try:
            _try_out(SolverOptions(prefix, options))
        except PETSc.Error as error:
            given = SolverOptions(prefix, options).values
            why = str(error).strip().splitlines()[-1]
            raise ValueError(
                f"petsc_options: PETSc refuses {given}: {why}. Choose methods that this PETSc has"
            ) from error


def _named(options: Any) -> Any:
    if not isinstance(options, Mapping):
        return None
    keys = all(isinstance(k, str) and k.strip() and k[0] != "-" for k in options)
    return options if keys and all(isinstance(v, VALUES) for v in options.values()) else None


NAMED: Rule[Any] = Rule(
    "give a dictionary of PETSc's names, with no dash and no prefix, and numbers or texts", _named
)


def _try_out(options: SolverOptions) -> None:
    A = PETSc.Mat().createConstantDiagonal(8, 1.0, comm=MPI.COMM_SELF).convert("aij")
    A.setOption(PETSc.Mat.Option.SPD, True)
    ksp = PETSc.KSP().create(MPI.COMM_SELF)
    ksp.setOptionsPrefix(options.prefix)
    try:
        with options.database(options.prefix):
            ksp.setFromOptions()
            ksp.setOperators(A)
            ksp.setUp()
    finally:
        ksp.destroy()
        A.destroy()
