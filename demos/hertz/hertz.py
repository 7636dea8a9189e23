# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A half disc pressed into a block, both elasto-plastic
#
# This demo computes the benchmark of Cermak, Svetlik, Varga and Pospisil (2024). It shows how to
#
# - describe two elasto-plastic bodies by one displacement and one law per cell tag,
# - impose unilateral contact on non-matching meshes with the dual mortar method,
# - apply the load in steps, write every step for ParaView, and compare every step with Hertz.
#
# **Problem.** A half disc of radius 8 mm touches the block $[-15, 15] \times [-10, 0]$ mm at the
# origin, in plane strain. Both are of steel: $E$ = 206.9 GPa, $\nu$ = 0.29, uniaxial yield stress
# 450 MPa, linear kinematic hardening. The block is clamped at the bottom; the flat face of the disc
# is moved down by $d$ = 0.2 mm. Every step minimises the energy under the equalities of the
# supports and the inequalities of contact,
#
# $$\min_v \Psi(v) - f \cdot v \quad\text{subject to}\quad B_E v = c_E,\; B_I v \le c_I,$$
#
# with $B_I = N^T (D - M)$: the mortar matrices $D$ and $M$ give the relative displacement of the
# two sides, $N$ contains the normals, and $c_I$ is the initial weighted gap. Units: mm, MPa, N per
# mm.
#
# **Result.** The program draws figures 2 to 7 of the paper (mesh, hardening, stresses), the
# deformed mesh, and the contact pressure beside Hertz' elastic solution for the same force. Where
# the bodies flow, the peak pressure stays below that of Hertz.
#
# **Compare with.** Hertz' formulas hold while both bodies are elastic. Two independent finite
# element codes find a force of 2425.5 N/mm at `--material elastic --displacement 0.05`.
#
# **Options to try.** `--mesh graded` refines the mesh towards the contact, to the element size
# `--h`. `--degree 2` removes the locking of linear triangles in plastic flow. `--slave disc`
# exchanges slave and master side; results should hardly depend on it. `--geometry reference` keeps
# normals and segments of the undeformed bodies; `--surface facets` measures the gap between the
# facets, as the paper does.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

RADIUS = 8.0  # mm
NOTHING = 1e-300  # N/mm, in place of a force of zero, for which Hertz' formulas divide by zero

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
    # One mesh holds both bodies as two disconnected parts. Cell tags name the bodies (block, disc).
    # Facet tags name the supports (bottom of the block, flat face of the disc) and the two sides of
    # the interface (top of the block, arc of the disc).

    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        comm, kind=options.mesh, h=options.h, cell=options.cell
    )

    # ## Bodies
    #
    # Von Mises plasticity with linear kinematic hardening,
    #
    # $$|\mathrm{dev}\,\sigma - a \varepsilon_p| \le Y,$$
    #
    # in the Frobenius norm, so that $Y = \sqrt{2/3} \cdot 450$ MPa. The law is an incremental
    # potential; stress and consistent tangent are its derivatives. Linear triangles lock in plastic
    # flow; quadratic ones need a quarter of the elements for the same force.

    steel = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0)
    if options.material == "elastic":
        steel = dm.Elastic(E=steel.E, nu=steel.nu)
    V = fem.functionspace(mesh, ("Lagrange", options.degree, (2,)))
    u = fem.Function(V, name="displacement")
    solid = dm.Solid(u, {"block": steel, "disc": steel}, cell_tags)

    # ## Supports and contact
    #
    # The slave side carries the Lagrange multipliers, which are the contact pressures at its nodes.
    # Either side may be the slave. The gap is measured between smooth surfaces through the nodes,
    # or between the facets, as in the paper.

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
    # The load level is the displacement $d$. The table `ramp` gives the value of `push` at some
    # levels and is linear between them. Every step is solved by the semi-smooth Newton method, with
    # a bound-constrained quadratic program in every iteration. A step that fails is halved. The
    # results of finished steps are in the file in any case.

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
    # Figures 2 to 7 of the paper, and the contact pressure beside that of Hertz.

    if comm.rank == 0:
        print(step.report)
        figures.draw(options.output, results, steps[-1], (x, nodes["pressure"]))
        line = "{force:.1f} N/mm, peak pressure {peak_pressure:.0f} MPa, results in"
        print(line.format(**steps[-1]), options.output)


# ## What is measured in a step
#
# The last node in contact gives the half-width $b$ to one element only. A least-squares fit of
# Hertz' semi-ellipse, $p^2 = p_0^2 (1 - x^2/b^2)$, to the nodal pressures is much more accurate.
# Here $x$ is the current position if the geometry is updated, and the reference position if it is
# frozen.


def measure(
    step: dm.LoadStep,
    problem: dm.ContactProblem,
    steel: dm.VonMises | dm.Elastic,
    x: np.ndarray,
    nodes: dict[str, np.ndarray],
) -> dict:
    """Return cost, force, pressures beside those of Hertz, and largest stress and strain."""
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
    """Return half the distance of the two points where p^2, extrapolated linearly, is zero.

    At each end the line goes through the last two loaded nodes. Its zero is limited to the interval
    from the last loaded node to the next node.
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
