# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A half ball pressed into a block, both elasto-plastic
#
# This demo is the Hertz demo in three dimensions. It shows how to
#
# - model a quarter of two bodies with symmetry planes that cut through the contact,
# - solve contact in 3D with the default linear solver, conjugate gradients with algebraic
#   multigrid,
# - compare the result with Hertz' point contact, and draw the contact pressure as a map.
#
# **Problem.** A half ball of radius 8 mm touches the block $[-15, 15]^2 \times [-10, 0]$ mm at the
# origin. Both are of steel: $E$ = 206.9 GPa, $\nu$ = 0.29, uniaxial yield stress 450 MPa, linear
# kinematic hardening. The block is clamped at the bottom; the flat face of the ball is moved down
# by $d$ = 0.2 mm. A quarter of both bodies is meshed. Every step minimises the energy under the
# equalities of the supports and the inequalities of contact,
#
# $$\min_v \Psi(v) - f \cdot v \quad\text{subject to}\quad B_E v = c_E,\; B_I v \le c_I,$$
#
# with $B_I = N^T (D - M)$: the mortar matrices $D$ and $M$ give the relative displacement of the
# two sides, $N$ contains the normals, and $c_I$ is the initial weighted gap. Units: mm, MPa, N.
#
# **Result.** The pictures show the bodies in perspective with the von Mises stress, and the contact
# pressure twice: as a map with Hertz' circle, and along the radius beside Hertz' elastic solution
# for the same force.
#
# **Compare with.** Hertz' formulas hold while both bodies are elastic. At
# `--material elastic --displacement 0.05` an axisymmetric computation finds a force of 5036 N on
# the whole ball.
#
# **Options to try.** `--h` is the element size at the contact. `--cell tetrahedron` and
# `--degree 2` choose other elements. `--slave ball` exchanges slave and master side; results should
# hardly depend on it. `--geometry reference` keeps normals and segments of the undeformed bodies;
# `--surface facets` measures the gap between the facets.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

RADIUS = 8.0  # mm
NOTHING = 1e-300  # N, in place of a force of zero, for which Hertz' formulas divide by zero

parser = argparse.ArgumentParser(
    description="A half ball pressed into a block, both elasto-plastic."
)
parser.add_argument("--displacement", type=float, default=0.2, help="of the flat face, in mm")
parser.add_argument("--steps", type=int, default=1, help="number of equal load steps")
parser.add_argument("--material", choices=["plastic", "elastic"], default="plastic")
parser.add_argument("--cell", choices=["tetrahedron", "hexahedron"], default="hexahedron")
parser.add_argument("--degree", type=int, choices=[1, 2], default=1, help="of the displacement")
parser.add_argument("--slave", choices=["block", "ball"], default="block")
parser.add_argument("--h", type=float, default=0.125, help="element size at the contact, in mm")
parser.add_argument("--geometry", choices=["reference", "updated"], default="updated")
parser.add_argument("--surface", choices=["smooth", "facets"], default="smooth")
parser.add_argument("--qp", default="active-set", help="active-set or interior-point")
parser.add_argument("--rtol", type=float, default=1e-6, help="tolerance of Newton's method")
parser.add_argument("--output", type=Path, default=Path("results/sphere"))


def main(options: argparse.Namespace) -> None:
    """Solve the problem, write its results."""
    comm = MPI.COMM_WORLD

    # ## Mesh
    #
    # A quarter of both bodies in one mesh, graded towards the contact, as two disconnected parts.
    # The bodies are named block and ball. Their sides are bottom and top of the block, flat and
    # sphere of the ball, and symmetry_x and symmetry_y in the planes $x = 0$ and $y = 0$.

    mesh, cell_tags, facet_tags = dm.meshing.sphere(
        comm, cell=options.cell, h=options.h, radius=RADIUS
    )

    # ## Bodies
    #
    # Von Mises plasticity with linear kinematic hardening; the uniaxial yield stress is 450 MPa.

    steel = dm.VonMises(E=206_900.0, nu=0.29, Y=450.0 * np.sqrt(2.0 / 3.0), a=10_000.0)
    if options.material == "elastic":
        steel = dm.Elastic(E=steel.E, nu=steel.nu)
    V = fem.functionspace(mesh, ("Lagrange", options.degree, (3,)))
    u = fem.Function(V, name="displacement")
    solid = dm.Solid(u, {"block": steel, "ball": steel}, cell_tags)

    # ## Supports and contact
    #
    # The slave side carries the Lagrange multipliers, which are the contact pressures at its nodes.
    # Either side may be the slave. The gap is measured between smooth surfaces through the nodes,
    # or between the facets, as in the paper.

    push = fem.Constant(mesh, 0.0)
    bcs = supports(V, facet_tags, push)
    slave, master = ("top", "sphere") if options.slave == "block" else ("sphere", "top")
    contact = dm.Contact(facet_tags, slave=slave, master=master, surface=options.surface)
    problem = dm.ContactProblem(
        solid, [contact], bcs=bcs, geometry=options.geometry, petsc_options_prefix="sphere_"
    )

    # ## Load steps
    #
    # The linear systems are solved by conjugate gradients with algebraic multigrid. The argument
    # `petsc_options` of `ContactProblem` chooses another solver, for example
    # `petsc_options={"pc_type": "cholesky"}`.

    options.output.mkdir(parents=True, exist_ok=True)
    levels = np.linspace(0.0, options.displacement, options.steps + 1)[1:]
    ramp = {push: [(0.0, 0.0), (levels[-1], -levels[-1])]}  # (level, value)
    steps = []
    with dm.Writer(options.output / "sphere.xdmf", problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, levels, ramp=ramp, qp=options.qp, rtol=options.rtol):
            writer.write(step.time)
            nodes = contact.gather(u)
            x = nodes["X" if options.geometry == "reference" else "x"][:, :2]
            steps.append(measure(step, problem, steel, x, nodes))
    more = {"slave_nodes": len(x), "options": vars(options)}
    dm.write_summary(options.output / "summary.json", problem, steps, **more)

    # ## Pictures
    #
    # The bodies in perspective, and the contact pressure as a map and along the radius.

    figures.draw(options.output, problem, cell_tags, steps[-1], (x, nodes["pressure"]))
    if comm.rank == 0:
        print(step.report)
        line = "{force:.1f} N, peak pressure {peak_pressure:.0f} MPa, results in"
        print(line.format(**steps[-1]), options.output)


# ## Supports
#
# In a symmetry plane only the normal component of the displacement is prescribed. Slave nodes in
# the plane keep their contact constraint; their normals are projected into the plane.


def supports(
    V: fem.FunctionSpace, facet_tags: dm.Tags, push: fem.Constant
) -> list[fem.DirichletBC]:
    """Clamp the bottom, push the flat face, hold the symmetry planes."""
    zero = fem.Constant(V.mesh, 0.0)
    prescribed = [("bottom", 0, zero), ("bottom", 1, zero), ("bottom", 2, zero)]
    prescribed += [("flat", 0, zero), ("flat", 1, zero), ("flat", 2, push)]
    prescribed += [("symmetry_x", 0, zero), ("symmetry_y", 1, zero)]
    bcs = []
    for side, component, value in prescribed:
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 2, facet_tags.find(side))
        bcs.append(fem.dirichletbc(value, dofs, W))
    return bcs


# ## What is measured in a step
#
# Forces are those of the whole ball, four times those of the quarter. Contact radius and peak
# pressure come from a least-squares fit of Hertz' semi-ellipsoid, $p^2 = p_0^2 (1 - r^2/a^2)$, to
# the nodal pressures, because the last node in contact gives the radius to one element only.


def measure(
    step: dm.LoadStep,
    problem: dm.ContactProblem,
    steel: dm.VonMises | dm.Elastic,
    x: np.ndarray,
    nodes: dict[str, np.ndarray],
) -> dict:
    """Return cost, force, pressures beside those of Hertz, and largest stress and strain."""
    r, p, active = np.hypot(*x.T), nodes["pressure"], nodes["active"] > 0
    solid, contact = problem.solid, problem.interfaces[0]
    force = 4.0 * abs(contact.force[2])
    peak, radius = dm.analytic.fit_pressure(r[active], p[active])
    hertz = dm.analytic.hertz_point(max(force, NOTHING), RADIUS, *(steel.E, steel.nu) * 2)
    return dm.summarise(step) | {
        "displacement": step.time,
        "force": force,
        "peak_pressure": p.max(),
        "peak_pressure_fit": peak,
        "peak_pressure_hertz": hertz.peak_pressure,
        "contact_radius_last_node": r[active].max(initial=0.0),
        "contact_radius_fit": radius,
        "contact_radius_hertz": hertz.contact_radius,
        "max_von_mises": solid.max("von_mises"),
        "max_plastic_strain": solid.max("plastic_strain_norm"),
        "max_back_stress": solid.max("back_stress_norm"),
        "plastic_volume": 4.0 * solid.plastic_area(),
        "active_nodes": active.sum(),
    }


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    main(chosen)
