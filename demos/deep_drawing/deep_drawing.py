# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Deep drawing of a cup
#
# This demo computes sheet metal forming with rigid tools, axisymmetric and at finite strain. It
# shows how to
#
# - describe rigid tools without a mesh: the edges of punch and die as `dm.shapes.Wedge`, in an
#   axisymmetric problem a rounded rim, and the blank holder as a `dm.shapes.Plane`,
# - drive one tool by its position and another one by its force, `load=`,
# - use a saturating hardening law at finite strain.
#
# **Problem.** A punch of radius 25 mm draws a disc of steel, of radius 40 mm and 1 mm thick, by
# 14.4 mm into a die of radius 26.5 mm. A blank holder presses on the flange with 10 kN, so that it
# does not wrinkle. The edges of punch and die have a radius of 6 mm. The coefficient of friction is
# 0.1. The yield stress of the sheet is $k_f = 200 + 150 (1 - e^{-10 \varphi}) + 250 \varphi$ MPa at
# the plastic strain $\varphi$. Units: mm, MPa, N.
#
# **Result.** The picture shows the force of the punch over its depth, with Siebel's estimate of the
# largest force, and the von Mises stress in the section of the cup.
#
# **Compare with.** The flange is drawn to a smaller radius and is compressed in the hoop direction.
# At its outer edge the radial stress is zero. In uniaxial compression at constant volume, the
# radial strain and the strain through the thickness are half of the hoop strain, with the opposite
# sign, so that the thickness grows like $t = t_0 \sqrt{R_0 / r}$ (Hill 1950, chapter XI).
#
# For the largest force there is the estimate of Siebel (Siebel and Beisswaenger 1955), at an outer
# diameter $D$ of 0.77 times that of the disc. With the diameter $d$ of the middle of the wall,
#
# $$F = \pi d t_0 \left[ 1.1\, e^{\mu \pi / 2} k_f \ln \frac Dd + e^{\mu \pi / 2}
#       \frac{2 \mu F_h}{\pi D t_0} + k_f' \frac{t_0}{2 r} \right],$$
#
# where $F_h$ is the force of the holder, $r$ the radius of the die's edge, $k_f$ the mean yield
# stress of the flange and $k_f'$ the yield stress at the edge. The first term is the ideal drawing
# stress of the flange, increased by a tenth; the second is the friction under the holder, on both
# faces of the sheet; both are multiplied by the factor of rope friction at the edge. The third term
# is bending at the edge.
#
# **Options to try.** `--cells` is the number of cells along the radius, `--depth` the depth of the
# punch.
#
# *Sources.* R. Hill, The Mathematical Theory of Plasticity (1950); E. Siebel, H. Beisswaenger,
# Tiefziehen (1955); M. Gruener, M. Merklein, Prod. Eng. 8 (2014) 577, who determine friction by
# Siebel's formula. None of them was available: Hill's formula is derived above; Siebel's formula
# with its numbers 1.1 and 0.77 is quoted from memory.

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

parser = argparse.ArgumentParser(
    description="Deep drawing of a cup from a disc, with a blank holder."
)
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
    """Return the rounded right angle of a tool, by its corner and the direction into the tool."""
    axis = np.array(into) / np.sqrt(2.0)
    tip = np.array(corner) + (np.sqrt(2.0) - 1.0) * EDGE * axis
    return dm.shapes.Wedge(tip, 45.0, axis, EDGE)


# ## Closing the tools, then drawing


def main(options: argparse.Namespace) -> None:
    """Draw the cup; write the summary and the picture, and compare with Siebel and Hill."""
    domain, facets = sheet(options.cells)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    s = np.sqrt(2.0 / 3.0)  # from uniaxial values to the Frobenius norm
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

    # In the first step the position of the holder is given, and the sheet presses on it. From then
    # on its force is given; it changes from the force of the first step to 10 kN within two steps.

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


# ## Results


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
    flat = [row for row in rows if row["rim"] > DIE + EDGE]  # the rim is not yet at the die's edge
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
