# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Modulus, yield stress and hardening from an indentation curve
#
# A ball is pressed into a block and withdrawn; from the forces alone this demo finds the three
# constants of the law. It shows how to
#
# - ask for the derivatives of forces by the Constants of a law, `dm.sensitivity`,
# - carry them through the history of a plastic body, from step to step.
#
# **Problem.** A rigid ball of radius 1 mm is pressed 0.03 mm deep into a round block, axisymmetric,
# and withdrawn a little. The law is that of von Mises with isotropic hardening. The measured
# curve is computed by the same program with $E$ = 200 GPa, a yield stress of 400 MPa and a plastic
# modulus of 2 GPa. Loading mixes the three constants; unloading shows the modulus.
#
# **Method.** Gauss and Newton's method for the logarithms of the constants $p_k$: with the forces
# $F_i$ at the depths, $J_{ik} = p_k \, \partial F_i / \partial p_k$,
#
# $$\delta = \operatorname{argmin} \| F + J \delta - F_\text{measured} \|, \qquad
#   p_k \leftarrow p_k e^{\delta_k},$$
#
# with steps of at most a factor $e$. Differences would take six more computations of the curve per
# iteration; the derivatives take one factorisation per depth, and no solution of a step.
#
# **Result.** From three starts, with constants up to three times too large or too small, all three
# agree with those of the measured curve to six digits after a few iterations. The picture shows the
# curves of the starts and the one that all end with, and the errors of the constants.
#
# **Options to try.** `--measured 28` computes the measured curve on a finer mesh: the constants
# then compensate the error of the coarse one.

import argparse
import json
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx import mesh as dmesh

RADIUS, SIZE, NU = 1.0, 4.0, 0.3  # mm, mm, -
DEPTHS = (0.003, 0.01, 0.02, 0.03, 0.0295, 0.029)  # mm
TRUE = (200e3, 400.0, 2000.0)  # MPa
NAMES = ("modulus", "yield_stress", "plastic_modulus")
STARTS = ((100e3, 900.0, 1000.0), (400e3, 150.0, 5000.0), (300e3, 800.0, 700.0))

parser = argparse.ArgumentParser(description="Constants of a law from an indentation curve.")
parser.add_argument("--cells", type=int, default=20, help="of the block in each direction")
parser.add_argument("--measured", type=int, default=20, help="the same, of the measured curve")
parser.add_argument("--output", type=Path, default=Path("results/identify"))


# ## The curve and its derivatives
#
# The constants are read at every step. Derivatives are asked for before each commit; from the
# second step on they continue those of the step before.


def curve(cells: int, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces (steps,) on the ball and their derivatives (steps, 3)."""
    domain = dmesh.create_rectangle(
        MPI.COMM_WORLD, [[0, 0], [1, 1]], [cells, cells], dmesh.CellType.quadrilateral
    )
    t = domain.geometry.x[:, :2]
    t[:] = 0.35 * t + (SIZE - 0.35) * t**4
    t[:, 1] *= -1.0
    top = dmesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    facets = dmesh.meshtags(domain, 1, np.sort(top), np.ones(len(top), dtype=np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    bcs = []
    for axis, at in ((0, 0.0), (1, -SIZE)):
        W = V.sub(axis)
        side = dmesh.locate_entities_boundary(
            domain, 1, lambda x, axis=axis, at=at: np.isclose(x[axis], at)
        )
        dofs = fem.locate_dofs_topological(W, 1, side)
        bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), dofs, W))

    given = [fem.Constant(domain, float(value)) for value in constants]
    modulus, strength, hardening = given
    law = dm.VonMises(modulus, NU, np.sqrt(2 / 3) * strength, 0.0, 2 / 3 * hardening)
    solid = dm.Solid(fem.Function(V), law, kinematics="axisymmetric", volumetric="reduced")
    ball = dm.Obstacle(facets, slave=1, shape=dm.shapes.Sphere([0.0, RADIUS], RADIUS))
    problem = dm.ContactProblem(solid, [ball], bcs=bcs)

    forces, derivatives, to = [], [], given
    for depth in DEPTHS:
        ball.position.value[1] = RADIUS - depth
        dm.newton(problem, rtol=1e-8)
        to = dm.sensitivity(problem, of=[lambda: ball.tool_force[1]], to=to)
        problem.commit()
        forces.append(ball.tool_force[1])
        derivatives.append(to.values[0])
    return np.array(forces), np.array(derivatives)


# ## Identification


def identify(cells: int, measured: np.ndarray, start: tuple[float, ...]) -> list[np.ndarray]:
    """Return the constants of all iterations, until the change is below 1e-7."""
    found = [np.array(start)]
    for _ in range(15):
        forces, derivatives = curve(cells, found[-1])
        scaled = derivatives * found[-1]
        change, *_ = np.linalg.lstsq(scaled, measured - forces)
        found.append(found[-1] * np.exp(np.clip(change, -1.0, 1.0)))
        if np.abs(change).max() < 1e-7:
            break
    return found


def draw(measured: np.ndarray, runs: list[list[np.ndarray]], options: argparse.Namespace) -> None:
    """Draw curves and errors."""
    firsts, last = [curve(options.cells, run[0])[0] for run in runs], runs[0][-1]
    identified = curve(options.cells, last)[0]
    if MPI.COMM_WORLD.rank > 0:
        return
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for first, run in zip(firsts, runs, strict=True):
        left.plot(DEPTHS, first, ":", lw=1.0)
        error = [np.abs(one / TRUE - 1.0).max() for one in run]
        right.semilogy(error, ".-", lw=1.0)
    left.plot(DEPTHS, identified, "k-", lw=1.0, label="identified")
    left.plot(DEPTHS, measured, "ko", ms=4, label="measured")
    left.set(xlabel="depth [mm]", ylabel="force [N]", title="Dotted: the starts")
    left.legend()
    right.set(xlabel="iteration", title="Largest relative error of the constants")
    right.grid(alpha=0.3)
    figure.savefig(options.output / "result.png", dpi=90)


def main() -> None:
    """Identify the constants from all starts."""
    options = parser.parse_args()
    if min(options.cells, options.measured) < 8:
        parser.error("--cells and --measured must be at least 8")
    measured, _ = curve(options.measured, np.array(TRUE))
    runs = [identify(options.cells, measured, start) for start in STARTS]
    if MPI.COMM_WORLD.rank == 0:
        for run in runs:
            found = ", ".join(f"{n} {v:.6g} MPa" for n, v in zip(NAMES, run[-1], strict=True))
            print(f"{len(run) - 1} iterations: {found}")
        options.output.mkdir(parents=True, exist_ok=True)
        rows = [{"iterations": len(r) - 1} | dict(zip(NAMES, r[-1], strict=True)) for r in runs]
        text = json.dumps({"runs": rows, "expected": dict(zip(NAMES, TRUE, strict=True))}, indent=1)
        (options.output / "summary.json").write_text(text)
    draw(measured, runs, options)


if __name__ == "__main__":
    main()
