# SPDX-License-Identifier: MIT
"""Finite strain through the whole package: patch, turns, derivatives, bifurcation, volumes."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, two_blocks
from tests.cases.pressed_blocks import COMM, rejected
from tests.cases.solid import create_displacement, create_domain, residual, set_wave
from tests.test_finite_laws import OGDEN, Arrays

E, NU = 1000.0, 0.3
RUBBER = dm.NeoHooke(E, NU)


def rotation(angle):
    """Return the matrix that turns by degrees."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([[c, -s], [s, c]])


class Blocks:
    """Two blocks whose outer sides are placed, as a whole or in their normal direction only."""

    def __init__(self, law=RUBBER, sliding=False, **options):
        """Create the blocks; the options are those of `two_blocks`."""
        self.mesh, _, self.facets = two_blocks(COMM, **options)
        V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u, self.low, self.high = (fem.Function(V) for _ in range(3))
        placed = [(self.low, BOTTOM), (self.high, TOP)]
        bcs = []
        for f, tag in placed:
            found = self.facets.find(tag)
            if sliding:
                sub = V.sub(1)
                dofs = fem.locate_dofs_topological(sub, 1, found)
                f = fem.Constant(self.mesh, default_scalar_type(0.0))
                bcs.append(fem.dirichletbc(f, dofs, sub))
            else:
                bcs.append(fem.dirichletbc(f, fem.locate_dofs_topological(V, 1, found)))
        if sliding:
            self.height = f
            left = mesh.locate_entities_boundary(self.mesh, 1, lambda x: np.isclose(x[0], 0.0))
            dofs = fem.locate_dofs_topological(V.sub(0), 1, left)
            bcs.append(fem.dirichletbc(default_scalar_type(0.0), dofs, V.sub(0)))
        self.solid = dm.Solid(self.u, law, strain="finite")
        contact = dm.Contact(self.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
        self.problem = dm.ContactProblem(self.solid, [contact], bcs=bcs)

    def place(self, angle, down):
        R = rotation(angle)
        self.low.interpolate(lambda x: R @ x[:2] - x[:2])
        self.high.interpolate(lambda x: R @ (x[:2] - np.array([[0.0], [down]])) - x[:2])

    def step(self, rtol=1e-6):
        report = dm.newton(self.problem, rtol=rtol)
        self.problem.commit()
        return report


@pytest.mark.parametrize("law", [RUBBER, Arrays(E, NU)], ids=["UFL", "arrays"])
def test_patch_at_40_percent_compression(law):
    """Uniform stress in closed form through the contact, in one step, with a quadratic tail."""
    blocks = Blocks(law, sliding=True)
    blocks.height.value = -0.4 * 2.0
    report = blocks.step(rtol=1e-10)
    mu, lam, b = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU), 0.6
    a = brentq(lambda a: mu * (a - 1 / a) + lam * np.log(a * b) / a, 1.0, 2.0, xtol=1e-14)
    pressure = (mu * (b - 1 / b) + lam * np.log(a * b) / b) / a
    stress = blocks.solid.fields.values("stress").reshape(-1, 4)
    np.testing.assert_allclose(stress[:, 1], pressure, rtol=1e-9)
    assert abs(stress[:, [0, 3]]).max(initial=0.0) < 1e-9 * abs(pressure)
    np.testing.assert_allclose(blocks.solid.fields.values("J"), a * b, rtol=1e-10)
    forces = [it.force_residual for it in report.iterations]
    assert len(forces) <= 7
    assert forces[-2] < 10 * forces[-3] ** 2  # Newton's method is quadratic
    assert report.certificate.smallest_J == pytest.approx(a * b, rel=1e-10)


@pytest.mark.parametrize("angle", [90.0, 200.0])
def test_everything_turned_in_one_step(angle):
    """Forces, and moments about the origin, turn with the bodies to round-off."""
    shape = {"n_upper": (3, 2), "n_lower": (9, 3), "x_lower": (-1.0, 2.0), "heights": (1.0, 0.6)}
    blocks = Blocks(**shape)
    blocks.place(0.0, 0.05)
    blocks.step(rtol=1e-12)
    before, J = dm.reaction(blocks.problem, TOP), blocks.solid.fields.values("J").copy()
    blocks.place(angle, 0.05)
    report = blocks.step(rtol=1e-12)
    after = dm.reaction(blocks.problem, TOP)
    size = np.linalg.norm(before.force)
    assert np.abs(after.force - rotation(angle) @ before.force).max() < 1e-10 * size
    assert abs(after.moment - before.moment) < 1e-10 * size
    assert report.newton_iterations <= 2
    np.testing.assert_allclose(blocks.solid.fields.values("J"), J, rtol=1e-10)
    assert report.certificate.internal_moment < 1e-13


HARD = dm.MooneyRivlin(10.0, 5.0, 1e3)
CASES = [
    *((cell, None, law, "full") for cell in ("triangle", "hexahedron") for law in (RUBBER, OGDEN)),
    *(("quadrilateral", k, RUBBER, v) for k in (None, "axisymmetric") for v in ("full", "reduced")),
    ("hexahedron", None, HARD, "reduced"),
    *(("quadrilateral of degree 2", k, HARD, "reduced") for k in (None, "axisymmetric")),
    ("hexahedron of degree 2", None, HARD, "reduced"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "kinematics", "law", "volumetric"), CASES)
def test_forces_and_tangent_are_derivatives(cell, kinematics, law, volumetric):
    """Of the energy, by central differences, at a displacement with J from about .7 to 1.4."""
    cell, _, degree = cell.partition(" of degree ")
    domain = create_domain(cell, 2)
    shape = (domain.geometry.dim,)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", int(degree or 1), shape)))
    how = {"kinematics": kinematics, "volumetric": volumetric}
    solid = dm.Solid(u, law, strain="finite", **how)
    across = fem.Function(u.function_space)
    for f, size, phase in ((u, 0.06, 0.0), (across, 1.0, 0.7)):
        set_wave(f, size, phase)
        if kinematics:  # the axis stays
            x = u.function_space.tabulate_dof_coordinates()[:, 0]
            f.x.array[0::2] *= x
    start, K = u.x.array.copy(), solid.create_matrix()
    solid.assemble_tangent(K)
    forces, change = residual(solid), (K * across.x.petsc_vec).array.copy()
    work = COMM.allreduce(forces @ across.x.array[: len(forces)])

    def at(t):
        u.x.array[:] = start + t * across.x.array
        energy = np.sum(solid.energy())
        return COMM.allreduce(energy), residual(solid)

    t = 1e-5
    (above, F), (below, G) = at(t), at(-t)
    size = COMM.allreduce(np.abs(change).max(initial=0.0), op=dm_max())
    assert (above - below) / (2 * t) == pytest.approx(work, rel=1e-7)
    assert np.abs((F - G) / (2 * t) - change).max(initial=0.0) < 1e-7 * size
    assert solid.linear is False and solid.strain == "finite"


def dm_max():
    """Return the operation of the largest value."""
    return MPI.MAX


def test_cells_that_invert_shorten_the_step():
    """A push by 90 percent in one step: Newton's first step turns cells over; shorter ones end."""
    domain = mesh.create_rectangle(COMM, [(0.0, 0.0), (1.0, 1.0)], (4, 4))
    u = create_displacement(domain)
    V, move = u.function_space, fem.Constant(domain, default_scalar_type((0.0, 0.0)))
    sides = []
    for y in (0.0, 1.0):
        facets = mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        sides.append(fem.locate_dofs_topological(V, 1, facets))
    zero = np.zeros(2, dtype=default_scalar_type)
    bcs = [fem.dirichletbc(zero, sides[0], V), fem.dirichletbc(move, sides[1], V)]
    solid = dm.Solid(u, RUBBER, strain="finite")
    problem = dm.ContactProblem(solid, [], bcs=bcs)
    move.value[1] = -1.5  # the top below the bottom: impossible
    with pytest.raises(dm.NewtonNotConverged, match=r"turned inside out.*cell \d+ of the input"):
        dm.newton(problem)
    assert not u.x.array.any()  # as before the step
    move.value[1] = -0.6
    report = dm.newton(problem, max_it=60)
    assert 0.0 < report.certificate.smallest_J < 1.0


def column(imperfection, options=None):
    """Return a slender column that its top, free to move aside, is pressed down on.

    The options are those of PETSc.
    """
    domain = mesh.create_rectangle(
        COMM, [(0.0, 0.0), (0.1, 1.0)], (2, 20), mesh.CellType.quadrilateral
    )
    x = domain.geometry.x
    x[:, 0] += imperfection * np.sin(np.pi * x[:, 1] / 2)
    u = create_displacement(domain)
    V, down = u.function_space, fem.Constant(domain, default_scalar_type(0.0))
    ends = [
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (0.0, 1.0)
    ]
    foot = fem.locate_dofs_topological(V, 1, ends[0])
    top = fem.locate_dofs_topological(V.sub(1), 1, ends[1])
    zero = np.zeros(2, dtype=default_scalar_type)
    bcs = [fem.dirichletbc(zero, foot, V), fem.dirichletbc(down, top, V.sub(1))]
    solid = dm.Solid(u, RUBBER, strain="finite", volumetric="reduced")
    return dm.ContactProblem(solid, [], bcs=bcs, petsc_options=options), down


def test_an_indefinite_tangent_is_made_convex():
    """A column far beyond its critical load bends aside, in one step; the shift is gone then."""
    problem, down = column(1e-3)
    down.value = -0.1
    report = dm.newton(problem, max_it=60)
    shifts = [it.shift for it in report.iterations]
    assert max(shifts) > 0.0 and shifts[-1] == 0.0
    assert COMM.allreduce(np.abs(problem.u.x.array[0::2]).max(initial=0.0), op=dm_max()) > 0.3
    assert any("indefinite" in note for note in report.notes)
    assert not any("unstable" in note or "degree 2" in note for note in report.notes)


PETSC = {"pc_type": "cholesky", "pc_factor_mat_solver_type": "petsc"}


@pytest.mark.serial  # PETSc's own factorisation is
@pytest.mark.parametrize("options", [None, {"pc_type": "lu"}, PETSC])
def test_an_unstable_balance_is_told(options):
    """Whatever factorises: only MUMPS for symmetric matrices counts negative pivots."""
    problem, down = column(0.0, options)
    down.value = -0.05
    assert any("unstable" in note for note in dm.newton(problem).notes)


def shallow_arch(rise=0.1, n=24):
    """Return a shallow arch whose ends are held: its mesh, a displacement and the support."""
    domain = mesh.create_rectangle(
        COMM, [(-1.0, 0.0), (1.0, 0.05)], (n, 1), mesh.CellType.quadrilateral
    )
    x = domain.geometry.x
    x[:, 1] += rise * np.cos(np.pi * x[:, 0] / 2)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    ends = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(abs(x[0]), 1.0))
    held = fem.locate_dofs_topological(u.function_space, 1, ends)
    zero = np.zeros(2, dtype=default_scalar_type)
    return domain, u, fem.dirichletbc(zero, held, u.function_space)


@pytest.mark.slow
def test_limit_points_pass_under_displacement_control():
    """A shallow arch, pressed down through its flat shape: the force falls and rises again."""
    domain, u, support = shallow_arch()
    V, down = u.function_space, fem.Constant(domain, default_scalar_type(0.0))
    Vy, _ = V.sub(1).collapse()
    crown = fem.locate_dofs_geometrical(
        (V.sub(1), Vy), lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 0.15)
    )[0]
    bcs = [support, fem.dirichletbc(down, crown, V.sub(1))]
    solid = dm.Solid(u, RUBBER, strain="finite")
    problem = dm.ContactProblem(solid, [], bcs=bcs)
    forces = []
    for depth in (0.03, 0.06, 0.1, 0.2):
        down.value = -depth
        dm.newton(problem)
        problem.commit()
        forces.append(-dm.reaction(problem, bcs[1]).force[1])
    assert forces[0] < forces[1] > forces[2] < forces[3]


def test_a_tool_passes_a_limit_point():
    """It presses an arch at its crown. Open contacts leave the tangent indefinite.

    That the condensed QP tells, not the pivots. Without a shift the interior point took over: the
    last steps had 27 iterations, or failed.
    """
    domain, u, support = shallow_arch(0.3, 16)
    found = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] > -1.0)
    x, y, _ = mesh.compute_midpoints(domain, 1, found).T
    found = np.sort(found[y - 0.3 * np.cos(np.pi / 2 * x) > 0.04])
    tags = mesh.meshtags(domain, 1, found, np.full(len(found), 1, dtype=np.int32))
    tool = dm.Obstacle(tags, slave=1, shape=dm.shapes.Cylinder((0.0, 0.55), 0.2))
    solid = dm.Solid(u, RUBBER, strain="finite")
    problem = dm.ContactProblem(solid, [tool], bcs=[support])
    forces, iterations = [], []
    for depth in (0.04, 0.08, 0.12, 0.16, 0.2, 0.24):
        tool.position.value[1] = 0.55 - depth
        iterations.append(dm.newton(problem).newton_iterations)
        problem.commit()
        forces.append(abs(tool.force[1]))
    assert max(iterations) <= 6
    assert forces[0] < forces[1] > 1.3 * forces[5]


def test_loads_that_turn_a_limit_point():
    """The arch under its weight: it snaps through between .03 and .04.

    The balance found is that of a walk down from a larger load.
    """
    domain, u, support = shallow_arch()
    weight = fem.Constant(domain, default_scalar_type(0.0))
    loads = -20.0 * weight * ufl.TestFunction(u.function_space)[1] * ufl.dx
    solid = dm.Solid(u, RUBBER, strain="finite")
    problem = dm.ContactProblem(solid, [], bcs=[support], loads=loads)
    lowest = []
    for q in (0.02, 0.03, 0.04, 0.05, 0.1, 0.04):
        weight.value = q
        dm.newton(problem, rtol=1e-9)
        problem.commit()
        lowest.append(min(COMM.allgather(u.x.array.min(initial=0.0))))
    assert lowest[1] > -0.06 and lowest[2] < -0.15
    assert lowest[5] == pytest.approx(lowest[2], rel=1e-5)


def test_what_finite_strain_does_not_go_with():
    u = create_displacement(create_domain("triangle", 2))
    with rejected("strain", "'small' or 'finite'"):
        dm.Solid(u, RUBBER, strain="large")
    with rejected("eigenstrain", "finite"):
        dm.Solid(u, RUBBER, strain="finite", eigenstrain=0.01)
    with rejected("NeoHooke", "strain='finite'"):
        dm.Solid(u, RUBBER)
