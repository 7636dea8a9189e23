# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # An assembly from CAD: a bolted joint
#
# This demo reads a STEP file of several parts. It shows how to
#
# - mesh the solids of a STEP file, `dm.meshing.read_step`,
# - find the sides that touch, `dm.find_pairs`, and replace one pair by a bolt's tie,
# - preload the bolt, and then pull the joint apart.
#
# **Problem.** Two plates of 40 x 40 x 8 mm are held together by a bolt of 10 mm in a hole of 11 mm.
# The bolt is tightened to 20 kN; then the upper plate is pulled up at its rim, while the lower one
# is held there. The file has a quarter of four parts: upper plate, lower plate, the upper half of
# the bolt with its head, and the lower half with its nut. The two halves are tied with a
# pretension, all other pairs are contacts without friction. All is of steel ($E$ = 210 GPa, $\nu$ =
# 0.3). Units: mm, MPa, N; forces are those of the whole joint.
#
# **Result.** Bolt force $B$ and clamping force $C$ between the plates over the pull $W$; the von
# Mises stress in the open joint, with displacements 50 times as large.
#
# **Compare with.** Equilibrium of the upper half: bolt force, force under the head and under the
# nut are equal, and
#
# $$B = C + W.$$
#
# While the plates are pressed together, the pull relieves the clamping force rather than loads the
# bolt, whose force grows by 1.2 % up to half of the preload. Once the plates are apart, $C = 0$, it
# carries all of the pull. In the picture the halves of the bolt overlap by what it was tightened.
#
# **Options to try.** `--size` is the size of the cells, `--preload` the force of the bolt.

import argparse
import re
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np
from matplotlib.figure import Figure

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh

HALF, THICK = 20.0, 8.0  # plates: half the edge, thickness
SHANK, HOLE, HEAD, HEIGHT = 5.0, 5.5, 9.0, 6.0  # radii, height of the head
PARTS = "upper plate", "bolt", "lower plate", "nut"
RIM = 12.0  # held and pulled beyond this radius

parser = argparse.ArgumentParser(description="A bolted joint from a STEP file.")
parser.add_argument("--size", type=float, default=2.0, help="of the cells, in mm")
parser.add_argument("--preload", type=float, default=20e3, help="of the bolt, in N")
parser.add_argument("--output", type=Path, default=Path("results/assembly"))


def write(path: Path) -> None:
    """Write the parts as a STEP file, as a CAD program would."""
    gmsh.initialize(["", "-v", "0"], interruptible=False)
    occ = gmsh.model.occ
    quarter = {"angle": np.pi / 2}
    for low, head in ((0.0, THICK), (-THICK, -THICK - HEIGHT)):
        plate = occ.addBox(0, 0, low, HALF, HALF, THICK)
        occ.cut([(3, plate)], [(3, occ.addCylinder(0, 0, low, 0, 0, THICK, HOLE))])
        shank = occ.addCylinder(0, 0, low, 0, 0, THICK, SHANK, **quarter)
        occ.fuse([(3, shank)], [(3, occ.addCylinder(0, 0, head, 0, 0, HEIGHT, HEAD, **quarter))])
    occ.synchronize()
    gmsh.write(str(path))
    gmsh.finalize()
    unnamed = re.compile(r"'Open CASCADE STEP translator [\d.]+ 1\.(\d+)'")  # Gmsh writes no names
    text = unnamed.sub(lambda part: repr(PARTS[int(part[1]) - 1]), path.read_text())
    path.write_text(text)


def main(options: argparse.Namespace) -> None:
    """Read the assembly, tighten its bolt, pull, write numbers and a picture."""
    comm = MPI.COMM_WORLD
    file = options.output / "joint.step"
    if comm.rank == 0:
        options.output.mkdir(parents=True, exist_ok=True)
        write(file)
    comm.Barrier()

    # ## Mesh and pairs
    #
    # `within=` leaves out the pair of bolt and hole, which do not touch (the audit names them). The
    # halves of the bolt are tied, all other pairs are contacts.

    domain, bodies, _ = dm.meshing.read_step(file, size=options.size)
    pairs = dm.find_pairs(domain, bodies, within=0.1)
    parts = [frozenset(pair.slave.split(" to ")) for pair in pairs.found]
    joint: dict = dict(zip(parts, pairs.contacts, strict=True))
    sides = joint.pop(frozenset(["bolt", "nut"]))
    cut = dm.Tie(pairs.tags, slave=sides.slave, master=sides.master)

    # ## Supports and loads
    #
    # Planes of symmetry, and the rims of both plates; a quarter of the pull and of the preload.

    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    held: dict = {
        0: lambda x: np.isclose(x[0], 0.0),
        1: lambda x: np.isclose(x[1], 0.0),
        2: lambda x: np.isclose(x[2], -THICK) & (np.hypot(x[0], x[1]) > RIM),
    }
    bcs = []
    for i, where in held.items():
        facets = mesh.locate_entities_boundary(domain, 2, where)
        dofs = fem.locate_dofs_topological(V.sub(i), 2, facets)
        bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), dofs, V.sub(i)))
    rim = mesh.locate_entities_boundary(
        domain, 2, lambda x: np.isclose(x[2], THICK) & (np.hypot(x[0], x[1]) > RIM)
    )
    ds = ufl.Measure("ds", domain, subdomain_data=mesh.meshtags(domain, 2, rim, 1))
    one, pull = fem.Constant(domain, 1.0), fem.Constant(domain, 0.0)
    area = comm.allreduce(fem.assemble_scalar(fem.form(one * ds(1))))
    loads = pull / area * ufl.TestFunction(V)[2] * ds(1)
    solid = dm.Solid(fem.Function(V), dm.Elastic(E=210e3, nu=0.3), bodies)
    problem = dm.ContactProblem(solid, [cut, *joint.values()], bcs=bcs, loads=loads)

    # ## Preload, then pull
    #
    # The bolt is tight from the first step on: then the jump of its tie stays. In each step the
    # forces of all interfaces balance.

    cut.pretension = options.preload / 4.0
    levels = options.preload * np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25])
    walk = dm.load_steps(problem, levels, on_time=lambda W: pull.value.fill(W / 4.0), rtol=1e-9)
    rows = []
    for step in walk:
        cut.pretension = None
        interfaces = {"bolt": cut, **{" and ".join(sorted(two)): c for two, c in joint.items()}}
        forces = {name: 4.0 * abs(on.force[2]) for name, on in interfaces.items()}
        rows.append({"pull": step.time, **forces})
        if comm.rank == 0:
            print(", ".join(f"{name} {force:.0f} N" for name, force in rows[-1].items()))
        clamp = forces["lower plate and upper plate"]
        expected = [forces["bolt"], forces["bolt"], clamp + step.time]
        found = [forces["bolt and upper plate"], forces["lower plate and nut"], forces["bolt"]]
        assert np.allclose(found, expected, rtol=1e-6)

    # ## Results

    dm.write_summary(options.output / "summary.json", problem, rows, options=vars(options))
    dm.plotting.field(
        problem, "von_mises", scale=50.0, file=options.output / "result.png", view=(-1, -1.3, 0.6)
    )
    if comm.rank == 0:
        draw(options.output / "forces.png", rows)


def draw(path: Path, rows: list[dict]) -> None:
    """Draw the forces over the pull."""
    figure = Figure(figsize=(5, 4), layout="constrained")
    axes = figure.subplots()
    pull = [1e-3 * row["pull"] for row in rows]
    axes.plot(pull, pull, "k:", label="pull W")
    names = {"bolt": "bolt B", "lower plate and upper plate": "clamp C"}
    for name, label in names.items():
        axes.plot(pull, [1e-3 * row[name] for row in rows], "o-", label=label)
    axes.set(xlabel="pull W [kN]", ylabel="force [kN]")
    axes.legend()
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    chosen = parser.parse_args()
    if not (chosen.size > 0.0 and chosen.preload > 0.0):
        parser.error(f"--size {chosen.size}, --preload {chosen.preload}: positive numbers")
    main(chosen)
