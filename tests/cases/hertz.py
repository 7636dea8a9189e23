# SPDX-License-Identifier: MIT
"""The half disc on a block: problem, load steps and the numbers that are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.two_bodies import create_problem, held

PLASTIC = dm.VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
ELASTIC = dm.Elastic(E=206_900.0, nu=0.29)
SIDES = {"block": ("top", "arc"), "disc": ("arc", "top")}


@lru_cache(maxsize=2)
def create_mesh(kind: str, h: float, **options) -> dm.meshing.TaggedMesh:
    """Return a mesh; the last ones are kept, because gmsh takes longer than some tests."""
    return dm.meshing.hertz(MPI.COMM_WORLD, kind=kind, h=h, **options)


@dataclass
class HertzCase:
    """A problem whose flat face moves down by a prescribed displacement."""

    problem: dm.ContactProblem
    contact: dm.Contact
    top: fem.Constant  # displacement of the flat face

    def press(self, depth: float) -> None:
        """Prescribe the displacement (0, -depth) of the flat face."""
        self.top.value[:] = (0.0, -depth)

    def move(self, x: float, depth: float, **options) -> dm.StepReport:
        """Prescribe the displacement (x, -depth) of the flat face, solve and commit."""
        self.top.value[:] = (x, -depth)
        report = dm.newton(self.problem, **options)
        self.problem.commit()
        return report

    def fit(self) -> tuple[float, float]:
        """Return half-width and peak pressure of p^2 = p0^2 (1 - x^2/b^2), least squares.

        Over the active nodes, at reference x when frozen and at current x when updated.
        """
        surface = self.contact.gather(self.problem.u)
        on = surface["active"] > 0
        x = surface["x" if self.problem.geometry == "updated" else "X"][on, 0]
        peak, half_width = dm.analytic.fit_pressure(x, surface["pressure"][on])
        return half_width, peak

    @property
    def force(self) -> float:
        """Total contact force, positive in compression."""
        return float(abs(self.contact.force[1]))


def create_case(
    mesh: dm.meshing.TaggedMesh,
    materials=PLASTIC,
    *,
    slave: str = "block",
    geometry: str = "updated",
    degree: int = 1,
    shape: dm.shapes.Shape | None = None,
    strain: str = "small",
    kinematics: str = "plane_strain",
    **options,
) -> HertzCase:
    """Clamp the block's bottom, prescribe the disc's flat face, put contact in between.

    A shape stands for the master. The options are those of the contact.
    """
    V, sides = fem.functionspace(mesh.mesh, ("Lagrange", degree, (2,))), mesh.facet_tags
    top = fem.Constant(mesh.mesh, np.zeros(2))
    bcs = [held(V, sides, "bottom"), held(V, sides, "flat", top)]
    bcs += [held(V, sides, "axis", 0.0, 0)] if "axis" in sides.names else []
    side, master = SIDES[slave]
    if shape is None:
        contact = dm.Contact(sides, slave=side, master=master, **options)
    else:
        contact = dm.Obstacle(sides, slave=side, shape=shape, **options)
    own = {"strain": strain, "kinematics": kinematics, "geometry": geometry}
    problem = create_problem(V, [contact], bcs, materials, mesh.cell_tags, **own)
    return HertzCase(problem, contact, top)


def paper(materials=PLASTIC, *, gap: float = 0.0, **options) -> HertzCase:
    """Return the case on a mesh like that of the paper."""
    mesh = dm.meshing.hertz(MPI.COMM_WORLD, kind="paper", gap=gap)
    return create_case(mesh, materials, **options)
