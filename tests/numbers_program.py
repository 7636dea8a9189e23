# SPDX-License-Identifier: MIT
"""Halve and double each number of geometry and mortar; print how the operators change, as JSON.

And how they change with absurd values of those that only kernels see. Run without compilation
(NUMBA_DISABLE_JIT=1): compiled kernels would keep the number they had.
"""

import json
import math
import os
import sys
from importlib import import_module
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.geometry import area
from dolfinx_mortar.mortar.curvature_correction import find_smooth_sides, point_motions
from dolfinx_mortar.mortar.duals import default_keep, node_weights, weighted_duals
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.operators import integrate_motions
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import create_surface
from tests.cases.meshes import two_blocks
from tests.cases.meshes_3d import two_boxes
from tests.cases.mortar import bend, curved, node_matrices
from tests.cases.surfaces import assemble, grid, joined, ring

MODULES = [
    import_module(f"dolfinx_mortar.{layer}.{file.stem}")
    for layer in ("geometry", "mortar")
    for file in sorted(Path(import_module(f"dolfinx_mortar.{layer}").__path__[0]).glob("[!_]*.py"))
]


ABSURD = {
    "EPS": 10.0, "HALF_OF_DIGITS": 1.0, "ROUND_OFF": 0.1, "TINY": 1.0,
    "SAME": 1.0, "area._HIGHEST": 2,
}  # fmt: skip


def numbers():
    """Return the names of all numbers that geometry and mortar define, with their values.

    A private number belongs to its module, whatever others call by the same name.
    """
    found = {}
    for module in MODULES:
        for name, value in vars(module).items():
            table = isinstance(value, dict) and all(isinstance(v, float) for v in value.values())
            if name.strip("_").isupper() and (isinstance(value, int | float) or table):
                own = f"{module.__name__.split('.')[-1]}." if name.startswith("_") else ""
                found[own + name] = value
    return found


def replace(label, value):
    """Set a number wherever it is known."""
    own, _, name = label.rpartition(".")
    for module in MODULES:
        if name in vars(module) and module.__name__.endswith(own):
            setattr(module, name, value)
    area._rules.cache_clear()


def scaled(value, factor):
    """Return a number, or all of a table, times a factor; whole numbers stay whole."""
    if isinstance(value, dict):
        return {key: scaled(v, factor) for key, v in value.items()}
    return type(value)(value * factor)


def pairs():
    """Return pairs of surfaces in contact, all with curved sides and partly covered."""
    blocks = two_blocks(
        MPI.COMM_SELF, (8, 1), (6, 1), x_lower=(-1, 1.1), x_upper=(-1.2, 0.9), gap=0.1,
        jitter=0.5, transform=bend,
    )  # fmt: skip
    options = {"jitter": 0.4, "gap": 0.1, "transform": curved, "upper": (-0.3, 0.85, 0.2, 1.4)}
    boxes = [
        two_boxes(MPI.COMM_SELF, (2, 2, 1), (2, 3, 1), cell=cell, **options)
        for cell in ("tetrahedron", "hexahedron")
    ]
    for mesh, _, tags in (blocks, *boxes):
        V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
        yield V, tags, (3, 4)
        if mesh is blocks[0]:
            yield V, tags, (4, 3)


def operators(cases):
    """Return nodes kept, D and M times fields, motions of arms, and resultants, for all cases."""
    kept, values, resultants = [], [], []
    for V, tags, numbers_of_sides in cases:
        sides = [create_surface(V, tags, tag, "side") for tag in numbers_of_sides]
        pairing = create_pairing(*sides, None)
        segments, _ = find_segments(pairing, None)
        keep = default_keep(pairing, segments, *node_weights(pairing, segments))
        matrices = node_matrices(pairing, segments, keep)
        f = matrices[0].createVecRight()
        f.array[:] = np.cos(V.tabulate_dof_coordinates() @ [1.0, 2.0, 0.5])
        kept.append(keep)
        values += [(A * f).array.copy() for A in matrices]
        resultants += [v.sum() for v in values[-2:]]
        Phi, d = weighted_duals(pairing, segments, keep), V.dofmap.index_map_bs
        free = np.zeros((len(f.array), d), dtype=bool)
        at = point_motions(segments, find_smooth_sides(pairing, free, 40.0))
        motions = integrate_motions(pairing, segments, d * [Phi], at)
        values.append((pairing.M.matrix(motions[:, -1, -1]) * f).array.copy())
    near, far = ring(20)  # polygons of many corners
    values.append(assemble(grid([0, 1], [0, 1], k=4), joined(far, near)).used)
    return np.concatenate(kept), np.concatenate(values), np.array(resultants)


def change(cases, expected):
    """Return the largest change of operators, infinite if other nodes are kept, and resultants."""
    try:
        kept, values, resultants = operators(cases)
    except ValueError:  # something is refused
        return [math.inf, math.inf]
    same = (kept == expected[0]).all()
    nodal = float(np.abs(values - expected[1]).max()) if same else math.inf
    return [nodal, float(np.abs(resultants - expected[2]).max())]


def main():
    """Print {name: [change if halved, if doubled]} and what an absurd round-off does."""
    assert os.environ.get("NUMBA_DISABLE_JIT") == "1"
    cases = list(pairs())
    expected = operators(cases)
    table = {}
    for name, value in numbers().items():
        table[name] = []
        for factor in (0.5, 2):
            replace(name, scaled(value, factor))
            table[name].append(change(cases, expected))
        replace(name, value)
    usual, table["absurd"] = numbers(), {}
    for name, value in ABSURD.items():
        replace(name, value)
        table["absurd"][name] = change(cases, expected)
        replace(name, usual[name])
    table["again"] = [change(cases, expected)]
    json.dump(table, sys.stdout)


if __name__ == "__main__":
    main()
