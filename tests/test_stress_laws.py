# SPDX-License-Identifier: MIT
"""Materials that state their stress and have no potential: Newton takes whole steps."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import COMM, PressedBlocks
from tests.choice import quick


@dataclass(frozen=True)
class RadialReturn:
    """The law of `VonMises`, written as a stress."""

    E: float
    nu: float
    Y: float
    a: float

    state: ClassVar[dict] = {"plastic_strain": (3, 3)}
    linear: ClassVar[bool] = False
    elastic_stress = staticmethod(dm.VonMises.elastic_stress)
    updated_state = staticmethod(dm.VonMises.updated_state)
    output = staticmethod(dm.VonMises.output)

    @staticmethod
    def stress(eps: Any, state: Any, p: Any) -> Any:
        """Return C (eps - ep_n) - 2 mu dgam n."""
        mu, ep = p.E / (2 * (1 + p.nu)), state["plastic_strain"]
        xi = 2 * mu * ufl.dev(eps) - (2 * mu + p.a) * ep
        norm = ufl.sqrt(ufl.inner(xi, xi) + (1e-14 * p.Y) ** 2)
        flow = ufl.max_value(norm - p.Y, 0) / (2 * mu + p.a) / norm * xi
        return dm.Elastic.elastic_stress(eps - ep, p) - 2 * mu * flow


def press(law, traction):
    """Press the blocks by a movement of the top, or a traction on it; return problem and report."""
    case = PressedBlocks()
    solid = dm.Solid(case.u, law(1000.0, 0.3, 1.0, 100.0))
    bcs, loads = case.bcs(), None
    if traction:
        top = fem.locate_dofs_topological(case.V.sub(0), 1, case.facets.find(TOP))
        guide = fem.dirichletbc(default_scalar_type(0), top, case.V.sub(0))
        bcs, loads = [case.bc(BOTTOM), guide], case.pull((0.0, -traction))
    problem = dm.ContactProblem(solid, [case.contact()], bcs=bcs, loads=loads)
    return problem, dm.newton(problem, rtol=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("traction", quick([0.0, 2.0], 2.0))
def test_newton_without_an_energy(traction):
    """The same answer as with the energy, and no line search."""
    with_energy, _ = press(dm.VonMises, traction)
    without, report = press(RadialReturn, traction)
    assert with_energy.solid.energy() is not None and without.solid.energy() is None
    assert report.newton_iterations > 2
    assert all(i.line_search_steps == 0 and i.step_length == 1.0 for i in report.iterations)
    assert without.contacts[0].force == pytest.approx(with_energy.contacts[0].force, rel=1e-8)
    difference = np.abs(without.u.x.array - with_energy.u.x.array).max(initial=0.0)
    assert COMM.allreduce(difference) < 1e-9
