# SPDX-License-Identifier: MIT
"""What a problem shows and writes after a step: the step just solved, with nothing undefined."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import COMM, PressedBlocks

meshio = pytest.importorskip("meshio")
pytest.importorskip("h5py")

pytestmark = pytest.mark.mpi
PRESSURE = 5.0


def pressed(law):
    """Return problem, contact and the traction on an upper block that covers [0, 1.1] of [0, 2]."""
    case = PressedBlocks(n_lower=(8, 2), n_upper=(5, 2), x_lower=(0.0, 2.0), x_upper=(0.0, 1.1))
    traction = fem.Constant(case.mesh, PRESSURE)
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    loads = -traction * ufl.TestFunction(case.V)[1] * ds(TOP)
    bcs = [case.bc(BOTTOM), case.roller(TOP, 0)]
    problem = case.problem(bcs=bcs, law=law, loads=loads, geometry="reference")
    return problem, problem.contacts[0], traction


def test_gap_is_a_distance_or_flagged():
    """Python users see NaN where there is no gap, files 0 with "facing" 0."""
    problem, contact, _ = pressed(dm.Elastic(1000.0, 0.0))
    assert not problem.output_fields()["facing"].x.array.any()  # no step yet
    dm.newton(problem)
    gap = contact.gap.x.array
    fields = problem.output_fields()
    facing = fields["facing"].x.array
    assert np.isfinite(fields["gap"].x.array).all() and set(facing) <= {0.0, 1.0}
    slave = problem.system.sides[0].on_slave
    assert np.array_equal(facing == 1.0, slave & ~np.isnan(gap))
    assert np.array_equal(fields["gap"].x.array[facing == 1.0], gap[facing == 1.0])
    assert not fields["gap"].x.array[facing == 0.0].any()
    for expected in (0.0, 1.0):
        assert COMM.allreduce(int((facing[slave] == expected).sum())) > 0


def test_a_file_holds_nothing_undefined(tmp_path):
    """All fields of a step of a contact that ends within a facet can be read and are finite."""
    problem, _, _ = pressed(dm.VonMises(1000.0, 0.0, 1.0, 100.0))
    path = Path(COMM.bcast(str(tmp_path))) / "out.xdmf"
    with dm.Writer(path, problem) as out:
        dm.newton(problem)
        out.write(1.0)
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        reader.read_points_cells()
        _, node, cell = reader.read_data(0)
    assert {"gap", "facing", "pressure", "status", "displacement"} <= set(node)
    assert {"stress", "plastic_strain", "back_stress", "plastic"} <= set(cell)
    assert all(np.isfinite(values).all() for values in node.values())
    assert all(np.isfinite(values[0]).all() for values in cell.values())


def test_a_step_is_shown_before_its_commit():
    """Contact forces, stress, state and written fields are of one step, twice in a row."""
    problem, contact, traction = pressed(dm.VonMises(1000.0, 0.0, 3.0, 100.0))
    shown = []
    for level in (PRESSURE, 2 * PRESSURE):
        traction.value = level
        dm.newton(problem)
        before = (problem.solid.max("von_mises"), problem.solid.max("plastic_strain_norm"))
        assert contact.force[1] == pytest.approx(-1.1 * level, rel=1e-6)
        lowest = COMM.allreduce(
            -problem.solid.fields.values("stress_yy").min(initial=0.0), op=MPI.MAX
        )
        assert lowest >= level * (1 - 1e-9)
        written = problem.output_fields()["von_mises"].x.array.copy()
        problem.commit()
        assert before == (problem.solid.max("von_mises"), problem.solid.max("plastic_strain_norm"))
        assert np.array_equal(problem.output_fields()["von_mises"].x.array, written)
        shown.append(before)
    assert shown[1][0] > shown[0][0] > 0.0 and shown[1][1] > shown[0][1] > 0.0
