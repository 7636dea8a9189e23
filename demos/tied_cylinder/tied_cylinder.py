# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A tube of two tied rings, up to its limit load
#
# This demo computes mesh tying with plastic flow, in plane strain. It shows how to
#
# - tie two bodies on non-matching meshes, `dm.Tie`,
# - avoid volumetric locking in plastic flow, `volumetric="reduced"`,
# - compute the internal pressure from the nodal forces at the bore.
#
# **Problem.** A tube with radii $R_i$ = 1 mm and $R_e$ = 1.3 mm is under internal pressure. It is
# of an elastic, perfectly plastic metal ($E$ = 70 GPa, $\nu$ = 0.3, uniaxial yield stress
# $\sigma_0$ = 250 MPa). The tube is solved as one body, and as two rings that are tied at a radius
# of 1.15 mm by the dual mortar method. A quarter of the section is meshed. Units: mm, MPa, N per
# mm.
#
# **Result.** The picture shows the pressure of both tubes over the growth of the bore, with the
# limit load, and the plastic strain of the tied rings.
#
# **Compare with.** When the whole section flows, the pressure has reached the limit load, whatever
# the growth of the bore,
#
# $$q = \frac{2}{\sqrt 3}\, \sigma_0 \ln \frac{R_e}{R_i},$$
#
# here 75.738 MPa. The tied rings must have the pressures of the single body in every step.
#
# **Options to try.** `--slave inner` exchanges slave and master side. `--cells` refines the mesh.
# `--volumetric full` integrates the volume change at the quadrature points instead of taking its
# mean over each cell: linear quadrilaterals usually lock then in plastic flow. This flow is so
# simple that the pressure differs by 0.03 % only. `--cell triangle` requires `--volumetric full`.

import argparse
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from ring_section import ring_section

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.common import compat

BORE, OUTSIDE = 1.0, 1.3  # mm
BETWEEN = 1.15  # mm, where the rings meet
YIELD = 250.0  # MPa, in tension
LIMIT = 2.0 / np.sqrt(3.0) * YIELD * np.log(OUTSIDE / BORE)  # MPa, 75.738
SIDES = {"inner": ("around_inner", "within_outer"), "outer": ("within_outer", "around_inner")}

parser = argparse.ArgumentParser(description="A tube of two tied rings, up to its limit load.")
parser.add_argument("--cells", type=int, default=6, help="across the inner ring")
parser.add_argument("--cell", choices=["quadrilateral", "triangle"], default="quadrilateral")
parser.add_argument("--volumetric", choices=["reduced", "full"], default="reduced")
parser.add_argument("--slave", choices=["inner", "outer"], default="outer")
parser.add_argument("--growth", type=float, default=0.012, help="of the bore's radius, in mm")
parser.add_argument("--steps", type=int, default=12, help="number of equal load steps")
parser.add_argument("--output", type=Path, default=Path("results/tied_cylinder"))


def widen(tied: bool, options: argparse.Namespace) -> tuple[dm.Solid, list[dict]]:
    """Widen the bore of the tube in steps; return its bodies and what is measured in each step."""
    # ## Mesh
    #
    # A quarter of the section: one ring, or two rings whose cells do not match at their common
    # radius.

    n = options.cells
    mesh, _, facet_tags = ring_section(
        MPI.COMM_WORLD,
        radii=(BORE, BETWEEN, OUTSIDE) if tied else (BORE, OUTSIDE),
        cells=((n, 6 * n), (n + 2, 8 * n)) if tied else ((2 * n, 8 * n),),
        cell=options.cell,
    )

    # ## Body
    #
    # Von Mises plasticity without hardening.

    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    steel = dm.VonMises.from_uniaxial(70e3, 0.3, yield_stress=YIELD, plastic_modulus=0.0)
    solid = dm.Solid(u, steel, volumetric=options.volumetric)

    # ## Supports and tie
    #
    # Symmetry on both cuts. The displacement of the bore is prescribed instead of the pressure, so
    # that the steps can go on at the limit load: its nodes are displaced by $d\, e_r$.

    radial, push = fem.Function(V), fem.Function(V)
    radial.interpolate(lambda x: x[:2] / np.hypot(x[0], x[1]))
    bore = fem.locate_dofs_topological(V, 1, facet_tags.find("bore"))
    bcs = [fem.dirichletbc(push, bore)]
    for component, cut in ((0, "on_y"), (1, "on_x")):
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 1, facet_tags.find(cut))
        bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, W))
    slave, master = SIDES[options.slave]
    ties = [dm.Tie(facet_tags, slave=slave, master=master)] if tied else []
    problem = dm.ContactProblem(solid, ties, bcs=bcs)

    # ## Load steps
    #
    # The internal pressure is the one that does the same work on the displacement $e_r$ as the
    # nodal forces at the bore.

    ds, n_out = ufl.Measure("ds", mesh, subdomain_data=facet_tags), ufl.FacetNormal(mesh)
    bore_side = ds(facet_tags.tag("bore"))
    virtual = mesh.comm.allreduce(
        fem.assemble_scalar(fem.form(-ufl.dot(n_out, radial) * bore_side))
    )
    owned = 2 * V.dofmap.index_map.size_local
    at_bore = (2 * bore[:, None] + np.arange(2)).ravel()
    at_bore = at_bore[at_bore < owned]
    levels = np.linspace(0.0, options.growth, options.steps + 1)[1:]
    rows, forces = [], problem.vector()
    for step in dm.load_steps(
        problem, levels, on_time=lambda d: np.multiply(d, radial.x.array, out=push.x.array)
    ):
        solid.assemble_residual(forces)
        work = mesh.comm.allreduce(forces.array_r[at_bore] @ radial.x.array[at_bore])
        row = {"tied": tied, "growth": step.time, "pressure": work / virtual}
        rows.append(dm.summarise(step) | row)
    name = "tied" if tied else "monolithic"
    dm.write_summary(
        options.output / f"{name}.json", problem, rows, limit=LIMIT, options=vars(options)
    )
    return solid, rows


def main(options: argparse.Namespace) -> None:
    """Widen both tubes, compare them with each other and with the limit load, draw them."""
    comm = MPI.COMM_WORLD
    options.output.mkdir(parents=True, exist_ok=True)
    _, one = widen(False, options)
    solid, two = widen(True, options)
    cells = gather_cells(solid)
    if comm.rank == 0:
        draw(options.output / "limit.png", one, two, cells)
        p, q = (rows[-1]["pressure"] for rows in (one, two))
        print(f"limit {LIMIT:.3f} MPa, one piece {p:.3f} MPa, two rings {q:.3f} MPa")
        print(f"results in {options.output}")


# ## Picture
#
# The pressure over the growth of the bore, and the plastic strain of the tied rings.


def gather_cells(solid: dm.Solid) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (m, k, 2) and plastic strains (m,) of the cells of all ranks, on rank 0."""
    mesh = solid.mesh
    owned = mesh.topology.index_map(2).size_local
    corners = mesh.geometry.x[compat.cell_nodes(mesh)[:owned], :2]
    if corners.shape[1] == 4:
        corners = corners[:, [0, 1, 3, 2]]
    strain = solid.cell_values("plastic_strain_norm").x.array[:owned]
    parts = mesh.comm.gather((corners, strain))
    if parts is None:
        return corners, strain
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def draw(
    path: Path, one: list[dict], two: list[dict], cells: tuple[np.ndarray, np.ndarray]
) -> None:
    """Draw the pressures of both tubes, and the plastic strain of the tied one."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for rows, style, label in ((one, "-", "one piece"), (two, "o", "two rings, tied")):
        growth, pressure = ([row[name] for row in rows] for name in ("growth", "pressure"))
        left.plot([0.0, *growth], [0.0, *pressure], style, label=label, markersize=4)
    left.axhline(LIMIT, color="black", linestyle="--", linewidth=0.8, label="limit load")
    left.set(xlabel="growth of the bore [mm]", ylabel="pressure [MPa]", ylim=(0.0, None))
    left.legend(loc="lower right", frameon=False)
    shown = PolyCollection(cells[0], array=1e3 * cells[1], edgecolor="white", linewidth=0.2)
    right.add_collection(shown)
    right.set(xlim=(0.0, 1.02 * OUTSIDE), ylim=(0.0, 1.02 * OUTSIDE), aspect="equal")
    right.axis("off")
    figure.colorbar(shown, ax=right, label="plastic strain, Frobenius norm, per mille", shrink=0.8)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    chosen = parser.parse_args()
    if chosen.steps < 1 or chosen.cells < 1:
        parser.error(f"--steps {chosen.steps}, --cells {chosen.cells}: at least 1 each")
    main(chosen)
