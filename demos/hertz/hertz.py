# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A half disc pressed into a block, both elasto-plastic
#
# The benchmark of Cermak, Svetlik, Varga, Pospisil (2024). This demo shows how to
#
# - describe two elasto-plastic bodies with one displacement and a law per cell tag,
# - let them touch across non-matching meshes by the dual mortar method,
# - walk through load steps, write every step for ParaView, and check each against Hertz.
#
# The half disc of radius 8 mm touches the block $[-15, 15] \times [-10, 0]$ mm in the origin. The
# block is clamped at the bottom, the flat face of the disc is pushed down by $d$. In every step
#
# $$\min_v \Psi(v) - f \cdot v \quad\text{subject to}\quad B_E v = c_E,\; B_I v \le c_I,$$
#
# with $B_I = N^T (D - M)$ the weighted gap of the mortar method. Units: mm, MPa, N per mm.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

RADIUS = 8.0  # mm
NOTHING = 1e-300  # N/mm, where Hertz' formulas want a force and there is none

parser = argparse.ArgumentParser(
    description="A half disc pressed into a block, both elasto-plastic."
)
parser.add_argument("--displacement", type=float, default=0.2, help="of the flat face, in mm")
parser.add_argument("--steps", type=int, default=1, help="number of equal load steps")
parser.add_argument("--material", choices=["plastic", "elastic"], default="plastic")
parser.add_argument("--slave", choices=["block", "disc"], default="block")
parser.add_argument("--mesh", choices=["paper", "graded"], default="paper")
parser.add_argument("--h", type=float, default=0.05, help="element size at the contact (graded)")
parser.add_argument("--cell", choices=["triangle", "quadrilateral"], default="triangle")
parser.add_argument("--degree", type=int, choices=[1, 2], default=1, help="of the displacement")
parser.add_argument("--geometry", choices=["reference", "updated"], default="updated")
parser.add_argument("--surface", choices=["smooth", "facets"], default="smooth")
parser.add_argument("--qp", default="active-set", help="active-set or interior-point")
parser.add_argument("--rtol", type=float, default=1e-6, help="tolerance of Newton's method")
parser.add_argument("--output", type=Path, default=Path("results/hertz"))


def main(options: argparse.Namespace) -> None:
    """Solve the benchmark, write its results."""
    comm = MPI.COMM_WORLD

    # ## Mesh
    #
    # Both bodies live in one mesh with two disconnected parts. Cell tags tell them apart (block,
    # disc); facet tags mark the supports (bottom, flat: the flat face of the disc) and the sides of
    # the interface (top of the block, arc of the disc).

    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        comm, kind=options.mesh, h=options.h, cell=options.cell
    )

    # ## Bodies
    #
    # Von Mises plasticity with kinematic hardening,
    #
    # $$|\mathrm{dev}\,\sigma - a \varepsilon_p| \le Y$$
    #
    # in the Frobenius norm: a uniaxial yield stress of 450 MPa. Only the energy is written by hand;
    # stress and consistent tangent are its derivatives. Triangles of degree 1 are too stiff in
    # plastic flow; those of degree 2 need a quarter of the elements for the same force.

    steel = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0)
    if options.material == "elastic":
        steel = dm.Elastic(E=steel.E, nu=steel.nu)
    V = fem.functionspace(mesh, ("Lagrange", options.degree, (2,)))
    u = fem.Function(V, name="displacement")
    solid = dm.Solid(u, {"block": steel, "disc": steel}, cell_tags)

    # ## Supports and contact
    #
    # The slave side carries the multipliers (the pressures); either side may be the slave. The gap
    # is that of smooth surfaces through the nodes, or of the facets, as in the paper.

    push = fem.Constant(mesh, np.zeros(2))
    bottom, flat = (
        fem.locate_dofs_topological(V, 1, facet_tags.find(side)) for side in ("bottom", "flat")
    )
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, flat, V)]
    slave, master = ("top", "arc") if options.slave == "block" else ("arc", "top")
    contact = dm.Contact(facet_tags, slave=slave, master=master, surface=options.surface)
    problem = dm.ContactProblem(
        solid, [contact], bcs=bcs, geometry=options.geometry, petsc_options_prefix="hertz_"
    )

    # ## Load steps
    #
    # The load level is the depth; a table says what `push` is at a level, linear between its rows.
    # Each step is solved by the semi-smooth Newton method, with a bound-constrained QP in every
    # iteration. A step that fails is cut in half; what has been written stays readable.

    options.output.mkdir(parents=True, exist_ok=True)
    results = options.output / "hertz.xdmf"
    levels = np.linspace(0.0, options.displacement, options.steps + 1)[1:]
    ramp = {push: [(0.0, np.zeros(2)), (levels[-1], np.array([0.0, -levels[-1]]))]}
    steps = []
    with dm.Writer(results, problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, levels, ramp=ramp, qp=options.qp, rtol=options.rtol):
            writer.write(step.time)
            nodes = contact.gather(u)
            x = nodes["X" if options.geometry == "reference" else "x"][:, 0]
            steps.append(measure(step, problem, steel, x, nodes))
    more = {"slave_nodes": len(x), "options": vars(options)}
    dm.write_summary(options.output / "summary.json", problem, steps, **more)

    # ## Pictures
    #
    # The paper's figures 2 to 7 and the contact pressure against Hertz.

    if comm.rank == 0:
        print(step.report)
        figures.draw(options.output, results, steps[-1], (x, nodes["pressure"]))
        line = "{force:.1f} N/mm, peak pressure {peak_pressure:.0f} MPa, results in"
        print(line.format(**steps[-1]), options.output)


# ## What is measured in a step
#
# The half-width is known to one element from the last node in contact; a least-squares fit of
# Hertz' semi-ellipse, $p^2 = p_0^2 (1 - x^2/b^2)$, resolves it much better. With updated geometry
# $x$ is the current position, with frozen geometry the reference one.


def measure(
    step: dm.LoadStep,
    problem: dm.ContactProblem,
    steel: dm.VonMises | dm.Elastic,
    x: np.ndarray,
    nodes: dict[str, np.ndarray],
) -> dict:
    """Return the step's cost, force and pressure beside Hertz, the largest stress and strain."""
    p, active = nodes["pressure"], nodes["active"] > 0
    solid, contact = problem.solid, problem.interfaces[0]
    force = abs(contact.force[1])
    peak, width = dm.analytic.fit_pressure(x[active], p[active])
    hertz = dm.analytic.hertz_line(max(force, NOTHING), RADIUS, *(steel.E, steel.nu) * 2)
    return dm.summarise(step) | {
        "displacement": step.time,
        "force": force,
        "peak_pressure": p.max(),
        "peak_pressure_fit": peak,
        "peak_pressure_hertz": hertz.peak_pressure,
        "half_width_edge": edge(x, p),
        "half_width_fit": width,
        "half_width_hertz": hertz.half_width,
        "max_von_mises": solid.max("von_mises"),
        "max_plastic_strain": solid.max("plastic_strain_norm"),
        "max_back_stress": solid.max("back_stress_norm"),
        "plastic_area": solid.plastic_area(),
        "active_nodes": active.sum(),
    }


def edge(x: np.ndarray, p: np.ndarray) -> float:
    """Return half the distance of the two points where p^2, extrapolated, reaches zero.

    Towards each end the last two loaded nodes make the line; its zero is kept between the last
    loaded node and the next one.
    """
    if np.count_nonzero(p > 0) < 2:
        return 0.0
    order = np.argsort(x)
    x, p = x[order], p[order]
    ends = []
    for s, q in ((x, p), (-x[::-1], p[::-1])):
        last = int(np.flatnonzero(q > 0)[-1])
        slope = (q[last] ** 2 - q[last - 1] ** 2) / (s[last] - s[last - 1])
        beyond = s[last] - q[last] ** 2 / slope if slope < 0 else np.inf
        ends.append(min(beyond, s[last + 1] if last + 1 < len(s) else s[last]))
    return float(sum(ends) / 2)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    main(chosen)
