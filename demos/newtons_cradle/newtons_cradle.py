# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Newton's cradle of elastic rods
#
# This demo computes impacts of elastic bodies, with waves. It shows how to
#
# - compute a motion with contact: `dm.Inertia` with initial velocities, and `dm.time_steps`,
# - check the balance of energies in the ledger of every step,
# - compare velocities and contact forces with Saint-Venant's solution.
#
# **Problem.** Three rods of steel ($E$ = 206.9 GPa, $\rho$ = 7850 kg/m³), each 100 mm long, 5 mm
# high and 1 mm thick, lie in a row with gaps of 0.02 mm. The first one moves with $v$ = 1 m/s and
# hits the second one, which hits the third one. Displacements are along the rods only, so that the
# waves are one-dimensional. Units: mm, MPa, N, s, tonnes; energies in mJ.
#
# **Result.** The picture shows mean velocities of the rods, contact forces, and kinetic and stored
# energy over time. The last rod leaves with the velocity of the first one.
#
# **Compare with.** Saint-Venant (1867): from the contact a wave runs into both rods with the speed
# $c = \sqrt{E / \rho}$. Between two equal rods the force is
#
# $$F = \tfrac12 \sqrt{E \rho}\, v A.$$
#
# The waves are reflected at the free ends. After the time $2 L / c$ the rod that has hit is at rest
# and without strain, the rod that was hit has the velocity $v$, and they separate. Thus the last
# rod leaves with the velocity $v$ and all of the energy.
#
# In a time integration this is a test of what contact does to the energy. A node with mass that
# hits another body stops or bounces at once, and standard schemes gain or lose energy in every
# impact. Here the contact nodes have no mass, and the work of the contact forces in a step is
# returned, so that the energies balance to round-off. The vibrations that remain in the rods are
# those of the sharp wave front that the mesh does not resolve.
#
# **Options to try.** `--cells` is the number of cells along each rod, `--courant` the length of the
# time steps as $c\, \Delta t / h$.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh

E, DENSITY = 206_900.0, 7.85e-9  # MPa, tonnes per mm^3
LENGTH, HEIGHT = 100.0, 5.0  # mm, of each rod; they are one mm thick
SPEED, GAP = 1000.0, 0.02  # mm/s, mm
WAVE = (E / DENSITY) ** 0.5
RODS = (1, 2, 3)  # cell tags
LEFT, RIGHT = 10, 20  # facet tags of the ends, plus that of the rod

parser = argparse.ArgumentParser(description="Newton's cradle of three rods.")
parser.add_argument("--cells", type=int, default=60, help="along each rod")
parser.add_argument("--courant", type=float, default=0.7, help="c dt / h")
parser.add_argument("--output", type=Path, default=Path("results/newtons_cradle"))


# ## Three rods in a row


def rods(cells: int) -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """Return a mesh of the rods with tags of cells and of ends; it is created on rank 0."""
    comm = MPI.COMM_WORLD
    points, quads = np.zeros((0, 2)), np.zeros((0, 4), dtype=np.int64)
    if comm.rank == 0:
        x = np.linspace(0.0, LENGTH, cells + 1)
        for k in range(len(RODS)):
            start = k * (LENGTH + GAP)
            rod = np.column_stack([np.repeat(start + x, 2), np.tile([0.0, HEIGHT], cells + 1)])
            first = len(points) + 2 * np.arange(cells)
            points = np.vstack([points, rod])
            quads = np.vstack([quads, first[:, None] + [0, 1, 2, 3]])
    element = mesh.create_unit_square(
        MPI.COMM_SELF, 1, 1, cell_type=mesh.CellType.quadrilateral
    ).ufl_domain()
    domain = mesh.create_mesh(comm, quads, e=element, x=points)
    domain.topology.create_connectivity(1, 2)
    own = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    middle = mesh.compute_midpoints(domain, 2, own)[:, 0]
    of_rod = 1 + (middle / (LENGTH + GAP)).astype(np.int32)
    ends: list[tuple[np.ndarray, int]] = []
    for k, rod in enumerate(RODS):
        start = k * (LENGTH + GAP)
        for x, tag in ((start, LEFT), (start + LENGTH, RIGHT)):
            found = mesh.locate_entities_boundary(
                domain, 1, lambda p, x=x: np.isclose(p[0], x, atol=0.1 * GAP)
            )
            ends.append((found, tag + rod))
    facets = np.concatenate([found for found, _ in ends])
    values = np.concatenate([np.full(len(found), tag, np.int32) for found, tag in ends])
    order = np.argsort(facets)
    return (
        domain,
        mesh.meshtags(domain, 2, own, of_rod),
        mesh.meshtags(domain, 1, facets[order], values[order]),
    )


# ## From the first contact to the last separation


def main(options: argparse.Namespace) -> None:
    """Compute the impacts; write the summary and the picture, and compare with Saint-Venant."""
    domain, cells, facets = rods(options.cells)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    solid = dm.Solid(fem.Function(V, name="displacement"), dm.Elastic(E=E, nu=0.0), cells)
    W = V.sub(1)
    dofs = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.full(x.shape[1], True))
    bcs = [fem.dirichletbc(fem.Constant(domain, 0.0), dofs[0], W)]  # waves along the rods only
    contacts = [dm.Contact(facets, slave=RIGHT + k, master=LEFT + k + 1) for k in RODS[:-1]]

    velocity = dict.fromkeys(RODS, (0.0, 0.0)) | {1: (SPEED, 0.0)}
    inertia = dm.Inertia(solid, DENSITY, cells, velocity=velocity)
    problem = dm.ContactProblem(solid, contacts, bcs=bcs, terms=[inertia])

    of_rods = [fem.form(momentum(inertia, cells, rod)) for rod in RODS]
    dt = options.courant * LENGTH / options.cells / WAVE
    end = 3.2 * GAP / SPEED + 2 * 2.0 * LENGTH / WAVE
    rows = []
    for step in dm.time_steps(problem, dt * np.arange(1, int(end / dt)), progress=False):
        momenta = [domain.comm.allreduce(fem.assemble_scalar(form)) for form in of_rods]
        rows.append(
            dm.summarise(step)
            | {"velocities": [m / (DENSITY * LENGTH * HEIGHT) for m in momenta]}
            | {"pushes": [-float(contact.force[0]) for contact in contacts]}
        )
    found = compare(rows, dt)
    options.output.mkdir(parents=True, exist_ok=True)
    dm.write_summary(options.output / "summary.json", problem, rows, found=found)
    if domain.comm.rank == 0:
        figures.draw(options.output / "result.png", rows, found)
        for name, value in found.items():
            print(f"{name.replace('_', ' ')}: {value:.6g}")


def momentum(inertia: dm.Inertia, cells: mesh.MeshTags, rod: int) -> ufl.Form:
    """Return the momentum of a rod along it, as a form."""
    domain = inertia.velocity.function_space.mesh
    dx = ufl.Measure("dx", domain, subdomain_data=cells)
    return DENSITY * inertia.velocity[0] * dx(rod)


def compare(rows: list[dict], dt: float) -> dict:
    """Return velocities, force, time of contact and energy beside those of Saint-Venant."""
    pushes = np.array([row["pushes"] for row in rows])
    first = pushes[:, 0]
    plateau = first[first > 0.5 * first.max()]
    energies = np.array([row["ledger"]["defect"] for row in rows])
    return {
        "velocity_of_the_first": rows[-1]["velocities"][0] / SPEED,
        "velocity_of_the_second": rows[-1]["velocities"][1] / SPEED,
        "velocity_of_the_last": rows[-1]["velocities"][2] / SPEED,
        "force": float(np.median(plateau)),
        "force_saint_venant": 0.5 * (E * DENSITY) ** 0.5 * SPEED * HEIGHT,
        "time_of_contact": float(len(plateau) * dt),
        "time_of_contact_saint_venant": 2.0 * LENGTH / WAVE,
        "largest_defect_of_energy": float(np.abs(energies).max()),
        "left_as_vibrations": rows[-1]["ledger"]["stored"] / rows[-1]["ledger"]["initial"],
    }


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.cells < 8:
        parser.error(f"--cells {chosen.cells}: at least 8")
    if not 0.0 < chosen.courant < float("inf"):
        parser.error(f"--courant {chosen.courant}: a positive number")
    main(chosen)
