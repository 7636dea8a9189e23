# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A ball flattened by a plate, a plate indented by a ball
#
# This demo computes axisymmetric elasto-plastic contact far beyond first yield. It shows how to
#
# - compute with bodies of revolution, `kinematics="axisymmetric"`: the mesh is the half section,
#   `x[0]` is the radius $r$, `x[1]` the axis $z$, the hoop strain is $u_r / r$, and all integrals,
#   those of the mortar method too, have the weight $2 \pi r$,
# - make a meshed body rigid by Dirichlet conditions,
# - compare a whole load history with published fits.
#
# **Problem.** A ball of radius 20 mm and a plate are pressed on each other. One of them is rigid,
# the other elastic and perfectly plastic ($E$ = 200 GPa, $\nu$ = 0.3, uniaxial yield stress $S$ =
# 1000 MPa). There is no friction. Two cases:
#
# - `--case flattening` (default): a rigid plate is pressed on the ball, up to 50 times the
#   interference of first yield.
# - `--case indentation`: a rigid ball is pressed into the plate.
#
# The interference $w$ is the approach of the two bodies. With $E^* = E / (1 - \nu^2)$, first yield
# is at
#
# $$w_c = \left(\frac{\pi C S}{2 E^*}\right)^2 R, \qquad
#   P_c = \tfrac43 \frac{R^2}{E^{*2}} \left(\frac{\pi C S}{2}\right)^3, \qquad
#   C = 1.295\, e^{0.736 \nu}.$$
#
# Units: mm, MPa, N; forces are those of the whole bodies.
#
# **Result.** The picture shows force and contact area over the interference, both in units of first
# yield; contact pressure over the radius, in units of the yield stress; plastic strain; profile of
# the surface. The pressure changes from Hertz' ellipse to a plateau.
#
# **Compare with.** Flattening: Jackson and Green (2005) and Kogut and Etsion (2002) fitted force
# and contact radius to many such computations; the two fits differ by up to five per cent.
# Indentation: the mean pressure approaches the hardness, two to three yield stresses, and the
# surface piles up beside the ball.
#
# **Options to try.** `--case indentation` computes the other case. `--interference` is the largest
# $w / w_c$, `--steps` the number of steps to it, `--h` the element size at the axis.
# `--cell triangle` chooses triangles; with `--degree 1` they lock in plastic flow.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np
from flattening import YieldOfSphere, first_yield_sphere, jackson_green, kogut_etsion

import dolfinx_mortar as dm
from dolfinx import fem

RADIUS = 20.0  # mm, of the ball; the mesh is fine within 2.5 mm of the first contact point
E, NU, STRENGTH = 200e3, 0.3, 1000.0  # MPa, -, MPa
PLATE = {"flattening": (12.0, 1.2), "indentation": (80.0, 40.0)}  # mm, diameter and thickness
RIGID = {"flattening": 1, "indentation": 2}  # cell tag

parser = argparse.ArgumentParser(description="A ball flattened by a plate, or pressed into it.")
parser.add_argument("--case", choices=["flattening", "indentation"], default="flattening")
parser.add_argument("--interference", type=float, default=50.0, help="largest w over w_c")
parser.add_argument("--steps", type=int, default=40, help="number of load steps, small ones first")
parser.add_argument("--h", type=float, default=0.08, help="element size at the axis, in mm")
parser.add_argument("--cell", choices=["triangle", "quadrilateral"], default="quadrilateral")
parser.add_argument("--degree", type=int, choices=[1, 2], default=2, help="of the displacement")
parser.add_argument("--output", type=Path, default=Path("results/indentation"))


def main(options: argparse.Namespace) -> None:
    """Press, write the results and compare them with the fits."""
    comm = MPI.COMM_WORLD
    plate = PLATE[options.case]
    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        comm, kind="graded", h=options.h, radius=RADIUS, block=plate, cell=options.cell, half=True
    )

    # ## Bodies
    #
    # The plastic modulus is zero: there is no hardening. Triangles of first order lock in plastic
    # flow; use quadrilaterals or second order.

    V = fem.functionspace(mesh, ("Lagrange", options.degree, (2,)))
    u = fem.Function(V, name="displacement")
    soft = dm.VonMises.from_uniaxial(E, NU, yield_stress=STRENGTH, plastic_modulus=0.0)
    rigid = RIGID[options.case]
    laws = {3 - rigid: soft, rigid: dm.Elastic(E, NU)}
    solid = dm.Solid(u, laws, cell_tags, kinematics="axisymmetric")

    # ## Supports
    #
    # The displacement of all nodes of the rigid body is prescribed. The radial displacement on the
    # axis is zero.

    down, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    mesh.topology.create_connectivity(2, 2)
    moved = (2, cell_tags.find(2)) if rigid == 2 else (1, facet_tags.find(2))
    held = (2, cell_tags.find(1)) if rigid == 1 else (1, facet_tags.find(1))
    bcs = []
    for component, value, (dimension, entities) in (
        (0, zero, (1, facet_tags.find(5))),
        (0, zero, (2, cell_tags.find(rigid))),
        (1, zero, held),
        (1, down, moved),
    ):
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, dimension, entities)
        bcs.append(fem.dirichletbc(value, dofs, W))

    # ## Contact and load steps
    #
    # The deformable body is the slave: its nodes carry the contact pressures.

    slave, master = (4, 3) if rigid == 1 else (3, 4)
    contact = dm.Contact(facet_tags, slave=slave, master=master)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    at = first_yield_sphere(STRENGTH, RADIUS, E, NU)

    def press(w: float) -> None:
        down.value = -w * at.interference

    options.output.mkdir(parents=True, exist_ok=True)
    results = options.output / "indentation.xdmf"
    levels = options.interference * np.linspace(0.0, 1.0, options.steps + 1)[1:] ** 2
    levels = levels[levels >= 0.5 * min(1.0, options.interference)]  # elastic below
    steps, surfaces = [], []
    with dm.Writer(results, problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, levels, on_time=press):
            writer.write(step.time)
            surfaces.append(contact.gather(u))
            steps.append(measure(step, problem, surfaces[-1], at))
    dm.write_summary(options.output / "summary.json", problem, steps, options=vars(options))
    if comm.rank == 0:
        figures.draw(options.output, results, (options.case, at), steps, surfaces)
        show(options.case, steps)


# ## What is measured in a step


def measure(
    step: dm.LoadStep,
    problem: dm.ContactProblem,
    nodes: dict[str, np.ndarray],
    at: YieldOfSphere,
) -> dict:
    """Return force and radius beside the fits, in units of first yield, and pressures."""
    force, radius = abs(problem.interfaces[0].force[1]), edge(nodes)
    w = step.time * at.interference
    green, kogut = jackson_green(w, at), kogut_etsion(w, at)
    return dm.summarise(step) | {
        "interference": step.time,
        "force": force / at.force,
        "force_jackson_green": green.force / at.force,
        "force_kogut_etsion": kogut.force / at.force,
        "contact_radius": radius,
        "contact_radius_jackson_green": green.contact_radius,
        "contact_radius_kogut_etsion": kogut.contact_radius,
        "peak_pressure": nodes["pressure"].max() / STRENGTH,
        "mean_pressure": force / (np.pi * max(radius, 1e-300) ** 2) / STRENGTH,
        "plastic_volume": problem.solid.plastic_area(),
        "largest_plastic_strain": problem.solid.max("plastic_strain_norm"),
        "active_nodes": (nodes["active"] > 0).sum(),
    }


def edge(nodes: dict[str, np.ndarray]) -> float:
    """Return the contact radius: the zero of p^2, extrapolated from the last two loaded nodes.

    It is limited to the interval from the last loaded node to the next node.
    """
    r, p = nodes["x"][:, 0], nodes["pressure"]
    order = np.argsort(r)
    r, p = r[order], p[order]
    loaded = np.flatnonzero(p > 0.0)
    if len(loaded) < 2:
        return float(r[loaded].max(initial=0.0))
    last, before = loaded[-1], loaded[-2]
    slope = (p[last] ** 2 - p[before] ** 2) / (r[last] - r[before])
    beyond = r[last] - p[last] ** 2 / slope if slope < 0.0 else np.inf
    return float(min(beyond, r[min(last + 1, len(r) - 1)]))


def show(case: str, steps: list[dict]) -> None:
    """Print the table."""
    print("  w/w_c     P/P_c   J & G   K & E    a [mm]   J & G   p_mean/S   peak/S  iterations")
    for s in steps:
        print(
            f"{s['interference']:7.2f} {s['force']:9.3f}"
            f" {s['force'] / s['force_jackson_green'] - 1:+7.1%}"
            f" {s['force'] / s['force_kogut_etsion'] - 1:+7.1%}"
            f" {s['contact_radius']:9.3f}"
            f" {s['contact_radius'] / s['contact_radius_jackson_green'] - 1:+7.1%}"
            f" {s['mean_pressure']:10.2f} {s['peak_pressure']:8.2f} {s['newton_iterations']:8d}"
        )
    if case == "indentation":
        print("J & G and K & E are fits for the flattening of a ball")


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    if not 0.0 < chosen.interference < float("inf"):
        parser.error(f"--interference {chosen.interference}: a positive number")
    main(chosen)
