# SPDX-License-Identifier: MIT
"""Time and memory of contact relative to one plain factorisation, on the graded Hertz problem.

Every case runs in a process of its own and measures its references itself, so that all figures
are ratios within one run:

    factorisation   symbolic and numeric, of the plain tangent with supports, same solver options
    assembly, solve of the same tangent; medians of three
    mortar          search, segments, D, M, T for one geometry / factorisation
    step            first call of newton, code compiled / (units x reference); the units are
                    frozen elastic: 4 (assembly + factorisation); updated elastic: 6 / 4 of that for
                    each geometry; plastic: 1.5 iterations (assembly + factorisation + solve)
    memory          peak of the process / peak of a process that only factorises the plain tangent
    ms              of the step, for each Newton iteration; and below each size, steps with updated
                    geometry over those with frozen geometry
    rebuilt         forms compiled, and matrix patterns analysed beyond one product and one
                    factorisation, inside newton; with updated geometry per search

The first call from empty caches and the warm default demo are timed as well (``--start``).

    python3 benchmarks/hertz_2d.py --sizes 5k 50k 200k --ranks 1 2 --output results_benchmarks
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

SIZES: dict[str, tuple[float, int]] = {
    **{"5k": (0.15, 1), "50k": (0.044, 1), "200k": (0.0218, 1)},
    **{"50kP2": (0.088, 2), "200kP2": (0.0436, 2)},
}
"""Element size of the graded mesh, and degree, by number of unknowns."""
MORTAR_LIMITS = {"5k": None, "50k": 0.10, "200k": 0.05, "50kP2": 0.10, "200kP2": 0.05}
MEMORY_LIMIT, COLD_LIMIT, WARM_LIMIT = 1.3, 20.0, 15.0
PATTERN_EVENTS = ("MatPreallCOO", "MatMatMultSym", "MatCholFctrSym")
ROOT = Path(__file__).resolve().parents[1]
STEPS = [
    (material, geometry, slave)
    for material, geometry in (
        ("elastic", "reference"),
        ("elastic", "updated"),
        ("plastic", "reference"),
        ("plastic", "updated"),
    )
    for slave in ("block", "disc")
]
parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2])
parser.add_argument("--clock", choices=["wall", "cpu"], default="wall", help="cpu: busy machine")
parser.add_argument("--start", action="store_true", help="time the demo with empty caches, too")
parser.add_argument("--only", default="", help="cases whose name contains this")
parser.add_argument("--output", type=Path, default=Path("results_benchmarks"))
parser.add_argument("--case", nargs=4, help=argparse.SUPPRESS)  # size, material, geometry, slave


# -- one case, in a process of its own ---------------------------------------------------------


class Clock:
    """Seconds of a call, the longest of all ranks."""

    def __init__(self, kind: str) -> None:
        """Choose between wall-clock and processor time."""
        self.now = time.process_time if kind == "cpu" else time.perf_counter

    def __call__(self, call: Callable[[], Any]) -> float:
        """Time one call (collective)."""
        MPI.COMM_WORLD.barrier()
        begin = self.now()
        call()
        return MPI.COMM_WORLD.allreduce(self.now() - begin, op=MPI.MAX)

    def median(self, call: Callable[[], Any]) -> float:
        """Time three calls (collective)."""
        return statistics.median(self(call) for _ in range(3))


def create_problem(
    size: tuple[float, int], material: str, geometry: str, slave: str
) -> dm.ContactProblem:
    """Set up the paper's problem at d = 0.2 mm; geometry "none" leaves the contact out."""
    h, degree = size
    mesh, _, facet_tags = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=h)
    steel = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0)
    law = steel if material == "plastic" else dm.Elastic(E=steel.E, nu=steel.nu)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    solid = dm.Solid(fem.Function(V), law)
    nodes = [fem.locate_dofs_topological(V, 1, facet_tags.find(tag)) for tag in (1, 2)]
    motions = (np.zeros(2), np.array([0.0, -0.2]))
    bcs = [fem.dirichletbc(v, n, V) for v, n in zip(motions, nodes, strict=True)]
    if geometry == "none":
        return dm.ContactProblem(solid, bcs=bcs)
    tags = (3, 4) if slave == "block" else (4, 3)
    contact = dm.Contact(facet_tags, slave=tags[0], master=tags[1])
    return dm.ContactProblem(solid, [contact], bcs=bcs, geometry=geometry)


def measure_reference(problem: dm.ContactProblem, clock: Clock) -> dict[str, float]:
    """Time assembly, factorisation and solve of the plain tangent with supports."""
    solid, linear = problem.solid, problem.linear
    K, r = solid.create_matrix(), problem.vector()

    def assemble() -> None:
        solid.assemble_tangent(K)
        solid.assemble_residual(r)

    assembly = clock.median(assemble)
    diagonal = K.getDiagonal()
    rows = (np.flatnonzero(problem.fixed[: problem.n]) + problem.first_dof).astype(PETSc.IntType)
    K.zeroRowsColumns(rows, diag=diagonal.sum() / diagonal.getSize())
    K.setOption(PETSc.Mat.Option.SPD, True)
    b = K.createVecRight()
    x = b.duplicate()
    b.set(1.0)
    factorisations, solves = [], []
    for _ in range(3):
        ksp = PETSc.KSP().create(problem.comm)
        ksp.setOptionsPrefix(linear.options.prefix)
        with linear.options.database(linear.options.prefix):
            ksp.setFromOptions()
            ksp.setType("preonly")
            ksp.setOperators(K)
            factorisations.append(clock(ksp.setUp))
        solves.append(clock.median(lambda ksp=ksp: ksp.solve(b, x)))
        ksp.destroy()
    return {
        "assembly": assembly,
        "factorisation": statistics.median(factorisations),
        "solve": statistics.median(solves),
    }


def count_patterns() -> dict[str, int]:
    """Return how many patterns PETSc has analysed so far, by event."""
    return {name: PETSc.Log.Event(name).getPerfInfo()["count"] for name in PATTERN_EVENTS}


def count_compiled() -> int:
    """Return the number of files in the cache of compiled forms."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fenics"
    return len(list(cache.glob("*.so")))


def peak_memory() -> float:
    """Return the peak resident memory of all ranks together in MB (collective)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return MPI.COMM_WORLD.allreduce(peak, op=MPI.SUM)


def run_case(
    size: tuple[float, int], material: str, geometry: str, slave: str, kind: str
) -> dict[str, Any]:
    """Measure one case (collective)."""
    clock = Clock(kind)
    PETSc.Log.begin()
    if geometry == "none":
        problem = create_problem(size, material, geometry, slave)
        return measure_reference(problem, clock) | {"memory": peak_memory()}
    # loads all compiled code
    dm.newton(create_problem((0.6, size[1]), material, geometry, slave))
    problem = create_problem(size, material, geometry, slave)
    patterns, compiled = count_patterns(), count_compiled()
    reports: list[dm.StepReport] = []
    step = clock(lambda: reports.append(dm.newton(problem)))
    report = reports[0]
    result = {
        "dofs": 2 * problem.V.dofmap.index_map.size_global,
        "step": step,
        "memory": peak_memory(),
        "iterations": len(report.iterations),
        "factorisations": sum(i.factorisations for i in report.iterations),
        "linear_iterations": sum(i.linear_iterations for i in report.iterations),
        "searches": problem.system.searches,
        "patterns": {k: v - patterns[k] for k, v in count_patterns().items()},
        "compiled": count_compiled() - compiled,
        "force": abs(float(problem.contacts[0].force[1])),
        "seconds": report.seconds,
        "per_iteration": [[i.linear_iterations, i.factorisations] for i in report.iterations],
    }
    result["mortar"] = clock.median(lambda: problem.update_geometry())
    return result | measure_reference(problem, clock)


# -- all cases ---------------------------------------------------------------------------------


def start_case(ranks: int, case: tuple[str, str, str, str], clock: str) -> dict[str, Any]:
    """Run one case in new processes and return what its rank 0 printed last."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*launcher, sys.executable, __file__, "--clock", clock, "--case", *case]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600)
    if done.returncode:
        return {"error": done.stderr.strip().splitlines()[-1:] or ["no message"]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def step_limit(material: str, geometry: str, r: dict[str, Any]) -> float:
    """Return the seconds that a step may take in units of its own references."""
    once = r["assembly"] + r["factorisation"]
    if material == "plastic":
        return 1.5 * r["iterations"] * (once + r["solve"])
    return 4.0 * once if geometry == "reference" else 1.5 * r["iterations"] * 4.0 * once


def rebuilt(r: dict[str, Any]) -> int:
    """Return the forms compiled and the patterns analysed that were not due."""
    due = {"MatMatMultSym": 2, "MatCholFctrSym": 1}  # K S and S^T K S, one factorisation
    # PETSc counts each product of a vector with the inverse of a Schur complement as a new one
    solves = {"MatMatMultSym": r["linear_iterations"]}
    extra = [
        r["patterns"][name] - n * max(1, r["searches"]) - solves.get(name, 0)
        for name, n in due.items()
    ]
    return int(r["compiled"] + sum(max(0, n) for n in extra))


def evaluate(size: str, case: tuple[str, str, str], r: dict[str, Any], memory: float) -> list[str]:
    """Add the ratios to a result and return its row of the table."""
    r["ratios"] = ratios = {
        "mortar": r["mortar"] / r["factorisation"],
        "step": r["step"] / step_limit(case[0], case[1], r),
        "memory": r["memory"] / memory,
        "rebuilt": rebuilt(r),
    }
    limits = {"mortar": MORTAR_LIMITS[size], "step": 1.0, "memory": MEMORY_LIMIT, "rebuilt": 0}
    r["missed"] = [k for k, limit in limits.items() if limit is not None and ratios[k] > limit]
    cells = [f"{r['iterations']}", f"{r['linear_iterations']}", f"{r['factorisations']}"]
    cells += [f"{100 * ratios['mortar']:.1f} %", f"{1e3 * r['step'] / r['iterations']:.1f}"]
    cells += [f"{ratios['step']:.2f}"]
    cells += [f"{ratios['memory']:.2f}", f"{ratios['rebuilt']}", " ".join(r["missed"]) or "-"]
    return cells


def compare_geometries(results: dict[str, Any], ranks: int, size: str) -> list[str]:
    """Return lines with the time of steps with updated geometry over those with frozen geometry."""
    lines = []
    for material, geometry, slave in STEPS:
        if geometry == "reference":
            continue
        names = (f"{ranks} {size} {material} {of} {slave}" for of in ("reference", geometry))
        frozen, updated = (results.get(name, {}) for name in names)
        if "step" in frozen and "step" in updated:
            updated["over_frozen"] = ratio = updated["step"] / frozen["step"]
            lines.append(
                f"{ranks:>5} {size:>6} {material} {slave}: updated over frozen {ratio:.2f}"
            )
    return lines


def time_demo(output: Path) -> dict[str, float]:
    """Time the default demo with empty caches of compiled code, and again."""
    seconds = []
    with tempfile.TemporaryDirectory() as cache:
        names = {"XDG_CACHE_HOME": cache, "NUMBA_CACHE_DIR": f"{cache}/numba"}
        for _ in range(2):
            begin = time.perf_counter()
            command = [sys.executable, ROOT / "demos/hertz/hertz.py", "--output", output / "demo"]
            subprocess.run(command, env=os.environ | names, check=True, capture_output=True)
            seconds.append(time.perf_counter() - begin)
    return {"cold_extra": seconds[0] - seconds[1], "warm": seconds[1]}


def main(options: argparse.Namespace) -> None:
    """Run all cases, print the table, write benchmarks.json."""
    options.output.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {}
    head = (
        "ranks",
        "size",
        "case",
        "its",
        "solves",
        "fact",
        "mortar",
        "ms",
        "step",
        "memory",
        "rebuilt",
    )
    line = "{:>5} {:>6} {:<24}" + " {:>7}" * 8 + " {}"
    print(line.format(*head, "missed"))
    for ranks in options.ranks:
        for size in options.sizes:
            plain = {}
            for material in ("elastic", "plastic"):
                r = start_case(ranks, (size, material, "none", "-"), options.clock)
                results[f"{ranks} {size} {material} plain"] = plain[material] = r
            for case in STEPS:
                name = " ".join(case)
                if options.only not in name:
                    continue
                r = start_case(ranks, (size, *case), options.clock)
                results[f"{ranks} {size} {name}"] = r
                row = (
                    [str(r)] if "error" in r else evaluate(size, case, r, plain[case[0]]["memory"])
                )
                row += [""] * (9 - len(row))
                print(line.format(ranks, size, name, *row), flush=True)
                path = options.output / "benchmarks.json"
                path.write_text(json.dumps(results, indent=1))
            for told in compare_geometries(results, ranks, size):
                print(told, flush=True)
    if options.start:
        results["demo"] = demo = time_demo(options.output)
        print(f"first call {demo['cold_extra']:.1f} s of compilation (limit {COLD_LIMIT:g})")
        print(f"default demo warm {demo['warm']:.1f} s (limit {WARM_LIMIT:g})")
        (options.output / "benchmarks.json").write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    arguments = parser.parse_args()
    if arguments.case:
        size, *kind = arguments.case
        measured = run_case(SIZES[size], *kind, arguments.clock)
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps(measured))
    else:
        main(arguments)
