# SPDX-License-Identifier: MIT
"""Sheets formed by tools that forces drive: iterations, cuts and time, and the heights measured.

Run with ``containers/run python3 benchmarks/forming.py [--cells 14 28] [--steps 7 70]``. A clamped
disc of steel is drawn over the edge of a die by a ball whose force is given; and the cup of
``demos/deep_drawing`` with a blank holder. Seconds are processor time.

Source of the ball: Code_Aster's case of a punch under force; heights of the pole are measured ones
(10 %), and those of Code_Aster without friction on 14 x 2 cells.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import ClassVar

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

RADIUS, EDGE, BALL = 59.18, 6.35, 50.8  # mm
FORCE = 99_963.0  # N at time 1
HEIGHTS = {  # mm at times: measured, Code_Aster
    0.1: (10.6, 9.977),
    0.2: (15.4, 15.091),
    0.3: (20.0, 19.344),
    0.4: (24.7, 23.595),
    0.5: (28.2, 27.622),
    0.6: (33.0, 32.000),
    0.7: (37.4, 37.054),
}
TOP, BOTTOM = 1, 2
ROOT = np.sqrt(2.0 / 3.0)


@dataclass(frozen=True)
class PowerLaw(dm.materials.PointwiseLaw):
    """Von Mises plasticity with the yield stress K (e0 + p)^n, by radial return."""

    E: float
    nu: float
    K: float
    e0: float
    n: float

    state: ClassVar = {"plastic_strain": (3, 3), "accumulated": ()}
    splits: ClassVar = True
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def update(strain, state, p):  # type: ignore[no-untyped-def]
        """Return stress, tangent and state; Newton's method approaches the root from below."""
        one = np.eye(3)
        ep, k = state["plastic_strain"], state["accumulated"].reshape(-1)
        mu, bulk = p.E / (2 * (1 + p.nu)), p.E / (3 * (1 - 2 * p.nu))
        trace = np.trace(strain, axis1=1, axis2=2)
        xi = 2 * mu[:, None, None] * (strain - trace[:, None, None] / 3 * one - ep)
        norm = np.sqrt((xi**2).sum(axis=(1, 2))) + 1e-12 * p.K
        g, radius = np.zeros(len(k)), lambda g: ROOT * p.K * (p.e0 + ROOT * (k + g)) ** p.n
        flows = norm > radius(g) * (1.0 + 1e-10)
        for _ in range(40):
            slope = 2 * mu + ROOT * p.n * radius(g) / (p.e0 + ROOT * (k + g))
            g = np.where(flows, g + (norm - 2 * mu * g - radius(g)) / slope, 0.0)
        slope = 2 * mu + ROOT * p.n * radius(g) / (p.e0 + ROOT * (k + g))
        n, turned = xi / norm[:, None, None], 1.0 - 2 * mu * g / norm
        stress = (bulk * trace)[:, None, None] * one + turned[:, None, None] * xi
        unit = np.einsum("ik,jl->ijkl", one, one)
        unit = (unit + unit.swapaxes(2, 3)) / 2 - np.einsum("ij,kl->ijkl", one, one) / 3
        wide = (slice(None), *4 * [None])
        along = 4 * mu**2 * (np.where(flows, 1.0 / slope, 0.0) - g / norm)
        tangent = bulk[wide] * np.einsum("ij,kl->ijkl", one, one)
        tangent = tangent + (2 * mu * turned)[wide] * unit
        tangent = tangent - along[wide] * np.einsum("qij,qkl->qijkl", n, n)
        new = {"plastic_strain": ep + g[:, None, None] * n, "accumulated": k + g}
        return stress, tangent, new


def ball(cells: int, friction: float | None, steps: int) -> dict[str, object]:
    """Draw the disc by the ball; return costs, and the heights of the pole."""
    corners = [[0.0, 0.0], [RADIUS, 1.0]]
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, corners, [cells, max(2, cells // 7)], mesh.CellType.quadrilateral
    )
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda x, z=z: np.isclose(x[1], z))
        for z in (1.0, 0.0)
    ]
    facets, tags = np.concatenate(sides), np.repeat([TOP, BOTTOM], [len(s) for s in sides])
    order = np.argsort(facets)
    sides_of = mesh.meshtags(domain, 1, facets[order], tags[order].astype(np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    steel = PowerLaw(69_004.0, 0.3, 589.0, 1e-4, 0.216)
    solid = dm.Solid(u, steel, kinematics="axisymmetric", strain="finite", volumetric="reduced")
    rim = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], RADIUS))
    W = V.sub(0)
    axis = fem.locate_dofs_geometrical((W, W.collapse()[0]), lambda x: np.isclose(x[0], 0.0))[0]
    bcs = [
        fem.dirichletbc(np.zeros(2), rim, V),
        fem.dirichletbc(fem.Constant(domain, 0.0), axis, W),
    ]
    force = fem.Constant(domain, 0.0)
    punch = dm.Obstacle(
        sides_of,
        slave=BOTTOM,
        shape=dm.shapes.Sphere([0.0, -BALL], BALL),
        friction=friction,
        load={"y": force},
    )
    die = dm.Obstacle(
        sides_of,
        slave=TOP,
        shape=dm.shapes.Torus([0.0, 1.0 + EDGE], RADIUS, EDGE),
        friction=friction,
    )
    problem = dm.ContactProblem(solid, [punch, die], bcs=bcs, geometry="updated")
    times = 0.7 * (1.0 + np.arange(steps)) / steps
    start, iterations, cuts, heights = process_time(), 0, 0, {}
    for step in dm.load_steps(
        problem, times, ramp={force: [(0.0, 0.0), (1.0, FORCE)]}, progress=False
    ):
        iterations += step.report.newton_iterations
        cuts += step.report.cuts
        pole = domain.comm.allreduce(float(u.x.array[1::2].max()), op=MPI.MAX)
        heights[round(step.time, 6)] = pole
    seconds = process_time() - start
    found = {t: heights[t] for t in HEIGHTS if t in heights}
    return {
        "cells": cells,
        "friction": friction or 0.0,
        "steps": steps,
        "iterations a step": iterations / steps,
        "cuts": cuts,
        "seconds": seconds,
        "over measured": max(abs(h / HEIGHTS[t][0] - 1) for t, h in found.items() if t <= 0.6),
        "over Code_Aster": max(abs(h / HEIGHTS[t][1] - 1) for t, h in found.items()),
    }


def main() -> None:
    """Print a row for each case; write them as JSON."""
    parser = argparse.ArgumentParser(description="Sheets formed by tools that forces drive.")
    parser.add_argument("--cells", type=int, nargs="*", default=[14, 28])
    parser.add_argument("--steps", type=int, nargs="*", default=[7, 70])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = []
    for cells in options.cells:
        for friction in (None, 0.15):
            for steps in options.steps:
                rows.append(ball(cells, friction, steps))
                print(json.dumps(rows[-1]), flush=True)
    if options.output:
        options.output.write_text(json.dumps(rows, indent=1))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
