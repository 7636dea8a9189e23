# SPDX-License-Identifier: MIT
"""What MUMPS says about a factorisation that failed."""

from petsc4py import PETSc

# INFOG(1): workspace too small; ICNTL(14) is the percentage by which it exceeds the estimate.
WORKSPACE_ERRORS = (-8, -9)
WORKSPACE = "mat_mumps_icntl_14"
# INFOG(1): could not allocate, or not within its limit; and PETSc's PC_FACTOR_OUTMEMORY.
MEMORY_ERRORS, OUT_OF_MEMORY = (-7, -13, -18, -19, -20), 3


def mumps_factor(pc: PETSc.PC) -> PETSc.Mat | None:
    """Return the factor if it is one of MUMPS."""
    direct = pc.getType() in ("cholesky", "lu")
    return pc.getFactorMatrix() if direct and pc.getFactorSolverType() == "mumps" else None


def enough_workspace(pc: PETSc.PC) -> int | None:
    """Return a value of ICNTL(14) that doubles the workspace, if that is why MUMPS failed."""
    factor = mumps_factor(pc)
    if factor is None or factor.getMumpsInfog(1) not in WORKSPACE_ERRORS:
        return None
    return 2 * max(int(factor.getMumpsIcntl(14)), 20)


def reason(pc: PETSc.PC) -> str:
    """Return the codes of a failure."""
    factor = mumps_factor(pc)
    code = f", MUMPS INFOG(1) = {factor.getMumpsInfog(1)}" if factor is not None else ""
    return f"PETSc reason {pc.getFailedReason()}{code}"


def remedy(pc: PETSc.PC) -> str:
    """Say what to do about a failure."""
    factor = mumps_factor(pc)
    code = 0 if factor is None else factor.getMumpsInfog(1)
    if code in WORKSPACE_ERRORS:
        return (
            f"PETSc's options database has -{pc.getOptionsPrefix()}{WORKSPACE}, which keeps the "
            "workspace too small: raise it, or leave it out."
        )
    if code in MEMORY_ERRORS or pc.getFailedReason() == OUT_OF_MEMORY:
        return (
            "It does not fit into memory. Use an iterative solver, as is the default in 3D: "
            'petsc_options={"ksp_type": "cg", "pc_type": "gamg"}; or more ranks on more machines.'
        )
    return (
        "Most often a body is held by nothing: add a Dirichlet condition or a contact that holds "
        "it, or check the material constants."
    )
