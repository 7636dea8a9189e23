# SPDX-License-Identifier: MIT
"""Cost of a contact step in 3D on the quarter ball, and its iterations, which do not grow with 1/h.

Run with ``containers/run python3 benchmarks/sphere_3d.py [--h 0.125 ...] [--output FILE]``, or with
``mpirun``. One row per mesh: the first contact step, with frozen and with updated geometry,
relative to the same model with a tied interface; ten elastic steps relative to the first of them;
an elasto-plastic step relative to its Newton iterations; seconds per part, memory. Times are
elapsed times of the slowest rank; compare ratios within one run. The first mesh is solved twice, so
that no compilation is measured.
"""

import argparse
import json
import resource
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.algebra.congruence import CongruentOperator
from dolfinx_mortar.common.arrays import Ints
from dolfinx_mortar.qp import Change, LinearSolver
from dolfinx_mortar.solid.supports import rigid_motions

COMM = MPI.COMM_WORLD
E, NU = 206_900.0, 0.29
LAWS = {
    "elastic": dm.Elastic(E=E, nu=NU),
    "plastic": dm.VonMises(E=E, nu=NU, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0),
}
DEPTH = {"elastic": 0.05, "plastic": 0.1}
STEPS, CG_OF_LIMIT = 10, 20
LIMITS = {
    "contact_over_tied": 4.0,
    "updated_over_tied": 1.8,
    "updated_over_limit": 1.6,
    "history_over_first": 5.0,
    "plastic_over_warm": 2.5,
}
PARTS = ("mortar", "assembly", "transform", "linear_solves", "total")


def create(
    mesh: dm.meshing.TaggedMesh, law: str, kind: str, geometry: str = "reference", degree: int = 1
) -> tuple[dm.ContactProblem, fem.Constant]:
    """Return the problem with its interface in contact or tied, and what pushes the ball down."""
    V = fem.functionspace(mesh.mesh, ("Lagrange", degree, (3,)))
    solid = dm.Solid(fem.Function(V, name="u"), LAWS[law])
    down, zero = fem.Constant(mesh.mesh, -DEPTH[law]), fem.Constant(mesh.mesh, 0.0)
    held = [(1, 0, zero), (1, 1, zero), (1, 2, zero), (2, 0, zero), (2, 1, zero)]
    held += [(2, 2, down), (5, 0, zero), (6, 1, zero)]
    bcs = []
    for tag, component, value in held:
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 2, mesh.facet_tags.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, W))
    interface = {"contact": dm.Contact, "tie": dm.Tie}[kind]
    # facets: the arms between a ball and the block beside it would be as long as the ball
    side = interface(mesh.facet_tags, slave=3, master=4, surface="facets")
    return dm.ContactProblem(solid, [side], bcs=bcs, geometry=geometry), down


def measure(
    mesh: dm.meshing.TaggedMesh, law: str, kind: str, geometry: str = "reference", degree: int = 1
) -> dict[str, Any]:
    """Solve one step and return its numbers."""
    COMM.barrier()
    begin = perf_counter()
    problem, _ = create(mesh, law, kind, geometry, degree)
    report = dm.newton(problem)
    seconds = COMM.allreduce(perf_counter() - begin, op=MPI.MAX)
    linear = problem.linear.counts
    return {
        "seconds": seconds,
        "parts": {part: problem.timings.seconds.get(part, 0.0) for part in PARTS},
        "newton": report.newton_iterations,
        "active_set_updates": report.qp_iterations,
        "krylov": sum(i.linear_iterations for i in report.iterations),
        "set_ups": report.factorisations,
        "seconds_set_up": linear.seconds_factor,
        "seconds_iterations": linear.seconds_solve,
        "force_of_the_ball": 4.0 * float(abs(problem.interfaces[0].force[2])),
        "solver": report.linear_solver,
    }


class Plain:
    """Unknowns of multigrid without contact: displacements, supports decoupled."""

    def __init__(self, problem: dm.ContactProblem) -> None:
        """Use the tangent of the problem."""
        self.bodies, self.operator = problem.bodies, CongruentOperator(problem.K)

    def change(self, held: Ints) -> Change:
        """Return v = u."""
        self.operator.follow(None, held)
        return Change(None, self.operator.matrix)

    def motions(self, change: Change) -> list[PETSc.Vec]:
        """Return rigid motions."""
        motions = rigid_motions(self.bodies)
        for motion in motions:
            motion.array[self.operator.decoupled] = 0.0
        return motions


def measure_limit(mesh: dm.meshing.TaggedMesh, degree: int) -> float:
    """Return the seconds of what no elastic step can do without.

    One assembly, one mortar update, a set-up for the plain tangent, 20 CG iterations with it.
    """
    problem, _ = create(mesh, "elastic", "contact", "updated", degree)
    problem.begin_step()
    COMM.barrier()
    begin = perf_counter()
    problem.terms.assemble_tangent(problem.K)
    problem.follow_geometry()
    seconds = perf_counter() - begin
    held = np.flatnonzero(problem.supports.owned.ravel()).astype(np.int32)
    linear = LinearSolver(COMM, prefix="limit_", multigrid=True, unknowns=Plain(problem))
    linear.set_matrix(problem.K)
    b = problem.vector(np.cos(problem.X))
    linear.solve(b, problem.vector(), held, atol=1e-6 * b.norm())
    counts = linear.counts
    seconds += counts.seconds_factor + CG_OF_LIMIT * counts.seconds_solve / counts.iterations
    return float(COMM.allreduce(seconds, op=MPI.MAX))


def measure_history(mesh: dm.meshing.TaggedMesh, degree: int) -> dict[str, Any]:
    """Press the ball in ten equal elastic steps, with updated geometry."""
    problem, down = create(mesh, "elastic", "contact", "updated", degree)
    seconds, krylov = [], 0
    for k in range(1, STEPS + 1):
        down.value = -DEPTH["elastic"] * k / STEPS
        COMM.barrier()
        begin = perf_counter()
        report = dm.newton(problem)
        problem.commit()
        seconds.append(COMM.allreduce(perf_counter() - begin, op=MPI.MAX))
        krylov += sum(i.linear_iterations for i in report.iterations)
    return {
        "seconds": seconds,
        "krylov": krylov,
        "set_ups": problem.linear.counts.factorisations,
    }


def row(cell: str, h: float, degree: int) -> dict[str, Any]:
    """Return all numbers of one mesh."""
    mesh = dm.meshing.sphere(COMM, cell=cell, h=h)
    nodes = fem.functionspace(mesh.mesh, ("Lagrange", degree)).dofmap.index_map.size_global
    found = {
        "elastic": measure(mesh, "elastic", "contact", degree=degree),
        "updated": measure(mesh, "elastic", "contact", "updated", degree),
        "history": measure_history(mesh, degree),
        "tied": measure(mesh, "elastic", "tie", degree=degree),
        "plastic": measure(mesh, "plastic", "contact", degree=degree),
    }
    limit = measure_limit(mesh, degree)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    elastic, plastic = found["elastic"], found["plastic"]
    # assembly and a warm solve of one iteration, as they came out on average
    warm = plastic["parts"]["assembly"] + plastic["seconds_iterations"]
    return {
        "cell": cell,
        "h": h,
        "degree": degree,
        "unknowns": 3 * nodes,
        "ranks": COMM.size,
        "contact_over_tied": elastic["seconds"] / found["tied"]["seconds"],
        "updated_over_tied": found["updated"]["seconds"] / found["tied"]["seconds"],
        "updated_over_limit": found["updated"]["seconds"] / limit,
        "seconds_limit": limit,
        "history_over_first": sum(found["history"]["seconds"]) / found["history"]["seconds"][0],
        "plastic_over_warm": plastic["seconds"] / warm,
        "mortar_over_linear": elastic["parts"]["mortar"] / elastic["parts"]["linear_solves"],
        "peak_memory_gib": COMM.allreduce(memory, op=MPI.SUM),
    } | found


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table."""
    print("  unknowns  tied s  contact s ratio  CG  updated s ratio  CG  set-ups", end="")
    print("  plastic s  Newton  CG  ratio   force   GiB")
    for r in rows:
        e, u, p = r["elastic"], r["updated"], r["plastic"]
        print(
            f"{r['unknowns']:10d} {r['tied']['seconds']:7.2f}"
            f" {e['seconds']:10.2f} {r['contact_over_tied']:5.2f} {e['krylov']:3d}"
            f" {u['seconds']:10.2f} {r['updated_over_tied']:5.2f} {u['krylov']:3d}"
            f" {u['set_ups']:8d}"
            f" {p['seconds']:10.2f} {p['newton']:7d} {p['krylov']:3d} {r['plastic_over_warm']:6.2f}"
            f" {e['force_of_the_ball']:8.1f} {r['peak_memory_gib']:5.2f}"
        )
    for r in rows:
        h = r["history"]
        print(
            f"{r['unknowns']:10d} {STEPS} steps {sum(h['seconds']):.2f} s, {h['krylov']} CG, "
            f"{h['set_ups']} set-ups, {r['history_over_first']:.2f} times the first; updated step "
            f"{r['updated_over_limit']:.2f} times its limit"
        )
    print(f"limits: {LIMITS}")
    for law, name in (
        ("elastic", "active_set_updates"),
        ("elastic", "krylov"),
        ("updated", "krylov"),
        ("plastic", "krylov"),
    ):
        counts = np.array([r[law][name] / r[law]["newton"] for r in rows])
        growth = 100.0 * (counts / counts[0] - 1.0)
        print(
            f"{law} {name} per Newton iteration: growth {', '.join(f'{g:+.0f} %' for g in growth)}"
        )
    if len(rows) >= 3:
        h = [r["h"] for r in rows[-3:]]
        F = [r["elastic"]["force_of_the_ball"] for r in rows[-3:]]
        order = np.log(abs((F[0] - F[1]) / (F[1] - F[2]))) / np.log(h[0] / h[1])
        limit = F[2] + (F[2] - F[1]) / ((h[1] / h[2]) ** 2 - 1.0)
        print(f"force: observed order {order:.2f}, limit with order 2: {limit:.1f} N")


def main() -> None:
    """Measure all meshes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--h", type=float, nargs="+", default=[0.125, 0.105, 0.0884, 0.0743, 0.0625]
    )
    parser.add_argument("--cell", choices=["hexahedron", "tetrahedron"], default="hexahedron")
    parser.add_argument("--degree", type=int, choices=[1, 2], default=1)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    row(options.cell, 0.5, options.degree)  # compiles
    rows = [row(options.cell, h, options.degree) for h in options.h]
    if COMM.rank == 0:
        show(rows)
        if options.output:
            options.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
