# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A ball in its socket: gaps between facets and between smooth surfaces
#
# This demo is about closely fitting curved sides on coarse meshes, in 3D. It compares the two ways
# to measure the gap, `surface="facets"` and `surface="smooth"`, the default.
#
# **Problem.** A steel ball ($E$ = 200 GPa, $\nu$ = 0.3, elastic) of radius 9.9 mm is pressed by
# 0.05 mm into a socket of radius 10 mm, without friction. A quarter is meshed. Facets with edges of
# one millimetre deviate from such spheres by 0.01 to 0.03 mm, which is comparable with the
# approach. The gap between the facets is therefore far from the gap between the spheres, and force
# and pressure depend on the mesh. With `surface="smooth"` the weighted gap $g_j$ is corrected to
# that between smooth surfaces through the nodes,
#
# $$g_j - \int \Phi_j (h_s + h_m), \qquad
#   h = \tfrac12 \sum_{a<b} N_a N_b\, (n_b - n_a) \cdot (x_b - x_a).$$
#
# Here $\Phi_j$ is the dual function of slave node $j$, $h_s$ and $h_m$ are the heights of the
# smooth surfaces over the facets of the slave and of the master side, and $N_a$, $n_a$ and $x_a$
# are the shape functions, unit normals and positions of the nodes of a facet. The mortar matrices
# $D$ and $M$ do not change. Units: mm, MPa, N.
#
# **Result.** The picture shows the contact pressure on the ball, seen along its axis, for two
# meshes (rows) and both gaps (columns). With facets the pressure has isolated peaks, and the force
# changes from 200 to 32 kN between the two meshes. With smooth surfaces both meshes give 69.9 kN
# and nearly the same pressure.
#
# **Compare with.** A mesh of hexahedra with 120 000 unknowns gives 67.8 kN. On the four meshes of
# this demo, with either slave side, smooth surfaces give 68.7 to 69.9 kN, facets 32 to 200 kN.
#
# **Options to try.** `--meshes 1` solves on the first mesh only. `--surface smooth` leaves out the
# facets. `--cell hexahedron` meshes with hexahedra.

import argparse
from pathlib import Path

from mpi4py import MPI

from ball_in_socket import ball_in_socket
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

import dolfinx_mortar as dm
from dolfinx import fem

DEPTH = 0.05  # mm
SIZES = [(1.5, 1.0), (1.0, 1.5), (1.0, 0.7), (0.7, 1.0)]  # mm, of facets in the socket, on the ball
SIDES = {"socket": ("socket", "sphere"), "ball": ("sphere", "socket")}
SURFACES = ("facets", "smooth")
SHOWN = "ball"  # the slave side of the picture
TOP_OF_SCALE = 1600.0  # MPa, twice the peak pressure with smooth surfaces

parser = argparse.ArgumentParser(description="A ball in its socket: facets and smooth surfaces.")
parser.add_argument("--cell", choices=["tetrahedron", "hexahedron"], default="tetrahedron")
parser.add_argument("--surface", choices=SURFACES, nargs="+", default=list(SURFACES))
parser.add_argument("--meshes", type=int, default=len(SIZES), help="how many of the four meshes")
parser.add_argument("--output", type=Path, default=Path("results/ball_joint"))


def press(mesh: dm.meshing.TaggedMesh, slave: str, surface: str) -> dict:
    """Press the ball in; return the force on the whole ball and the nodes of the slave side."""
    V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,)))
    bcs = []
    for name, component, value in (
        ("bottom", 2, 0.0),
        ("flat", 2, -DEPTH),
        ("symmetry_x", 0, 0.0),
        ("symmetry_y", 1, 0.0),
    ):
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 2, mesh.facet_tags.find(name))
        bcs.append(fem.dirichletbc(fem.Constant(mesh.mesh, value), dofs, W))
    side, other = SIDES[slave]
    contact = dm.Contact(mesh.facet_tags, slave=side, master=other, surface=surface)
    solid = dm.Solid(fem.Function(V), dm.Elastic(E=200e3, nu=0.3))
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    report = dm.newton(problem)
    nodes = contact.gather(problem.u)
    force, peak = 4.0 * abs(contact.force[2]), nodes["pressure"].max()
    unknowns = 3 * V.dofmap.index_map.size_global
    return {"force": force, "peak": peak, "nodes": nodes, "unknowns": unknowns, "report": report}


# ## Table and picture


def main(options: argparse.Namespace) -> None:
    """Solve on all meshes with either slave side; print a table, draw the first two meshes."""
    found = {}
    for h in SIZES[: options.meshes]:
        mesh = ball_in_socket(MPI.COMM_WORLD, cell=options.cell, h=h)
        for surface in options.surface:
            for slave in SIDES:
                one = found[h, slave, surface] = press(mesh, slave, surface)
                if MPI.COMM_WORLD.rank == 0:
                    print(
                        f"h = {h[0]}, {h[1]}, {one['unknowns']} unknowns, slave {slave}, {surface}:"
                        f" {one['force']:.0f} N, {one['peak']:.0f} MPa,"
                        f" {one['report'].newton_iterations} iterations",
                        flush=True,
                    )
    if MPI.COMM_WORLD.rank == 0:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(found, options).savefig(options.output / "pressure.png", dpi=100)


def draw(found: dict, options: argparse.Namespace) -> Figure:
    """Draw the pressure on the ball along its axis: one row per mesh, one column per surface."""
    rows, columns = SIZES[: min(2, options.meshes)], options.surface
    shape = (len(rows), len(columns))
    figure = Figure(figsize=(3.1 * shape[1] + 1.0, 2.9 * shape[0]), layout="constrained")
    axes = figure.subplots(*shape, squeeze=False, sharex=True, sharey=True)
    for ax, (h, surface) in zip(axes.flat, ((h, s) for h in rows for s in columns), strict=True):
        one = found[h, SHOWN, surface]
        x, p = one["nodes"]["X"][:, :2], one["nodes"]["pressure"]
        low = one["nodes"]["X"][:, 2] < -5.0  # further up there is no contact
        drawn = ax.tripcolor(
            Triangulation(*x[low].T), p[low], shading="gouraud", vmin=0.0, vmax=TOP_OF_SCALE
        )
        ax.plot(*x[low].T, ".", color="white", ms=1.5)
        ax.set_title(f"{surface}: {one['force'] / 1e3:.1f} kN, {one['peak']:.0f} MPa", fontsize=10)
        ax.set(aspect="equal", xlim=(0.0, 7.5), ylim=(0.0, 7.5))
    for ax, h in zip(axes[:, 0], rows, strict=True):
        ax.set_ylabel(f"socket {h[0]} mm, ball {h[1]} mm\ny [mm]")
    for ax in axes[-1]:
        ax.set_xlabel("x [mm]")
    figure.colorbar(drawn, ax=axes, label="pressure [MPa]", extend="max", shrink=0.8)
    return figure


if __name__ == "__main__":
    chosen = parser.parse_args()
    if not 1 <= chosen.meshes <= len(SIZES):
        parser.error(f"--meshes {chosen.meshes}: 1 to {len(SIZES)}")
    main(chosen)
