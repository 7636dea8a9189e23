# SPDX-License-Identifier: MIT
"""The solid: derivatives, norms, quadrature, what is compiled and when, units."""

from typing import Any

import numpy as np
import pytest

import dolfinx.jit
import ffcx.codegeneration.jit
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar import compat
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.materials.tensor import from_components
from dolfinx_mortar.solid.kinematics import kinematics_of_dimension
from dolfinx_mortar.solid.solid import Solid
from tests.cases.solid import (
    CELLS,
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


def test_tangent_lies_between_its_bounds() -> None:
    """a/(2 mu + a) K_e <= K <= K_e along random directions."""
    solid = create_loaded("triangle", 8)
    elastic = Solid(create_displacement(solid.mesh), Elastic(STEEL.E, STEEL.nu))
    K, K_e = solid.create_matrix(), elastic.create_matrix()
    solid.assemble_tangent(K)
    elastic.assemble_tangent(K_e)
    v = fem.Function(solid.V)
    product = K.createVecLeft()
    lower = STEEL.a / (STEEL.E / (1 + STEEL.nu) + STEEL.a)
    for seed in range(20):
        set_wave(v, 1.0, 0.3 * seed)
        values = []
        for matrix in (K, K_e):
            matrix.mult(v.x.petsc_vec, product)
            values.append(product.dot(v.x.petsc_vec))
        assert lower < values[0] / values[1] < 1 - 1e-3
        assert np.isclose(solid.elastic_norm(v) ** 2, values[1], rtol=1e-12)


@pytest.mark.parametrize("cell", CELLS)
def test_element_force_norm(cell: str) -> None:
    """On simplices it is the norm of the forces assembled in a space without continuity."""
    solid = create_loaded(cell)
    solid.evaluate()
    d = solid.mesh.geometry.dim
    W = fem.functionspace(solid.mesh, ("Discontinuous Lagrange", 1, (d,)))
    rule = {"quadrature_degree": solid.quadrature_degree, "quadrature_scheme": "default"}
    dx = ufl.dx(metadata=rule)
    virtual = kinematics_of_dimension(d).measure(ufl.TestFunction(W))
    form = ufl.inner(from_components(solid.stress), virtual) * dx
    forces = fem.assemble_vector(fem.form(form)).array
    expected = np.sqrt(total(forces[: d * W.dofmap.index_map.size_local] ** 2))
    simplex = cell in ("triangle", "tetrahedron")
    assert np.isclose(solid.element_force_norm(), expected, rtol=1e-10 if simplex else 0.5)
    assert np.sqrt(total(residual(solid) ** 2)) < 3 * expected


def test_default_quadrature() -> None:
    """One point on simplices, 2 x 2 and 2 x 2 x 2 elsewhere; weights sum to the volume."""
    for cell, points, volume in zip(CELLS, (1, 4, 1, 8), (2.0, 2.0, 3.0, 3.0), strict=True):
        solid = Solid(create_displacement(create_domain(cell, 2)), STEEL)
        assert solid.fields.weights.shape[1] == points
        assert np.isclose(total(solid.fields.weights), volume, rtol=1e-13)
    richer = Solid(create_displacement(create_domain("triangle")), STEEL, quadrature_degree=2)
    assert richer.fields.weights.shape[1] == 3


def refuse(*_: Any, **__: Any) -> None:
    raise AssertionError("a form or expression was created")


def test_nothing_is_compiled_for_other_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other parameters, tags, meshes of the same cells and the steps themselves compile nothing."""

    def use(n: int, first: int, scale: float) -> None:
        domain = create_domain("triangle", n)
        tags = create_tags(domain, lambda x: first + (x[:, 0] > 0.3) + (x[:, 1] > 0.7))
        hard = VonMises(scale * STEEL.E, 0.2, scale * STEEL.Y, 0.0)
        laws = {first: STEEL, first + 1: Elastic(scale, 0.1), first + 2: hard}
        for materials, cell_tags in ((laws, tags), (hard, None)):
            solid = Solid(create_displacement(domain), materials, cell_tags)
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


def test_a_step_compiles_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that it calls is there when the solid is made: even what is compiled costs a look-up."""
    solid = Solid(create_displacement(create_domain("triangle")), STEEL)

    for name in ("compile_forms", "compile_expressions"):
        monkeypatch.setattr(ffcx.codegeneration.jit, name, refuse)
    set_wave(solid.u, 1e-2)
    residual(solid)
    solid.assemble_tangent(solid.create_matrix())
    assert min(total(solid.energy()), solid.elastic_norm(solid.u), solid.element_force_norm()) > 0.0
    solid.evaluate()
    solid.commit()
    assert solid.max("plastic_strain_norm") > 0.0
    assert solid.plastic_area() > 0.0 and solid.gradients.evaluate().left_out.any()
    with pytest.raises((AssertionError, RuntimeError), match=r"was created|on root node"):
        fem.form(ufl.div(solid.u) * ufl.dx)  # the refusal works


def test_only_sums_of_the_tangent_may_be_reordered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's options of the compiler hold for all forms."""
    given = []
    compile_forms = ffcx.codegeneration.jit.compile_forms

    def look(forms: list[ufl.Form], *args: Any, **others: Any) -> Any:
        options = set(others["cffi_extra_compile_args"])
        given.extend((len(form.arguments()), options) for form in forms)
        return compile_forms(forms, *args, **others)

    monkeypatch.setattr(ffcx.codegeneration.jit, "compile_forms", look)
    Solid(create_displacement(create_domain("triangle")), STEEL)
    usual = set(dolfinx.jit.get_options()["cffi_extra_compile_args"])
    assert {arguments for arguments, _ in given} == {0, 1, 2} and usual
    sums = {"-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-funroll-loops"}
    for arguments, options in given:
        assert options == (usual | sums if arguments == 2 else usual)


@pytest.mark.parametrize(
    ("given", "modules"),
    [
        # weights, tangent; forces, two norms and energy
        ({}, [1, 1, 4]),
        # B, volumes and moduli of the cells
        ({"volumetric": "reduced"}, [1, 1, 3, 4]),
        # products of the functions of a cell; B, volumes, moduli, energy and two derivatives
        ({"volumetric": "reduced", "strain": "finite"}, [1, 1, 1, 4, 6]),
    ],
)
def test_forms_of_a_law_are_one_module(
    given: dict[str, str], modules: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler starts once for what a law, the strain and the element determine together."""
    sizes = []
    compile_forms = ffcx.codegeneration.jit.compile_forms

    def count(forms: list[ufl.Form], *args: Any, **others: Any) -> Any:
        sizes.append(len(forms))
        return compile_forms(forms, *args, **others)

    def count_expressions(*args: Any, **others: Any) -> Any:
        sizes.append(0)
        return compile_expressions(*args, **others)

    compile_expressions = ffcx.codegeneration.jit.compile_expressions
    monkeypatch.setattr(ffcx.codegeneration.jit, "compile_forms", count)
    monkeypatch.setattr(ffcx.codegeneration.jit, "compile_expressions", count_expressions)
    Solid(create_displacement(create_domain("quadrilateral")), STEEL, **given)  # type: ignore[arg-type]
    assert sorted(filter(None, sizes)) == modules
    # stress and state; strain and rotation, which all laws share
    assert given.get("strain") or sizes.count(0) == 2


def test_forms_of_one_module_are_those_compiled_alone() -> None:
    """To the last bit, with marked cells, Constants, and a Function that drops out of a form."""
    V = create_displacement(create_domain("triangle")).function_space
    u, other = (fem.Function(V) for _ in range(2))
    for phase, f in enumerate((u, other)):
        set_wave(f, 1e-2, phase)
    cells = np.arange(V.mesh.topology.index_map(2).size_local, dtype=np.int32)
    dx = ufl.Measure("dx", V.mesh, subdomain_data=[(0, cells[::2]), (1, cells[1::2])])
    v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
    a, b = (fem.Constant(V.mesh, default_scalar_type(value)) for value in (0.7, 1.9))
    energy = a * ufl.exp(ufl.inner(ufl.grad(u), ufl.grad(u))) * dx(0) + b * ufl.dot(u, u) * dx(1)
    linear = ufl.derivative(ufl.dot(other, other) * u[0] * ufl.dx, u, v)
    forms = [energy, ufl.derivative(energy, u, v), linear, ufl.derivative(ufl.dot(u, w) * dx, u, v)]
    alone, together = [fem.form(form) for form in forms], compat.compile_together(*forms)
    assert len({form.module for form in together}) == 1
    for f, g in zip(alone, together, strict=True):
        first, second = numbers_of(f), numbers_of(g)
        assert np.array_equal(first, second) and total(float(np.abs(first).sum())) > 0.0


def numbers_of(form: fem.Form) -> np.ndarray:
    """Return what this rank assembles of a form."""
    if form.rank == 0:
        return np.array([fem.assemble_scalar(form)])
    if form.rank == 1:
        return np.asarray(fem.assemble_vector(form).array)
    return np.asarray(fem.assemble_matrix(form).data)


def test_units_of_length() -> None:
    """With all lengths scaled, energies scale and the dimensionless results stay."""
    results = []
    for scale in (1e-6, 1.0, 1e6):
        domain = create_domain("triangle")
        solid = Solid(create_displacement(domain), STEEL)
        set_wave(solid.u, 1.5e-3)
        solid.u.x.array[:] *= scale
        domain.geometry.x[:] *= scale
        energy = total(solid.energy()) / scale**2
        solid.evaluate()
        solid.commit()
        area = solid.plastic_area() / scale**2
        results.append([energy, area, solid.max("plastic_strain_norm")])
    assert np.allclose(results, results[1], rtol=1e-11)
