# SPDX-License-Identifier: MIT
"""Functions of PETSc's library that petsc4py 3.22 does not wrap."""

import ctypes

from petsc4py import PETSc

# Symbols are looked up in the libraries that petsc4py itself is linked with.
_lib = ctypes.CDLL(PETSc.__file__)


def has(name: str) -> bool:
    """Tell whether the library shows a function: a petsc4py may hide its symbols."""
    return hasattr(_lib, name)


def call(name: str, *arguments: object) -> None:
    """Call a function and raise its error."""
    error = getattr(_lib, name)(*arguments)
    if error:
        raise PETSc.Error(error)
