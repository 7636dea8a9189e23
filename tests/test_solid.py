# SPDX-License-Identifier: MIT
"""The solid: derivatives, norms, committed state, several laws, recompilation, wrong input."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx.jit
import ffcx.codegeneration.jit
import ufl
from dolfinx import fem, la, mesh
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.materials.tensor import frobenius_norm, from_components
from dolfinx_mortar.solid.kinematics import kinematics_of_dimension
from dolfinx_mortar.solid.solid import Solid

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
STEEL = VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def create_domain(cell: str, n: int = 4) -> mesh.Mesh:
    """Create a box, not a cube, so that no direction is like another."""
    cell_type = mesh.CellType[cell]
    if cell in ("triangle", "quadrilateral"):
        return mesh.create_rectangle(COMM, [(0, 0), (1.0, 2.0)], (n, n + 1), cell_type)
    return mesh.create_box(COMM, [(0, 0, 0), (1.0, 2.0, 1.5)], (n, n, n - 1), cell_type)


def create_displacement(domain: mesh.Mesh) -> fem.Function:
    """Create a displacement in the degree 1 vector space."""
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,))))


def wave(size: float, phase: float = 0.0) -> Any:
    """Return a smooth field, the same on any number of ranks."""

    def values(x: np.ndarray) -> np.ndarray:
        parts = [np.sin((3 + i) * x[0] + (2 - i) * x[1] + x[2] + i + phase) for i in range(3)]
        return size * np.stack(parts)

    return values


def set_wave(f: fem.Function, size: float, phase: float = 0.0) -> None:
    """Interpolate a wave in as many components as f has."""
    d = f.function_space.mesh.geometry.dim
    f.interpolate(lambda x: wave(size, phase)(x)[:d])


def create_loaded(cell: str, n: int = 4) -> Solid:
    """Return a solid with some committed plastic strain, partly yielding at another u."""
    solid = Solid(create_displacement(create_domain(cell, n)), STEEL)
    set_wave(solid.u, 1.0e-3)
    solid.evaluate()
    solid.commit()
    set_wave(solid.u, 1.0e-3, 0.5)
    return solid


def residual(solid: Solid) -> np.ndarray:
    """Return the owned internal forces."""
    r = solid.u.x.petsc_vec.duplicate()
    solid.assemble_residual(r)
    return r.array.copy()


def total(values: np.ndarray) -> float:
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def plastic_share(solid: Solid) -> float:
    """Return the share of the volume that would yield at u, leaving the committed state alone."""
    before = solid.fields.values("plastic_strain")
    solid.evaluate()
    change = np.abs(solid.fields.values("plastic_strain") - before).max(axis=-1) > 0
    return total(change * solid.fields.weights) / total(solid.fields.weights)


@pytest.mark.parametrize("cell", CELLS)
def test_derivatives(cell: str) -> None:
    """F is the derivative of the energy, K that of F, at a partly plastic state; K is symmetric."""
    solid = create_loaded(cell)
    assert 0.05 < plastic_share(solid) < 0.98
    direction = fem.Function(solid.V)
    set_wave(direction, 1.0, 2.0)
    start, h = solid.u.x.array.copy(), 1e-8
    owned = len(residual(solid))

    def along(t: float) -> tuple[float, np.ndarray]:
        solid.u.x.array[:] = start + t * direction.x.array
        return solid.energy(), residual(solid)

    forces = along(0.0)[1]
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    product = K.createVecLeft()
    K.mult(direction.x.petsc_vec, product)
    (e1, f1), (e0, f0) = along(h), along(-h)
    power = total(forces * direction.x.array[:owned])
    assert abs((e1 - e0) / (2 * h) - power) < 1e-6 * abs(power)
    difference = (f1 - f0) / (2 * h) - product.array
    assert total(difference**2) < 1e-12 * total(product.array**2)
    skew = K.duplicate(copy=True)
    skew.axpy(-1.0, PETSc.Mat().createTranspose(K).convert("aij"))
    assert skew.norm() < 1e-13 * K.norm()


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
    form = (
        ufl.inner(
            from_components(solid.stress), kinematics_of_dimension(d).measure(ufl.TestFunction(W))
        )
        * dx
    )
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


def test_state_changes_only_at_commit() -> None:
    """Assembly and output leave the state alone; a commit keeps the stress and dissipates energy.

    psi is the stored energy plus the dissipation Y |dep| of the step: a commit at the same u takes
    away just the latter. A second commit changes nothing.
    """
    solid = create_loaded("quadrilateral")
    before = solid.state["plastic_strain"].x.array.copy()
    forces = residual(solid)
    solid.assemble_tangent(solid.create_matrix())
    energy, ep = solid.energy(), solid.fields.values("plastic_strain")
    solid.evaluate()
    stress = solid.stress.x.array.copy()
    assert np.array_equal(solid.state["plastic_strain"].x.array, before)
    solid.commit()
    after = solid.state["plastic_strain"].x.array.copy()
    assert COMM.allreduce(float(np.abs(after - before).max()), op=MPI.MAX) > 1e-5
    flow = frobenius_norm(solid.fields.values("plastic_strain") - ep)
    dissipation = total(STEEL.Y * flow * solid.fields.weights)
    assert dissipation > 1e-3 * energy
    assert np.isclose(energy - solid.energy(), dissipation, rtol=1e-9)
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
    with pytest.raises(
        ValueError, match=r"Logarithmic: wear is NaN or infinite at \d+ integration"
    ):
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
    with pytest.raises(ValueError, match="Stretched: wear is NaN or infinite"):
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
    with pytest.raises(ValueError, match="von_mises"):
        solid.max("temperature")


def test_elastic_solid_has_no_plastic_area() -> None:
    """An elastic solid is linear and names no plastic field."""
    solid = Solid(create_displacement(create_domain("triangle")), Elastic(1.0, 0.3))
    solid.evaluate()
    solid.commit()
    assert solid.linear and solid.plastic_area() == 0.0
    assert not any("plastic" in name for name in solid.fields.names)


def create_tags(domain: mesh.Mesh, values: Any) -> mesh.MeshTags:
    """Tag all local cells by a function of the midpoints (cells, 3) -> int32."""
    cells = domain.topology.index_map(domain.topology.dim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    midpoints = mesh.compute_midpoints(domain, domain.topology.dim, every)
    return mesh.meshtags(domain, domain.topology.dim, every, values(midpoints).astype(np.int32))


def test_materials_by_tag() -> None:
    """Parameters and laws follow the tags: elastic is von Mises that never yields."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: np.where(x[:, 1] < 1.0, 7, np.where(x[:, 0] < 0.5, 2, 30)))
    soft = VonMises(E=50_000.0, nu=0.4, Y=200.0, a=0.0)
    never = VonMises(E=100_000.0, nu=0.1, Y=1e9, a=1.0)
    results = []
    for laws in (
        {2: soft, 7: STEEL, 30: never},
        {30: Elastic(never.E, never.nu), 7: STEEL, 2: soft},
    ):
        solid = Solid(create_displacement(domain), laws, tags)
        set_wave(solid.u, 2e-3)
        solid.evaluate()
        solid.commit()
        set_wave(solid.u, 2e-3, 0.7)
        K = solid.create_matrix()
        solid.assemble_tangent(K)
        solid.evaluate()
        norms = [solid.max(n) for n in ("von_mises", "back_stress_norm", "plastic_strain_norm")]
        forces = np.sqrt(total(residual(solid) ** 2))
        numbers = [solid.energy(), K.norm(), forces, solid.elastic_norm(solid.u), *norms]
        results.append([*numbers, solid.element_force_norm(), solid.plastic_area()])
        assert not solid.linear
    assert np.allclose(*results, rtol=1e-11)


@dataclass(frozen=True)
class StressOnly:
    """An elastic law that states its stress and has no potential."""

    E: float
    nu: float

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = True
    elastic_stress = staticmethod(Elastic.elastic_stress)
    updated_state = staticmethod(Elastic.updated_state)
    output = staticmethod(Elastic.output)

    @staticmethod
    def stress(eps: Any, state: Mapping[str, Any], p: SimpleNamespace) -> Any:
        """Return C : eps."""
        return Elastic.elastic_stress(eps, p)


def test_law_that_gives_its_stress() -> None:
    """A law may give the stress instead of an energy; only the energy is then missing."""
    domain = create_domain("quadrilateral")
    forces = []
    for law in (StressOnly(3.0, 0.2), Elastic(3.0, 0.2)):
        solid = Solid(create_displacement(domain), law)
        set_wave(solid.u, 1e-3)
        forces.append(residual(solid))
        if law.__class__ is StressOnly:
            with pytest.raises(ValueError, match="energy"):
                solid.energy()
    assert np.allclose(*forces, rtol=0, atol=1e-13 * np.abs(forces[1]).max(initial=1e-9))


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

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a form was compiled")

    monkeypatch.setattr(ffcx.codegeneration.jit, "_compile_objects", refuse)
    for i in range(1, 4):
        use(4 + i, 10 * i, 10.0**i)


def test_a_step_compiles_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that it calls is there when the solid is made: even what is compiled costs a look-up."""
    solid = Solid(create_displacement(create_domain("triangle")), STEEL)

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a form or expression was created")

    monkeypatch.setattr(dolfinx.jit, "ffcx_jit", refuse)
    set_wave(solid.u, 1e-2)
    residual(solid)
    solid.assemble_tangent(solid.create_matrix())
    assert min(solid.energy(), solid.elastic_norm(solid.u), solid.element_force_norm()) > 0.0
    solid.evaluate()
    solid.commit()
    assert solid.max("plastic_strain_norm") > 0.0
    with pytest.raises(AssertionError, match="was created"):
        solid.plastic_area()  # the refusal works


def test_units_of_length() -> None:
    """With all lengths scaled, energies scale and the dimensionless results stay."""
    results = []
    for scale in (1e-6, 1.0, 1e6):
        domain = create_domain("triangle")
        solid = Solid(create_displacement(domain), STEEL)
        set_wave(solid.u, 1.5e-3)
        solid.u.x.array[:] *= scale
        domain.geometry.x[:] *= scale
        energy = solid.energy() / scale**2
        solid.evaluate()
        solid.commit()
        area = solid.plastic_area() / scale**2
        results.append([energy, area, solid.max("plastic_strain_norm")])
    assert np.allclose(results, results[1], rtol=1e-11)


def wrong_spaces() -> list[tuple[str, Any]]:
    """Return what a message should say, with a displacement in the wrong space."""
    domain = create_domain("triangle")
    return [
        (r"shape \(\)", fem.Function(fem.functionspace(domain, ("Lagrange", 1)))),
        (r"shape \(3,\)", fem.Function(fem.functionspace(domain, ("Lagrange", 1, (3,))))),
        ("degree 2", fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))),
        ("continuous", fem.Function(fem.functionspace(domain, ("DG", 1, (2,))))),
        ("dolfinx.fem.Function", 3.0),
    ]


@pytest.mark.parametrize("case", range(5))
def test_wrong_displacement(case: int) -> None:
    """A displacement that is not one is refused on all ranks."""
    message, u = wrong_spaces()[case]
    with pytest.raises(ValueError, match=message):
        Solid(u, STEEL)


def test_wrong_tags() -> None:
    """Tags and materials that do not cover each other are refused on all ranks."""
    domain, other = create_domain("triangle"), create_domain("triangle")
    u = create_displacement(domain)
    tags = create_tags(domain, lambda x: 1 + (x[:, 1] > 1.0))
    owned = domain.topology.index_map(2).size_local
    count = int(total(tags.values[:owned] == 2))
    with pytest.raises(ValueError, match=rf"{count} cells have no material \(tag 2\)"):
        Solid(u, {1: STEEL}, tags)
    with pytest.raises(ValueError, match="tag 5 marks no cell"):
        Solid(u, {1: STEEL, 2: STEEL, 5: STEEL}, tags)
    with pytest.raises(ValueError, match="cell_tags"):
        Solid(u, {1: STEEL})
    with pytest.raises(ValueError, match="another mesh"):
        Solid(u, {1: STEEL, 2: STEEL}, create_tags(other, lambda x: 1 + (x[:, 1] > 1.0)))
    none = np.zeros(0, dtype=np.int32)
    with pytest.raises(ValueError, match=r"40 cells have no material \(no tag\)"):
        Solid(u, {1: STEEL}, mesh.meshtags(domain, 2, none, none))
    with pytest.raises(ValueError, match="cell_tags"):
        Solid(u, {1: STEEL}, mesh.meshtags(domain, 1, none, none))
    with pytest.raises(ValueError, match="not a material"):
        Solid(u, {1: STEEL, 2: VonMises}, tags)
    with pytest.raises(ValueError, match="not a material"):
        Solid(u, 206_900.0)


def test_tags_of_owned_cells_suffice() -> None:
    """Ghost cells take the material of their owner, so tags need not list them."""
    domain = create_domain("triangle")
    owned = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    tags = mesh.meshtags(domain, 2, owned, np.full(len(owned), 3, dtype=np.int32))
    solids = [Solid(create_displacement(domain), *m) for m in (({3: STEEL}, tags), (STEEL, None))]
    for solid in solids:
        set_wave(solid.u, 2e-3)
    assert np.isclose(solids[0].energy(), solids[1].energy(), rtol=1e-14)
