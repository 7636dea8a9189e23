# SPDX-License-Identifier: MIT
"""Laws of a small strain in solids at finite strain: consistency, solutions, contact, restarts."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases.meshes import BOTTOM, TOP, two_blocks
from tests.cases.pointwise_laws import Compiled
from tests.cases.solid import (
    COMM,
    create_displacement,
    create_domain,
    create_tags,
    residual,
    total,
    wave,
)
from tests.cases.user_laws import Forces

pytestmark = pytest.mark.mpi
E, NU, SIGMA_Y = 200e3, 0.3, 200.0
Y = np.sqrt(2 / 3) * SIGMA_Y
HARDENING = dm.VonMises(E, NU, Y, 0.0, 1000.0)
MIXED = dm.VonMises(E, NU, Y, 500.0, 1000.0)
SIXTH = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}


def waved(cell, law, kinematics=None, size=0.1, **options):
    """Return a solid that has flowed, at another u."""
    u = create_displacement(create_domain(cell, 3))
    solid = dm.Solid(u, law, kinematics=kinematics, strain="finite", **options)
    d = u.function_space.mesh.geometry.dim

    def values(phase):
        return lambda x: wave(size, phase)(x)[:d] * (x[0] if kinematics else 1.0)

    u.interpolate(values(0.0))
    solid.evaluate()
    solid.commit()
    u.interpolate(values(0.5))
    return solid


@pytest.mark.slow
@pytest.mark.parametrize("law", [HARDENING, MIXED, Compiled(E, NU, Y, 500.0), Forces(E)])
@pytest.mark.parametrize(
    ("cell", "kinematics"),
    [("quadrilateral", None), ("triangle", "axisymmetric"), ("hexahedron", None)],
)
def test_forces_and_tangent_are_derivatives(cell, kinematics, law):
    _compare(waved(cell, law, kinematics))


@pytest.mark.slow
def test_with_the_mean_volume_of_cells_they_are_derivatives_too():
    """The part K/2 (ln J)^2 of a law that splits is taken at the mean of J over each cell."""
    _compare(waved("quadrilateral", HARDENING, volumetric="reduced"))


def _compare(solid):
    """Compare tangent and forces with differences of forces and energy."""
    u, h = solid.u.x.array.copy(), 1e-5
    w = fem.Function(solid.V)
    w.interpolate(lambda x: wave(1.0, 0.2)(x)[: solid.mesh.geometry.dim])
    K, product = solid.create_matrix(), w.x.petsc_vec.duplicate()
    solid.assemble_tangent(K)
    K.mult(w.x.petsc_vec, product)
    work = total(residual(solid) * w.x.array[: len(product.array)])
    change, slope = 0.0, 0.0
    for n, weight in SIXTH.items():
        for sign in (1, -1):
            solid.u.x.array[:] = u + sign * n * h * w.x.array
            change = change + sign * weight * residual(solid) / h
            energy = solid.energy()
            slope += 0.0 if energy is None else sign * weight * total(energy) / h
    scale = COMM.allreduce(np.abs(product.array).max(initial=0.0), op=MPI.MAX)
    assert np.abs(change - product.array).max(initial=0.0) < 1e-9 * scale
    assert (solid.energy() is None) == (solid.regions[0].law.name in ("Compiled", "Forces"))
    if solid.energy() is not None:
        assert slope == pytest.approx(work, rel=1e-9)


@pytest.mark.parametrize("law", [HARDENING, MIXED])
@pytest.mark.parametrize(
    "turn", [30.0, 180.0, *(pytest.param(t, marks=pytest.mark.slow) for t in (90.0, 270.0))]
)
def test_forces_turn_with_the_body(turn, law):
    """In one step from a state that has flowed; nothing flows by a turn."""
    solid = waved("quadrilateral", law)
    solid.evaluate()
    solid.commit()
    solid.evaluate()
    before, J = residual(solid).reshape(-1, 2), solid.max("J")
    strain = {name: f.x.array.copy() for name, f in solid.state.items()}
    a = np.deg2rad(turn)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    x = solid.V.tabulate_dof_coordinates()[:, :2]
    u = solid.u.x.array.reshape(-1, 2)
    u[:] = (x + u) @ R.T - x
    solid.evaluate()
    after = residual(solid).reshape(-1, 2)
    size = COMM.allreduce(np.abs(before).max(initial=0.0), op=MPI.MAX)
    assert np.abs(after - before @ R.T).max(initial=0.0) < 1e-11 * size
    assert solid.max("J") == pytest.approx(J, rel=1e-13)
    solid.commit()
    for name, f in solid.state.items():
        assert np.abs(f.x.array - strain[name]).max(initial=0.0) < 1e-13


def bar(kinematics, law, **options):
    """Return a problem of a bar of length 2 along the last axis, and the Constant of its end."""
    cell = "hexahedron" if kinematics is None else "quadrilateral"
    if kinematics is None:
        domain = mesh.create_box(COMM, [(0, 0, 0), (1, 1, 2)], (1, 2, 2), mesh.CellType[cell])
    else:
        domain = mesh.create_rectangle(COMM, [(0, 0), (1, 2)], (2, 2), mesh.CellType[cell])
    d = domain.geometry.dim
    V = fem.functionspace(domain, ("Lagrange", 1, (d,)))
    solid = dm.Solid(fem.Function(V), law, kinematics=kinematics, strain="finite", **options)
    end, bcs = fem.Constant(domain, 0.0), []
    for i in range(d):
        facets = mesh.locate_entities_boundary(domain, d - 1, lambda x, i=i: np.isclose(x[i], 0))
        dofs = fem.locate_dofs_topological(V.sub(i), d - 1, facets)
        bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), dofs, V.sub(i)))
    facets = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[d - 1], 2))
    bcs.append(
        fem.dirichletbc(end, fem.locate_dofs_topological(V.sub(d - 1), d - 1, facets), V.sub(d - 1))
    )
    return dm.ContactProblem(solid, bcs=bcs), end


@pytest.mark.parametrize(("kinematics", "law"), [("axisymmetric", HARDENING), (None, MIXED)])
def test_a_bar_is_stretched_to_twice_its_length(kinematics, law):
    """Cauchy's stress times J = (sigma_y + h ln lambda) / (1 + h / E), h = 3/2 (a + H)."""
    problem, end = bar(kinematics, law)
    solid, iterations = problem.solid, []

    def on_time(t):
        end.value = 2.0 * t

    for step in dm.load_steps(problem, np.linspace(0.05, 1.0, 20), on_time=on_time, rtol=1e-12):
        iterations.append(step.report.newton_iterations)
        assert not step.report.notes
    h = 1.5 * (law.a + law.H)
    tau = solid.max("von_mises") * solid.max("J")
    assert tau == pytest.approx((SIGMA_Y + h * np.log(2)) / (1 + h / E), rel=1e-9)
    plastic = np.log(2) - tau / E
    assert solid.max("plastic_strain_norm") == pytest.approx(np.sqrt(1.5) * plastic, rel=1e-9)
    assert max(iterations) <= 6


class Upset:
    """Two plastic blocks on each other, pressed: contact at finite strain."""

    def __init__(self, law):
        """Make the problem."""
        self.mesh, cells, self.facets = two_blocks(
            COMM, (4, 3), (5, 4), x_upper=(0.0, 0.9), jitter=0.3, cell="quadrilateral"
        )
        V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.top, bcs = fem.Constant(self.mesh, np.zeros(2)), []
        for tag, value in ((BOTTOM, fem.Constant(self.mesh, np.zeros(2))), (TOP, self.top)):
            dofs = fem.locate_dofs_topological(V, 1, self.facets.find(tag))
            bcs.append(fem.dirichletbc(value, dofs, V))
        solid = dm.Solid(fem.Function(V), law, cells, strain="finite")
        contact = dm.Contact(self.facets, slave=3, master=4)
        self.problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")

    def walk(self, levels):
        def on_time(t):
            self.top.value[:] = (0.01 * t, -0.1 * t)

        return list(dm.load_steps(self.problem, levels, on_time=on_time, rtol=1e-10))


LEVELS = [0.5, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize("law", [HARDENING, MIXED])
def test_contact_and_restart(law, tmp_path):
    """Newton ends quadratically; a checkpoint has the plastic metric, the run goes on the same."""
    folder = COMM.bcast(tmp_path)
    whole, first, second = Upset(law), Upset(law), Upset(law)
    steps = whole.walk(LEVELS)
    assert all(step.report.converged for step in steps)
    assert whole.problem.solid.max("plastic_strain_norm") > 0.03
    first.walk(LEVELS[:1])
    first.problem.save(folder / "half.h5")
    second.problem.restore(folder / "half.h5")
    second.walk(LEVELS[1:])
    round_off = 0.0 if COMM.size == 1 else 1e-12  # MUMPS adds up in the order of messages
    pairs = [(second.problem.u, whole.problem.u)]
    pairs += [(second.problem.solid.state[k], f) for k, f in whole.problem.solid.state.items()]
    for found, expected in pairs:
        change = np.abs(found.x.array - expected.x.array).max(initial=0.0)
        assert change <= round_off * np.abs(expected.x.array).max(initial=0.0)


def test_lost_stress_is_noted():
    """Sheared by 1.2, a kinematic law says what it loses; an isotropic one loses nothing."""
    for law, noted in ((dm.VonMises(E, NU, Y, 1.0), True), (dm.VonMises(E, NU, Y, 0.0), False)):
        domain = mesh.create_unit_square(COMM, 2, 2, mesh.CellType.quadrilateral)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        solid, step = dm.Solid(fem.Function(V), law, strain="finite"), fem.Function(V)
        facets = mesh.locate_entities_boundary(domain, 1, lambda x: np.full(x.shape[1], True))
        bcs = [fem.dirichletbc(step, fem.locate_dofs_topological(V, 1, facets))]
        problem = dm.ContactProblem(solid, bcs=bcs)

        def on_time(t, step=step):
            step.interpolate(lambda x: np.stack([1.2 * t * x[1], 0 * x[0]]))

        *_, last = dm.load_steps(problem, np.linspace(0.05, 1, 20), on_time=on_time)
        assert any("logarithmic strain space" in note for note in last.report.notes) == noted
        tau = solid.max("stress_xy")
        assert tau == pytest.approx(SIGMA_Y / np.sqrt(3), rel=1e-3 if not noted else 0.06)


@pytest.mark.slow
def test_one_class_may_run_in_both_forms():
    """Of a kinematic and an isotropic law of one class each cell has the answer of its own."""
    domain = create_domain("quadrilateral", 3)
    tags = create_tags(domain, lambda x: np.where(x[:, 0] < 0.5, 1, 2))

    def shear(materials):
        solid = dm.Solid(create_displacement(domain), materials, tags, strain="finite")
        solid.u.interpolate(lambda x: np.stack([2.0 * x[1], 0 * x[0]]))
        solid.evaluate()
        return solid.fields.values("stress_xy"), solid

    (both, solid), (one, _), (other, _) = map(
        shear, ({1: MIXED, 2: HARDENING}, {1: MIXED, 2: MIXED}, {1: HARDENING, 2: HARDENING})
    )
    assert sorted(region.law.isotropic for region in solid.regions) == [False, True]
    left = tags.values[: len(both)] == 1
    assert np.array_equal(both[left], one[left])
    assert np.array_equal(both[~left], other[~left])
    assert not np.allclose(one, other, rtol=1e-2)
