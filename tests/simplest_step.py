# SPDX-License-Identifier: MIT
"""A program that prints what the simplest step enters: files, functions and their lines.

Of the package, between `newton` and `commit` of a frictionless step in the plane. Kernels count if
NUMBA_DISABLE_JIT=1.
"""

import ast
import json
import sys
from pathlib import Path

from mpi4py import MPI

import dolfinx_mortar as dm
from tests.cases.hertz import create_case

PACKAGE = str(Path(dm.__file__).parent)


def create():
    """Return a disc on a block that will be pressed by .1."""
    law = dm.VonMises(E=206_900.0, nu=0.29, Y=367.0, a=10_000.0)
    case = create_case(dm.meshing.hertz(MPI.COMM_WORLD), law)
    case.press(0.1)
    return case.problem


def entered(problem):
    """Return (file, name) of the functions that a step enters."""
    found = set()

    def note(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE):
            found.add((code.co_filename, code.co_name))

    sys.setprofile(note)
    dm.newton(problem)
    problem.commit()
    sys.setprofile(None)
    return found


def lengths(file):
    """Return the lines of each function of a file."""
    nodes = ast.walk(ast.parse(Path(file).read_text()))
    return {n.name: n.end_lineno - n.lineno + 1 for n in nodes if isinstance(n, ast.FunctionDef)}


if __name__ == "__main__":
    dm.newton(create())  # forms compiled
    calls = entered(create())
    files = {file: lengths(file) for file, _ in calls}
    lines = sum(files[file].get(name, 0) for file, name in calls)
    print(json.dumps([len(files), len(calls), lines]))
