# SPDX-License-Identifier: MIT
"""Error of the force in the plastic Hertz problem over unknowns and time, for all element types.

Run with ``containers/run python3 benchmarks/elements.py [--output DIR]``. The paper's problem at
d = 0.2 mm in one step, on graded meshes. The reference of the errors is a mesh of second-order
triangles, finer than all others. Times are those of a second solve, without compilation; compare
them within one run only. Writes elements.json and elements.png.
"""

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import dolfinx_mortar as dm
from dolfinx import fem

DEPTH = 0.2  # mm
STEEL = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0)
# name: cell, degree, volumetric part, element sizes [mm]
ELEMENTS = {
    "P1": ("triangle", 1, "full", (0.2, 0.1, 0.05, 0.025)),
    "Q1": ("quadrilateral", 1, "full", (0.2, 0.1, 0.05, 0.025)),
    "Q1 reduced": ("quadrilateral", 1, "reduced", (0.2, 0.1, 0.05, 0.025)),
    "P2": ("triangle", 2, "full", (0.4, 0.2, 0.1, 0.05)),
    "Q2": ("quadrilateral", 2, "full", (0.4, 0.2, 0.1, 0.05)),
}
REFERENCE = ("triangle", 2, "full", 0.03)


def create(cell: str, degree: int, volumetric: str, h: float) -> dm.ContactProblem:
    """Return the problem, with the disc pushed down."""
    mesh, _, facet_tags = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=h, cell=cell)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    bcs = [
        fem.dirichletbc(np.array(value), fem.locate_dofs_topological(V, 1, facet_tags.find(tag)), V)
        for tag, value in ((1, (0.0, 0.0)), (2, (0.0, -DEPTH)))
    ]
    solid = dm.Solid(fem.Function(V), STEEL, volumetric=volumetric)
    contact = dm.Contact(facet_tags, slave=3, master=4)
    return dm.ContactProblem(solid, [contact], bcs=bcs)


def measure(cell: str, degree: int, volumetric: str, h: float) -> dict[str, Any]:
    """Solve and return force, size and cost."""
    begin = perf_counter()
    problem = create(cell, degree, volumetric, h)
    report = dm.newton(problem)
    seconds = perf_counter() - begin
    layout = problem.V.dofmap.index_map
    nodes = problem.interfaces[0].gather(problem.u)
    on = nodes["active"] > 0
    peak, _ = dm.analytic.fit_pressure(nodes["x"][on, 0], nodes["pressure"][on])
    return {
        "h": h,
        "unknowns": 2 * layout.size_global,
        "force": abs(problem.interfaces[0].force[1]),
        "peak_pressure_fit": peak,
        "newton": report.newton_iterations,
        "seconds": seconds,
    }


def draw(found: dict[str, list[dict[str, Any]]], reference: float) -> Figure:
    """Draw the error of the force over unknowns and over time."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    for axes, key in zip(figure.subplots(1, 2, sharey=True), ("unknowns", "seconds"), strict=True):
        for name, rows in found.items():
            error = [100.0 * abs(row["force"] / reference - 1.0) for row in rows]
            axes.loglog([row[key] for row in rows], error, "o-", ms=4, label=name)
        axes.set(xlabel=key)
        axes.grid(alpha=0.3, which="both")
        axes.legend()
    figure.axes[0].set(ylabel="error of the contact force [%]")
    return figure


def main() -> None:
    """Measure all elements on all meshes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", nargs="+", choices=ELEMENTS, default=list(ELEMENTS))
    parser.add_argument("--output", type=Path, default=Path("results_benchmarks"))
    options = parser.parse_args()
    reference = measure(*REFERENCE)
    print(f"reference: {reference['force']:.2f} N/mm, {reference['unknowns']} unknowns")
    found: dict[str, list[dict[str, Any]]] = {}
    for name in options.elements:
        *kind, sizes = ELEMENTS[name]
        measure(*kind, 0.8)  # compiles
        found[name] = [measure(*kind, h) for h in sizes]
        for row in found[name]:
            error = row["force"] / reference["force"] - 1.0
            peak = row["peak_pressure_fit"] / reference["peak_pressure_fit"] - 1.0
            print(
                f"{name:10} h = {row['h']:5.3f} {row['unknowns']:7d} unknowns"
                f" {row['seconds']:6.2f} s"
                f" {row['newton']:3d} iterations, force {error:+8.3%}, peak {peak:+8.3%}"
            )
    options.output.mkdir(parents=True, exist_ok=True)
    rows = found | {"reference": [reference]}
    (options.output / "elements.json").write_text(json.dumps(rows, indent=1))
    draw(found, reference["force"]).savefig(options.output / "elements.png", dpi=120)


if __name__ == "__main__":
    main()
