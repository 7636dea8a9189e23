# SPDX-License-Identifier: MIT
"""The solid: norms, quadrature, what is compiled and when; results and committed state."""

from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import ffcx.codegeneration.jit
import ufl
from dolfinx import fem
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.materials.tensor import from_components
from dolfinx_mortar.solid.kinematics import choose_kinematics
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import (
    CELLS,
    COMM,
    STEEL,
    create_domain,
    create_loaded,
    create_tags,
    residual,
    set_wave,
    solid_on,
    total,
)
from tests.cases.user_laws import OfHooke

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("cell", CELLS)
def test_element_force_norm(cell):
    """On simplices it is the norm of the forces assembled in a space without continuity."""
    solid = create_loaded(cell)
    solid.evaluate()
    d = solid.mesh.geometry.dim
    W = fem.functionspace(solid.mesh, ("Discontinuous Lagrange", 1, (d,)))
    rule = {"quadrature_degree": solid.quadrature_degree, "quadrature_scheme": "default"}
    dx = ufl.dx(metadata=rule)
    virtual = choose_kinematics(None, d).measure(ufl.TestFunction(W))
    form = ufl.inner(from_components(solid.stress), virtual) * dx
    forces = fem.assemble_vector(fem.form(form)).array
    expected = np.sqrt(total(forces[: d * W.dofmap.index_map.size_local] ** 2))
    simplex = cell in ("triangle", "tetrahedron")
    assert np.isclose(solid.element_force_norm(), expected, rtol=1e-10 if simplex else 0.5)
    assert np.sqrt(total(residual(solid) ** 2)) < 3 * expected


def refuse(*_, **__):
    raise AssertionError("a form or expression was created")


def test_nothing_is_compiled_for_other_numbers(monkeypatch):
    """Other parameters, tags, meshes of the same cells and the steps themselves compile nothing."""

    def use(n, first, scale):
        domain = create_domain("triangle", n)
        tags = create_tags(domain, lambda x: first + (x[:, 0] > 0.3) + (x[:, 1] > 0.7))
        hard = VonMises(scale * STEEL.E, 0.2, scale * STEEL.Y, 0.0)
        laws = {first: STEEL, first + 1: Elastic(scale, 0.1), first + 2: hard}
        for materials, cell_tags in ((laws, tags), (hard, None)):
            solid = solid_on(domain, materials, cell_tags)
            K = solid.create_matrix()
            for size in (1e-4, 1e-2):
                set_wave(solid.u, size)
                residual(solid)
                solid.assemble_tangent(K)
                solid.energy()
                solid.elastic_norm(solid.u)
                solid.element_force_norm()
                solid.evaluate()
                solid.commit()
                solid.max("von_mises")
                solid.cell_values("hardening")

    use(4, 1, 1.0)

    monkeypatch.setattr(ffcx.codegeneration.jit, "_compile_objects", refuse)
    use(5, 10, 10.0)


def test_units_of_length():
    """With all lengths scaled, energies scale and the dimensionless results stay."""
    results = []
    for scale in (1e-6, 1.0, 1e6):
        domain = create_domain("triangle")
        solid = solid_on(domain, STEEL)
        set_wave(solid.u, 1.5e-3)
        solid.u.x.array[:] *= scale
        domain.geometry.x[:] *= scale
        energy = total(solid.energy()) / scale**2
        solid.evaluate()
        solid.commit()
        area = solid.plastic_area() / scale**2
        results.append([energy, area, solid.max("plastic_strain_norm")])
    assert np.allclose(results, results[1], rtol=1e-11)


def shown(solid):
    """Return all that shows results, as numbers."""
    written = {name: f.x.array.copy() for name, f in solid.output_fields().items()}
    values = {f"values {name}": solid.fields.values(name) for name in solid.fields.names}
    largest = {f"max {n}": solid.max(n) for n in ("von_mises", "plastic_strain_norm", "plastic")}
    return written | values | largest | {"area": solid.plastic_area(), "s": solid.stress.x.array}


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_results_are_those_of_the_step_before_and_after_its_commit(cell):
    """Evaluating shows the step at u; accepting it changes nothing that is shown."""
    solid = create_loaded(cell)
    committed = {name: f.x.array.copy() for name, f in solid.state.items()}
    old = {name: np.copy(value) for name, value in shown(solid).items()}
    solid.evaluate()
    new = {name: np.copy(value) for name, value in shown(solid).items()}
    differences = [np.abs(new[n] - old[n]).max(initial=0.0) for n in ("stress", "plastic_strain")]
    assert COMM.allreduce(differences[0], op=MPI.MAX) > 1e-2 * STEEL.Y
    assert COMM.allreduce(differences[1], op=MPI.MAX) > 1e-5
    assert all(np.array_equal(solid.state[n].x.array, values) for n, values in committed.items())
    solid.commit()
    after = shown(solid)
    assert after.keys() == new.keys()
    assert all(np.array_equal(after[name], value) for name, value in new.items())
    changed = any(not np.array_equal(solid.state[n].x.array, committed[n]) for n in committed)
    assert COMM.allreduce(changed, op=MPI.LOR)


class Stretched(OfHooke):
    """A law that is undefined where it is pressed together too much."""

    state: ClassVar = {"wear": ()}
    energy = staticmethod(Elastic.energy)

    @staticmethod
    def updated_state(eps, state, p):
        return {"wear": ufl.ln(1 + 5 * eps[0, 0])}


def test_an_evaluation_that_fails_changes_nothing():
    """Neither what is shown nor what a later commit takes, on any rank, in any body."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: 1 + (x[:, 0] < 0.5))
    solid = solid_on(domain, {1: STEEL, 2: Stretched(1.0, 0.3)}, tags)
    set_wave(solid.u, 1e-2)
    solid.evaluate()
    names = ("stress", "wear", "plastic_strain", "plastic", "von_mises")
    good = {name: solid.fields.values(name).copy() for name in names}
    everywhere = solid.stress.x.array.copy()
    solid.u.interpolate(lambda x: np.stack([-0.3 * x[0] * x[1], 0 * x[1]]))
    with rejected("Stretched: wear is NaN or infinite"):
        solid.evaluate()
    assert np.array_equal(solid.stress.x.array, everywhere)
    assert all(np.array_equal(solid.fields.values(name), good[name]) for name in names)
    solid.commit()
    taken = [f.x.array for f in solid.state.values()]
    assert all(np.isfinite(values).all() for values in taken)
    assert COMM.allreduce(sum(float(np.abs(values).sum()) for values in taken)) > 0.0


def test_output_fields():
    """Norms, components, averages and the plastic area agree with the stored components."""
    solid = create_loaded("quadrilateral")
    solid.evaluate()
    solid.commit()
    ep, s = solid.fields.values("plastic_strain"), solid.fields.values("stress")
    frobenius = np.sqrt((ep[..., :3] ** 2).sum(-1) + 2 * ep[..., 3] ** 2)
    assert np.allclose(solid.fields.values("plastic_strain_norm"), frobenius, rtol=1e-14)
    xx, yy, zz, xy = np.moveaxis(s, -1, 0)
    mises = np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2 + 6 * xy**2))
    assert np.allclose(solid.fields.values("von_mises"), mises, rtol=1e-12)
    largest = COMM.allreduce(mises.max(initial=0.0), op=MPI.MAX)
    assert np.isclose(solid.max("von_mises"), largest, rtol=1e-12)
    area = total((frobenius > 0) * solid.fields.weights)
    assert 0.1 < area < 1.9 and np.isclose(solid.plastic_area(), area, rtol=1e-14)
    average = solid.cell_values("stress")
    assert average is solid.cell_values("stress")
    form = fem.form(average[1] * ufl.dx)
    mean = COMM.allreduce(fem.assemble_scalar(form), op=MPI.SUM)
    assert np.isclose(mean, total(yy * solid.fields.weights), rtol=1e-12)


PLASTIC = ("plastic", "plastic_strain_norm", "plastic_strain_xy", "back_stress_norm", "hardening")


def test_what_plasticity_has_is_zero_in_elastic_bodies():
    """A script need not know the material; the shapes are those of plastic bodies."""
    solids = []
    for law in (STEEL, Elastic(STEEL.E, STEEL.nu)):
        solid = solid_on(create_domain("triangle"), law)
        solid.u.interpolate(lambda x: np.array([0.01 * x[1], 0.02 * x[1]]))
        solid.evaluate()
        solid.commit()
        solids.append(solid)
        for name in ("stress", "plastic_strain", "back_stress"):
            with rejected(f"'{name}' is a tensor", f"'{name}_norm'"):
                solid.max(name)
    plastic, elastic = solids
    assert elastic.linear and elastic.plastic_area() == 0.0
    assert not any("plastic" in name for name in elastic.fields.names)
    for name in (*PLASTIC, "back_stress_vector_norm"):
        assert plastic.max(name) > 0.0 and elastic.max(name) == 0.0
        assert elastic.fields.values(name).shape == plastic.fields.values(name).shape
        average = elastic.cell_values(name)
        assert average.ufl_shape == plastic.cell_values(name).ufl_shape
        assert not average.x.array.any()
