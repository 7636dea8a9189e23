# SPDX-License-Identifier: MIT
"""Results and committed state of a solid: what is shown when, and what a failure leaves."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem, la
from dolfinx_mortar.materials import Elastic
from dolfinx_mortar.materials.tensor import frobenius_norm, from_components
from dolfinx_mortar.solid.solid import Solid
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import (
    CELLS,
    COMM,
    STEEL,
    create_displacement,
    create_domain,
    create_loaded,
    create_tags,
    residual,
    set_wave,
    total,
)

pytestmark = pytest.mark.mpi


def test_state_changes_only_at_commit() -> None:
    """Assembly and output leave the state alone; a commit keeps the stress and dissipates energy.

    psi is the stored energy plus the dissipation Y |dep| of the step: a commit at the same u takes
    away just the latter. A second commit changes nothing.
    """
    solid = create_loaded("quadrilateral")
    before = solid.state["plastic_strain"].x.array.copy()
    forces = residual(solid)
    solid.assemble_tangent(solid.create_matrix())
    energy, ep = total(solid.energy()), solid.fields.values("plastic_strain")
    solid.evaluate()
    stress = solid.stress.x.array.copy()
    assert np.array_equal(solid.state["plastic_strain"].x.array, before)
    solid.commit()
    after = solid.state["plastic_strain"].x.array.copy()
    assert COMM.allreduce(float(np.abs(after - before).max()), op=MPI.MAX) > 1e-5
    flow = frobenius_norm(solid.fields.values("plastic_strain") - ep)
    dissipation = total(STEEL.Y * flow * solid.fields.weights)
    assert dissipation > 1e-3 * energy
    assert np.isclose(energy - total(solid.energy()), dissipation, rtol=1e-9)
    solid.evaluate()
    assert np.abs(solid.stress.x.array - stress).max(initial=0) < 1e-9 * STEEL.Y
    assert np.abs(residual(solid) - forces).max(initial=0) < 1e-9 * STEEL.Y
    solid.evaluate()
    solid.commit()
    assert np.array_equal(solid.state["plastic_strain"].x.array, after)


def shown(solid: Solid) -> dict[str, Any]:
    """Return all that shows results, as numbers."""
    written = {name: f.x.array.copy() for name, f in solid.output_fields().items()}
    values = {f"values {name}": solid.fields.values(name) for name in solid.fields.names}
    largest = {f"max {n}": solid.max(n) for n in ("von_mises", "plastic_strain_norm", "plastic")}
    return written | values | largest | {"area": solid.plastic_area(), "s": solid.stress.x.array}


@pytest.mark.parametrize("cell", CELLS)
def test_results_are_those_of_the_step_before_and_after_its_commit(cell: str) -> None:
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
    # the stress shown is that of the step: its forces are the residual's
    rule = {"quadrature_degree": solid.quadrature_degree, "quadrature_scheme": "default"}
    virtual = solid.kinematics.measure(ufl.TestFunction(solid.V))
    form = ufl.inner(from_components(solid.stress), virtual) * ufl.dx(metadata=rule)
    forces = fem.assemble_vector(fem.form(form))
    forces.scatter_reverse(la.InsertMode.add)
    expected = residual(solid)
    error = np.abs(forces.array[: len(expected)] - expected).max(initial=0.0)
    assert error < 1e-13 * np.abs(expected).max(initial=1.0)
    solid.commit()
    after = shown(solid)
    assert after.keys() == new.keys()
    assert all(np.array_equal(after[name], value) for name, value in new.items())
    changed = any(not np.array_equal(solid.state[n].x.array, committed[n]) for n in committed)
    assert COMM.allreduce(changed, op=MPI.LOR)


@dataclass(frozen=True)
class Logarithmic:
    """An elastic law with an internal variable that is undefined for negative parameters."""

    E: float
    nu: float
    c: float

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {"wear": ()}
    linear: ClassVar[bool] = True
    elastic_stress = staticmethod(Elastic.elastic_stress)
    energy = staticmethod(Elastic.energy)
    output = staticmethod(Elastic.output)

    @staticmethod
    def updated_state(eps: Any, state: Any, p: SimpleNamespace) -> dict[str, Any]:
        """Return ln c."""
        return {"wear": ufl.ln(p.c)}


def test_a_law_that_is_undefined_on_one_rank_is_an_error_on_all() -> None:
    """The message names the law and the variable, and the committed state is as before."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: 1 + (x[:, 0] + x[:, 1] < 0.3))
    laws = {1: Logarithmic(1.0, 0.3, 2.0), 2: Logarithmic(1.0, 0.3, -2.0)}
    solid = Solid(create_displacement(domain), laws, tags)
    with rejected("Logarithmic: wear is NaN or infinite at "):
        solid.evaluate()
    assert not solid.state["wear"].x.array.any()


@dataclass(frozen=True)
class Stretched(Logarithmic):
    """A law that is undefined where it is pressed together too much."""

    @staticmethod
    def updated_state(eps: Any, state: Any, p: SimpleNamespace) -> dict[str, Any]:
        """Return ln(1 + c eps_xx)."""
        return {"wear": ufl.ln(1 + p.c * eps[0, 0])}


def test_an_evaluation_that_fails_changes_nothing() -> None:
    """Neither what is shown nor what a later commit takes, on any rank, in any body."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: 1 + (x[:, 0] < 0.5))
    solid = Solid(create_displacement(domain), {1: STEEL, 2: Stretched(1.0, 0.3, 5.0)}, tags)
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


def test_output_fields() -> None:
    """Norms, components, averages and the plastic area agree with the stored components."""
    solid = create_loaded("quadrilateral")
    solid.evaluate()
    solid.commit()
    ep, s = solid.fields.values("plastic_strain"), solid.fields.values("stress")
    frobenius = np.sqrt((ep[..., :3] ** 2).sum(-1) + 2 * ep[..., 3] ** 2)
    assert np.allclose(solid.fields.values("plastic_strain_norm"), frobenius, rtol=1e-14)
    hardening = STEEL.a * np.sqrt((ep**2).sum(-1))
    assert np.allclose(solid.fields.values("hardening"), hardening, rtol=1e-14)
    assert np.array_equal(solid.fields.values("stress_xy"), s[..., 3])
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
    assert set(solid.fields.names) >= {"stress", "plastic_strain", "back_stress", "von_mises"}


PLASTIC = ("plastic", "plastic_strain_norm", "plastic_strain_xy", "back_stress_norm", "hardening")


def test_what_plasticity_has_is_zero_in_elastic_bodies() -> None:
    """A script need not know the material; the shapes are those of plastic bodies."""
    solids = []
    for law in (STEEL, Elastic(STEEL.E, STEEL.nu)):
        solid = Solid(create_displacement(create_domain("triangle")), law)
        solid.u.interpolate(lambda x: np.array([0.01 * x[1], 0.02 * x[1]]))
        solid.evaluate()
        solid.commit()
        solids.append(solid)
        for name in ("stress", "plastic_strain", "back_stress"):
            with rejected(f"'{name}' is a tensor", f"'{name}_norm'"):
                solid.max(name)
        for name in ("vonmises", "plastic_work", "stress_zy"):
            with rejected("no field", "von_mises"):
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
