# SPDX-License-Identifier: MIT
"""The same contact step on more ranks: weak scaling with messages and bytes, and speed-up.

Run with ``containers/run python3 benchmarks/scaling_3d.py [--ranks 1 2 4] [--h 0.125] [--weak]
[--output FILE]``; it starts ``mpirun`` itself.
The elasto-plastic quarter ball is pressed in one step. Weak scaling: the number of unknowns per
rank is that of the first row. Strong scaling: one mesh on one and two ranks, with processor time
and elapsed time, which differ where a rank waits for a core. Messages, bytes and reductions are
PETSc's (matrices, vectors, multigrid), per rank. The data that the search sends are counted
separately: slave cones, which every rank gathers, and master facets, which are sent to a rank.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

STRONG = 0.0667
THINNER = 0.376
"""Power of the ranks by which h falls so that each has as many unknowns, of graded meshes."""


def work(h: float, log: str) -> None:
    """Solve one step on this process's ranks and print its numbers."""
    import petsc4py

    petsc4py.init(["", "-log_view", f":{log}"])
    from mpi4py import MPI

    from dolfinx_mortar import meshing, newton

    sys.path.insert(0, str(Path(__file__).parent))
    from sphere_3d import create

    comm = MPI.COMM_WORLD
    newton(
        create(meshing.sphere(comm, cell="hexahedron", h=0.5), "plastic", "contact")[0]
    )  # compiles
    mesh = meshing.sphere(comm, cell="hexahedron", h=h)
    comm.barrier()
    begin = perf_counter(), process_time()
    problem, _ = create(mesh, "plastic", "contact")
    report = newton(problem)
    wall, cpu = perf_counter() - begin[0], process_time() - begin[1]
    pairing = problem.system.links[0].pairing
    facets = len(pairing.slave.facets)
    found = {
        "unknowns": 3 * problem.V.dofmap.index_map.size_global,
        "wall": comm.allreduce(wall, op=MPI.MAX),
        "cpu": comm.allreduce(cpu, op=MPI.MAX),
        "newton": report.newton_iterations,
        "krylov": sum(i.linear_iterations for i in report.iterations),
        "set_ups": report.factorisations,
        "parts": problem.timings.seconds,
        "slave_facets": comm.allreduce(facets),
        "slave_facets_of_a_rank": comm.allreduce(facets, op=MPI.MAX),
        "cones_gathered": comm.allreduce(len(pairing.groups)),
        "master_facets_received": comm.allreduce(len(pairing.master_facets), op=MPI.MAX),
    }
    if comm.rank == 0:
        print(json.dumps(found), flush=True)


def measure(ranks: int, h: float) -> dict[str, Any]:
    """Run `work` on some ranks and return its numbers with PETSc's."""
    with tempfile.TemporaryDirectory() as folder:
        log = f"{folder}/log"
        command = ["mpirun", "-n", str(ranks), sys.executable, __file__, "--work", str(h), log]
        environment = os.environ | {"OMPI_MCA_rmaps_base_oversubscribe": "1"}
        job = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if job.returncode:
            sys.exit(job.stdout + job.stderr)
        text = Path(log).read_text()
    found: dict[str, Any] = json.loads(job.stdout.splitlines()[-1])
    for name, key in (
        ("Count", "messages"),
        ("Len \\(bytes\\)", "bytes"),
        ("Reductions", "reductions"),
    ):
        match = re.search(rf"^MPI (?:Msg )?{name}: +([0-9.e+-]+)", text, re.MULTILINE)
        found[key] = float(match[1]) if match else float("nan")
    return {"ranks": ranks, "h": h} | found


def show(title: str, rows: list[dict[str, Any]]) -> None:
    """Print a table."""
    print(f"\n{title}\nranks  unknowns  wall s  CPU s  Newton   CG  us CPU/unknown/CG", end="")
    print("  messages      MB  reductions  slave facets (a rank)  cones  masters received")
    for r in rows:
        each = 1e6 * r["cpu"] * r["ranks"] / r["unknowns"] / r["krylov"]
        print(
            f"{r['ranks']:5d} {r['unknowns']:9d} {r['wall']:7.1f} {r['cpu']:6.1f} {r['newton']:7d}"
            f" {r['krylov']:4d} {each:16.2f} {r['messages']:9.0f} {r['bytes'] / 1e6:7.1f}"
            f" {r['reductions']:11.0f} {r['slave_facets']:8d} ({r['slave_facets_of_a_rank']:5d})"
            f" {r['cones_gathered']:12d} {r['master_facets_received']:12d}"
        )


def main() -> None:
    """Measure both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 4], help="of the weak table")
    parser.add_argument("--h", type=float, default=0.125, help="at the contact, on one rank")
    parser.add_argument("--weak", action="store_true", help="no speed-up on two ranks")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    if options.work:
        work(float(options.work[0]), options.work[1])
        return
    weak = [measure(n, round(options.h * n**-THINNER, 4)) for n in options.ranks]
    show("weak", weak)
    found = {"weak": weak}
    if not options.weak:
        found["strong"] = strong = [measure(ranks, STRONG) for ranks in (1, 2)]
        show("strong", strong)
        print(f"speed-up on two ranks: {strong[0]['wall'] / strong[1]['wall']:.2f}")
    if options.output:
        options.output.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
