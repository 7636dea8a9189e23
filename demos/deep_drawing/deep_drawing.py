# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Deep drawing: a cup is drawn from a sheet
#
# A punch draws a disc of steel through a die, while a holder presses on its flange by a given
# force, so that it does not wrinkle. None of the tools has a mesh: the edges of punch and die are
# `dm.shapes.Wedge`, in an axisymmetric problem a rounded rim, and the holder is a plane that
# `load=` drives. The sheet hardens, $k_f = 200 + 150 (1 - e^{-10 \varphi}) + 250 \varphi$, at
# finite strain.
#
# The flange is drawn to a smaller radius, so it is compressed around the axis. At its rim nothing
# pulls: with that stress alone, and without a change of volume, the strains along the radius and
# through the thickness are half of that around the axis, so that the thickness grows like
# $t = t_0 \sqrt{R_0 / r}$ (Hill 1950, chapter XI). For the largest force there is the estimate of
# Siebel (Siebel and Beisswaenger 1955), when the outer diameter $D$ is 0.77 of the disc's, with
# the diameter $d$ of the wall's middle,
#
# $$F = \pi d t_0 \left[ 1.1\, e^{\mu \pi / 2} k_f \ln \frac Dd + e^{\mu \pi / 2}
#       \frac{2 \mu F_h}{\pi D t_0} + k_f' \frac{t_0}{2 r} \right],$$
#
# with the force $F_h$ of the holder, the radius $r$ of the die's edge, the mean yield stress $k_f$
# of the flange and that at the edge, $k_f'$: what the flange would take without friction and a
# tenth for the bending of it, the holder's friction on both sides, both by the rope around the
# edge, and the bending there.
#
# *Sources.* R. Hill, The Mathematical Theory of Plasticity (1950); E. Siebel, H. Beisswaenger,
# Tiefziehen (1955); M. Gruener, M. Merklein, Prod. Eng. 8 (2014) 577, who find friction by this
# formula. None of them was at hand: Hill's is derived above, Siebel's is from memory, its numbers
# 1.1 and 0.77 among it. Units: mm, MPa, N.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import dolfinx_mortar as dm
from dolfinx import fem, mesh

E, NU = 206_000.0, 0.3
RADIUS, THICKNESS = 40.0, 1.0  # mm, of the disc
PUNCH, DIE, EDGE = 25.0, 26.5, 6.0  # mm, radii of the tools and of their edges
HOLDER, FRICTION = 10_000.0, 0.1
TOP, BOTTOM = 1, 2  # facet tags

parser = argparse.ArgumentParser(description="A cup drawn from a disc, with a holder.")
parser.add_argument("--cells", type=int, default=32, help="along the radius")
parser.add_argument("--depth", type=float, default=14.4, help="of the punch, in mm")
parser.add_argument("--output", type=Path, default=Path("results/deep_drawing"))


def yield_stress(strain: float) -> float:
    """Return the yield stress after a plastic strain."""
    return 200.0 + 150.0 * (1.0 - np.exp(-10.0 * strain)) + 250.0 * strain


def sheet(cells: int) -> tuple[mesh.Mesh, mesh.MeshTags]:
    """Return the half section of the disc, two cells thick, and its sides."""
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [[0, 0], [RADIUS, THICKNESS]], [cells, 2], mesh.CellType.quadrilateral
    )
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda x, z=z: np.isclose(x[1], z))
        for z in (THICKNESS, 0.0)
    ]
    facets, tags = np.concatenate(sides), np.repeat([TOP, BOTTOM], [len(s) for s in sides])
    order = np.argsort(facets)
    return domain, mesh.meshtags(domain, 1, facets[order], tags[order].astype(np.int32))


def rim(corner: tuple[float, float], into: tuple[float, float]) -> dm.shapes.Wedge:
    """Return a right angle at a corner, rounded, of a tool that lies in a direction of it."""
    axis = np.array(into) / np.sqrt(2.0)
    tip = np.array(corner) + (np.sqrt(2.0) - 1.0) * EDGE * axis
    return dm.shapes.Wedge(tip, 45.0, axis, EDGE)


# ## The tools close, then the punch draws


def main(options: argparse.Namespace) -> None:
    """Draw the cup; write the summary and the picture, and compare with Siebel and Hill."""
    domain, facets = sheet(options.cells)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    s = np.sqrt(2.0 / 3.0)  # of uniaxial numbers in the Frobenius norm
    steel = dm.VonMisesVoce(E, NU, Y=s * 200.0, a=0.0, H=s * s * 250.0, Q=s * 150.0, b=s * 10.0)
    solid = dm.Solid(u, steel, kinematics="axisymmetric", strain="finite", volumetric="reduced")
    W = V.sub(0)
    axis = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.isclose(x[0], 0.0))[0]
    bcs = [fem.dirichletbc(fem.Constant(domain, 0.0), axis, W)]

    shapes = rim((PUNCH, THICKNESS), (-1, 1)), rim((DIE, 0.0), (1, -1))
    flat = dm.shapes.Plane((DIE, THICKNESS), (0.0, -1.0))
    punch, die, holder = (
        dm.Obstacle(facets, slave=side, shape=shape, friction=FRICTION)
        for side, shape in zip((TOP, BOTTOM, TOP), (*shapes, flat), strict=True)
    )
    problem = dm.ContactProblem(solid, [punch, die, holder], bcs=bcs, geometry="updated")

    # In the first step the holder stands still and is pressed on by the sheet; from then on its
    # force is given, and changes to the wanted one within two steps.

    times = np.arange(1.0, 1.0 + round(options.depth / 0.4))
    start = punch.position.value.copy()
    drawn = {punch.position: [(0.0, start), (times[-1], start - [0.0, 0.4 * times[-1]])]}
    list(dm.load_steps(problem, times[:1], ramp=drawn, progress=False))
    force = fem.Constant(domain, float(-holder.tool_force[1]))
    pressed = [(1.0, force.value.item()), (3.0, -HOLDER), (times[-1], -HOLDER)]
    holder.load = {"y": force}
    rows = []
    for step in dm.load_steps(problem, times[1:], ramp=drawn | {force: pressed}):
        rim_now, thickness = measure(u, holder, die)
        rows.append(
            dm.summarise(step)
            | {"depth": 0.4 * step.time, "force": float(punch.tool_force[1])}
            | {"holder": float(holder.tool_force[1]), "rim": rim_now, "thickness": thickness}
        )
    found = compare(rows)
    options.output.mkdir(parents=True, exist_ok=True)
    dm.write_summary(options.output / "summary.json", problem, rows, found=found)
    draw(options.output / "result.png", problem, rows, found)
    if domain.comm.rank == 0:
        for name, value in found.items():
            print(f"{name.replace('_', ' ')}: {value:.5g}")


# ## What comes out


def measure(u: fem.Function, upper: dm.Obstacle, lower: dm.Obstacle) -> tuple[float, float]:
    """Return radius and thickness at the rim."""
    ends = []
    for side in (upper, lower):
        nodes = side.gather(u)
        ends.append(nodes["x"][np.argmax(nodes["X"][:, 0])])
    return float(np.mean(ends, axis=0)[0]), float(np.linalg.norm(ends[0] - ends[1]))


def siebel() -> float:
    """Return the estimate of the largest force."""
    d, D = PUNCH + DIE, 0.77 * 2.0 * RADIUS
    outer = np.log(2.0 * RADIUS / D)
    inner = np.log(np.sqrt((2.0 * RADIUS) ** 2 - D**2 + d**2) / d)
    mean, rope = yield_stress(0.5 * (outer + inner)), np.exp(0.5 * np.pi * FRICTION)
    drawing = 1.1 * rope * mean * np.log(D / d)
    held = rope * 2.0 * FRICTION * HOLDER / (np.pi * D * THICKNESS)
    bending = yield_stress(inner) * THICKNESS / (2.0 * EDGE)
    return float(np.pi * d * THICKNESS * (drawing + held + bending))


def compare(rows: list[dict]) -> dict:
    """Return the largest force and the thickness of the rim beside the estimates."""
    flat = [row for row in rows if row["rim"] > DIE + EDGE]  # the rim is not yet on the edge
    largest = max(rows, key=lambda row: row["force"])
    return {
        "largest_force": largest["force"],
        "largest_force_siebel": siebel(),
        "depth_of_largest_force": largest["depth"],
        "rim": flat[-1]["rim"],
        "thickness_of_rim": flat[-1]["thickness"],
        "thickness_hill": float(THICKNESS * np.sqrt(RADIUS / flat[-1]["rim"])),
        "holder": flat[-1]["holder"],
    }


def draw(path: Path, problem: dm.ContactProblem, rows: list[dict], found: dict) -> None:
    """Draw force and section; collective."""
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    curve, section = figure.subplots(1, 2, width_ratios=(1.0, 1.6))
    curve.plot(*zip(*((r["depth"], 1e-3 * r["force"]) for r in rows), strict=True), color="#20609f")
    largest = 1e-3 * found["largest_force_siebel"]
    curve.axhline(largest, color="black", ls="--", lw=0.8, label="largest force, Siebel")
    curve.legend(frameon=False)
    curve.set(xlabel="depth [mm]", ylabel="force of the punch [kN]", ylim=(0.0, None))
    curve.grid(alpha=0.3)
    dm.plotting.field(problem, "von_mises", ax=section)
    section.set(xlabel="r [mm]", ylabel="z [mm]")
    if problem.comm.rank == 0:
        figure.savefig(path, dpi=110)


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.cells < 16:
        parser.error(f"--cells {chosen.cells}: at least 16")
    if not 1.6 <= chosen.depth <= 20.0:
        parser.error(f"--depth {chosen.depth}: from 1.6 to 20")
    main(chosen)
