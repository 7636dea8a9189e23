# SPDX-License-Identifier: MIT
"""Ironing in 3D at finite strain: a half cylinder or a ball pressed into a block and dragged.

Run with ``containers/run python3 benchmarks/ironing_3d.py [--tool ball] [--n 1 2] [--output FILE]``
or with ``mpirun``. A rubber tool of radius 1, ten times as stiff as the block, goes down by 0.2 and
then along by 1.5 diameters in 20 steps. One row per mesh: Newton and linear iterations a step, cut
steps, wall-clock seconds of the slowest rank, forces while it slides, which hardly depend on the
mesh, and without friction the horizontal force, which is due to facets and to the ends of the
block. The ends of the cylinder and the sides of its block slide in two planes, so that the problem
is one of plane strain.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.meshing.two_bodies import Arrays, all_at, two_bodies

COMM = MPI.COMM_WORLD
BLOCK, HUB, DEPTH, GAP = (6.0, 2.4, 1.0), 0.5, 0.2, 0.02  # lengths; radius of what moves the tool
WAY, PRESSES, DRAGS = 3.0, 4, 20
START = 1.5  # of the middle of the tool, along the block
HALF = {"cylinder": np.pi / 2, "ball": np.radians(56.0)}  # angle from the bottom to the rim
SIDES = {"tool": ("underside", "top"), "block": ("top", "underside")}  # slave, master


@dataclass
class Ironing:
    """The problem, its contact, and the displacement of the hub."""

    problem: dm.ContactProblem
    contact: dm.Contact
    motion: fem.Constant

    def move(self, t: float) -> None:
        """Go down until t = 1, along until t = 2."""
        down = DEPTH + GAP
        self.motion.value[:] = WAY * max(t - 1.0, 0.0), 0.0, -down * min(t, 1.0)

    @property
    def times(self) -> list[float]:
        """Ends of the steps."""
        down, along = np.linspace(0, 1, PRESSES + 1), np.linspace(1, 2, DRAGS + 1)
        return [*down[1:].tolist(), *along[1:].tolist()]


def _grid(x: Floats, y: Floats, z: Floats) -> Arrays:
    """Return nodes and hexahedra of a block of nodes (layers, rows, columns)."""
    k, j, i = x.shape
    number = np.arange(k * j * i).reshape(k, j, i)
    parts = [
        number[a : k - 1 + a, b : j - 1 + b, c : i - 1 + c].ravel()
        for a in (0, 1)
        for b in (0, 1)
        for c in (0, 1)
    ]
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.stack(parts, axis=1)


def _block(n: int) -> Arrays:
    """Layers become twice as high towards the base, z = -1."""
    ends = [
        np.linspace(0.0, length, int(c * n) + 1)
        for length, c in zip(BLOCK, (28, 11, 5), strict=True)
    ]
    s = ends[2] / BLOCK[2]
    z, y, x = np.meshgrid(
        -BLOCK[2] * (4 * (1 - s) - (1 - s) ** 2) / 3, ends[1] - BLOCK[1] / 2, ends[0], indexing="ij"
    )
    return _grid(x, y, z)


def _tool(n: int, kind: str) -> Arrays:
    """Shells between the hub and the underside; those of a ball from a cube's face, in angles."""
    layers, half = 2 * n + 1, HALF[kind]
    r, b, a = np.meshgrid(
        np.linspace(HUB, 1.0, layers + 1),
        np.linspace(-1.0, 1.0, (9 if kind == "ball" else 8) * n + 1),
        np.linspace(-1.0, 1.0, (9 if kind == "ball" else 14) * n + 1),
        indexing="ij",
    )
    if kind == "ball":
        x, y = np.tan(half * a), np.tan(half * b)
        size = np.sqrt(1.0 + x**2 + y**2)
        x, y, z = r * x / size, r * y / size, -r / size
    else:
        x, y, z = r * np.sin(half * a), BLOCK[1] / 2 * b, -r * np.cos(half * a)
    nodes, cells = _grid(x + START, y, z + 1.0 + GAP)
    return nodes, cells[:, [4, 5, 6, 7, 0, 1, 2, 3]]  # r goes down


def create(
    tool: str, n: int, *, friction: float = 0.0, slave: str = "tool", options: dict | None = None
) -> Ironing:
    """Return the problem on n times as many cells in each direction; collective."""

    def sides(of_block: Bools, x: Floats) -> dict[str, Bools]:
        r = np.linalg.norm((x - [START, 0.0, 1.0 + GAP]) * (1.0, tool == "ball", 1.0), axis=2)
        return {
            "base": of_block & all_at(x[:, :, 2], -BLOCK[2], 1e-9),
            "top": of_block & all_at(x[:, :, 2], 0.0, 1e-9),
            "underside": ~of_block & all_at(r, 1.0, 1e-9),
            "hub": ~of_block & all_at(r, HUB, 1e-9),
            "planes": all_at(np.abs(x[:, :, 1]), BLOCK[1] / 2, 1e-9),
        }

    bodies = "block", "tool"
    parts = two_bodies(
        COMM, lambda: (_block(n), _tool(n, tool)), "hexahedron", "ironing", bodies, sides
    )
    mesh = parts.mesh
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    still, motion = fem.Constant(mesh, np.zeros(3)), fem.Constant(mesh, np.zeros(3))

    def held(W: fem.FunctionSpace, side: str) -> np.ndarray:
        return np.asarray(fem.locate_dofs_topological(W, 2, parts.facet_tags.find(side)))

    bcs = [
        fem.dirichletbc(value, held(V, side), V)
        for side, value in (("base", still), ("hub", motion))
    ]
    if tool == "cylinder":
        W = V.sub(1)
        bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), held(W, "planes"), W))
    laws = {"block": dm.NeoHooke(E=1.0, nu=0.3), "tool": dm.NeoHooke(E=10.0, nu=0.3)}
    solid = dm.Solid(fem.Function(V, name="u"), laws, parts.cell_tags, strain="finite")
    law = {"friction": friction} if friction else {}
    contact = dm.Contact(parts.facet_tags, slave=SIDES[slave][0], master=SIDES[slave][1], **law)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, petsc_options=options)
    return Ironing(problem, contact, motion)


def row(
    tool: str, n: int, friction: float, slave: str, presses: int | None = None
) -> dict[str, Any]:
    """Solve all steps on one mesh, or the first few, and return their numbers."""
    case = create(tool, n, friction=friction, slave=slave)
    begin, newton, linear, forces, parts = perf_counter(), [], [], [], 0
    times = case.times[:presses]
    for step in dm.load_steps(case.problem, times, on_time=case.move):
        newton.append(sum(part.newton_iterations for part in step.parts))
        linear.append(sum(i.linear_iterations for part in step.parts for i in part.iterations))
        forces.append(case.contact.force.tolist())
        parts += len(step.parts)
        if COMM.rank == 0:
            print(f"  {step.time:.3f}: {newton[-1]} Newton, {linear[-1]} linear", flush=True)
    seconds = COMM.allreduce(perf_counter() - begin, op=MPI.MAX)
    V = case.problem.V
    return {
        "tool": tool,
        "friction": friction,
        "slave": slave,
        "unknowns": V.dofmap.index_map.size_global * V.dofmap.index_map_bs,
        "steps": len(times),
        "cuts": parts - len(times),
        "newton": newton,
        "linear": linear,
        "seconds": seconds,
        "parts": dict(case.problem.timings.seconds),
        "forces": forces,
        "solver": case.problem.linear.description,
    }


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    print(
        "tool      slave   mu  unknowns  steps  cuts  Newton a step  linear  s a step  force  drag"
    )
    for r in rows:
        H, _, V = np.abs(r["forces"]).T
        middle = slice(PRESSES + DRAGS // 4, PRESSES + 3 * DRAGS // 4)
        newton, linear = sum(r["newton"]), sum(r["linear"])
        print(
            f"{r['tool']:9} {r['slave']:6} {r['friction']:3g} {r['unknowns']:9d} {r['steps']:6d}"
            f" {r['cuts']:5d} {newton / r['steps']:14.1f} {linear / newton:7.1f}"
            f" {r['seconds'] / r['steps']:9.2f} {V[middle].mean():6.4f} {H[middle].mean():6.4f}"
        )


def main() -> None:
    """Measure all meshes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tool", choices=list(HALF), nargs="+", default=list(HALF))
    parser.add_argument("--n", type=int, nargs="+", default=[1, 2], help="refinements: 1 to 4")
    parser.add_argument("--friction", type=float, nargs="+", default=[0.0])
    parser.add_argument("--slave", choices=list(SIDES), nargs="+", default=["tool"])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    row("ball", 1, 0.0, "tool", presses=1)  # compiles
    rows = [
        row(tool, n, friction, slave)
        for tool in options.tool
        for n in options.n
        for friction in options.friction
        for slave in options.slave
    ]
    if COMM.rank == 0:
        show(rows)
        if options.output:
            options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
