# SPDX-License-Identifier: MIT
"""Terms of users: those of the guide against closed forms, restart, ranks, and what goes wrong."""

import re
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.steps import walk as stepping
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, Blocks
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import COMM, errors_of_derivatives, set_wave, total

pytestmark = pytest.mark.mpi
GUIDE = Path(__file__).parent.parent / "docs" / "guide" / "terms.md"
E, C = 1000.0, 40.0
LEVELS = [0.5, 1.0, 2.0, 2.5]


@pytest.fixture(scope="module")
def guide():
    """The classes of the guide, as its readers paste them."""
    names = {}
    for code in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL):
        exec(compile(code.split("\nds = ")[0], str(GUIDE), "exec"), names)
    return names


class Bar:
    """Squares beside each other whose tops are held, that of the last one moved along y by push."""

    def __init__(self, count=1, moved=0.0):
        b = self.blocks = Blocks([(3.0 * k, 3.0 * k + 1, 0.0, 1.0, 1, 1) for k in range(count)])
        self.mesh, self.V, self.u = b.mesh, b.V, b.u
        self.solid = dm.Solid(b.u, dm.Elastic(E, 0.0))
        self.push = fem.Constant(b.mesh, np.array([0.0, moved]))
        guides = [b.fix(1, side, component=0) for side in (EAST, WEST)]
        self.bcs = [b.fix(k, ABOVE) for k in range(1, count)] or guides
        self.bcs.append(b.fix(count, ABOVE, value=self.push))
        self.ds = ufl.Measure("ds", b.mesh, subdomain_data=b.facets)(10 + BELOW)

    def move(self, way):
        self.push.value[1] = way

    def problem(self, *terms, **options):
        return dm.ContactProblem(self.solid, bcs=self.bcs, terms=list(terms), **options)

    def bottom(self):
        """Return the displacement of the bottom, along y, which is the same at all its nodes."""
        n = self.V.dofmap.index_map.size_local
        x = self.V.tabulate_dof_coordinates()[:n]
        own = self.u.x.array.reshape(-1, 2)[:n, 1][np.isclose(x[:, 1], 0.0)]
        found = np.concatenate(COMM.allgather(own))
        assert np.ptp(found) < 1e-12
        return found[0]


def damped(levels):
    """Return the bottom's displacement: E (u_top - u) = c (u - u_n) / dt, a step at a time."""
    u, last, found = 0.0, 0.0, []
    for level in levels:
        rate = C / (level - last)
        u, last = (E * 0.01 * level + rate * u) / (E + rate), level
        found.append(u)
    return found


def test_a_damper_after_a_restart(guide, folder):
    """Its state is in the checkpoint: the steps after it are those of the whole walk."""
    file = folder / "run.h5"
    for levels in (LEVELS[:2], LEVELS):
        bar = Bar()
        problem = bar.problem(guide["Damper"](bar.solid, C, bar.ds))
        ramp = {bar.push: [(0.0, (0.0, 0.0)), (10.0, (0.0, 0.1))]}
        list(dm.load_steps(problem, levels, ramp=ramp, checkpoint=file))
    assert np.isclose(bar.bottom(), damped(LEVELS)[-1], rtol=1e-10)
    other = Bar()
    with pytest.raises(ValueError, match=r"a Damper: u_n is 'missing', in the .* 2"):
        other.problem().restore(file)


def test_a_floor(guide):
    """Pushed down by 0.3 onto a layer 0.1 below: E (0.3 - s) = k (s - 0.1)."""
    bar, k = Bar(moved=-0.3), 250.0
    forms = guide["floor"](bar.u, -0.1, k, bar.ds)
    dm.newton(bar.problem(dm.WeakForm(bar.solid, energy=forms)), rtol=1e-10)
    sunk = (E * 0.3 + k * 0.1) / (E + k)
    assert np.isclose(-bar.bottom(), sunk, rtol=1e-10)
    v = ufl.TestFunction(bar.V)
    bar.u.x.array[:] = 0.0
    residual = dm.WeakForm(bar.solid, residual=ufl.derivative(forms, bar.u, v))
    problem = bar.problem(residual)
    report = dm.newton(problem, rtol=1e-10)
    assert np.isclose(-bar.bottom(), sunk, rtol=1e-10) and report.converged
    bar.move(0.2)  # it lets go
    dm.newton(problem, rtol=1e-10)
    assert np.isclose(bar.bottom(), 0.2, rtol=1e-10)


def test_a_bed_of_springs_under_a_load():
    """A traction q, read at every assembly, presses the springs k = E by q / k."""
    bar = Bar()
    q, v = fem.Constant(bar.mesh, 0.0), ufl.TestFunction(bar.V)
    top = ufl.Measure("ds", bar.mesh, subdomain_data=bar.blocks.facets)(10 + ABOVE)
    springs = 0.5 * E * bar.u[1] ** 2 * bar.ds
    bar.bcs.pop()
    problem = bar.problem(loads=-q * v[1] * top, potential=springs)
    ((_, _), (_, bed)) = problem.terms.named
    for value in (5.0, 10.0):
        q.value = value
        dm.newton(problem, rtol=1e-12)
        problem.commit()
        assert np.isclose(bar.bottom(), -value / E, rtol=1e-11)
        assert np.isclose(total(bed.energy()), 0.5 * value**2 / E, rtol=1e-11)


def test_a_residual_without_potential(guide):
    """A pressure that grows with the rotation has no potential; Newton ends all the same."""
    bar = Bar(moved=-0.01)
    u, v = bar.u, ufl.TestFunction(bar.V)
    skew = 50.0 * (u[1] * v[0] + 0.0 * u[0] * v[1]) * bar.ds + 100.0 * u[1] * v[1] * bar.ds
    dm.newton(bar.problem(dm.WeakForm(bar.solid, residual=skew)), rtol=1e-10, max_it=99)
    assert np.isclose(bar.bottom(), -0.01 * E / (E + 100.0), rtol=1e-8)


def test_a_cable(guide):
    """Between the feet of two bars: its force is k times what it is longer, and both carry it."""
    k = 300.0
    bars = Bar(count=2, moved=-0.4)
    cable = guide["Cable"](bars.solid, (1.0, 0.0), (3.0, 0.0), k)
    problem = bars.problem(cable)
    assert np.isclose(cable.length, 2.0)
    report = dm.newton(problem, rtol=1e-11)
    t, _distance, more = cable.stretch()
    assert more > 1e-3 and report.newton_iterations < 9
    history = report.residual_history
    assert history[-1] < 1e-2 * history[-2] ** 1.5 or history[-1] < 1e-11  # not linear
    carried = dm.reaction(problem, bars.bcs[-1]).force[1]
    assert np.isclose(carried, k * more * t[1], rtol=1e-9)
    assert np.isclose(total(cable.energy()), 0.5 * k * more**2, rtol=1e-12)


def test_energy_forces_and_tangent_of_the_cable_fit(guide):
    bars = Bar(count=2)
    terms = bars.problem(guide["Cable"](bars.solid, (1.0, 0.0), (3.0, 0.0), 300.0)).terms
    v = fem.Function(bars.V)
    set_wave(bars.u, 0.1)
    set_wave(v, 0.1, 0.5)
    K = terms.create_matrix()
    terms.assemble_tangent(K)

    def forces():
        F = bars.u.x.petsc_vec.duplicate()
        terms.assemble_forces(F)
        return F.array.copy()

    energy = lambda: terms.energy().value / COMM.size  # noqa: E731
    assert max(errors_of_derivatives(bars.u, energy, forces, K, v, 1e-3)) < 1e-8


def test_a_cable_holds_a_body(guide):
    """The audit knows that a bar which nothing else holds along y hangs on a cable."""
    bars = Bar(count=2)
    bars.bcs[1:] = [bars.blocks.fix(2, side, component=0) for side in (EAST, WEST)]
    with pytest.raises(ValueError, match="nothing holds"):
        bars.problem().audit()
    cable = guide["Cable"](bars.solid, (1.0, 0.0), (3.0, 1.0), 300.0)  # aslant
    bars.problem(cable).audit()


def giving(name, usual=None):
    """Return a method that gives what a term is told to, or what is usual."""

    def method(self, *arguments):
        value = self.give(name)
        return usual if value is None else value

    return method


class Broken(dm.Term):
    """A term that does what it is told, on one rank only."""

    on = COMM.size - 1

    def __init__(self, **what):
        self.what = what

    def give(self, name):
        value = self.what.get(name) if COMM.rank == self.on else None
        if isinstance(value, Exception):
            raise value
        return value

    energy, stride = giving("energy", 0.0), giving("stride", 0.0)
    state, couplings = property(giving("state", {})), property(giving("couplings", ()))
    commit, meet = giving("commit"), giving("meet")

    def add_forces(self, F):
        value = self.give("add_forces")
        if isinstance(value, str):
            return F.array * 2.0
        F.array_w[:] += 0.0 if value is None else value

    def add_tangent(self, K):
        value = self.give("add_tangent")
        if value is not None:
            first = K.getOwnershipRange()[0]
            K.setValues([first], [first + np.size(value) - 1], [np.max(value)], addv=True)

    def begin(self, start, end):
        self.give("begin")


class Told(Broken):
    def __init__(self):
        super().__init__()
        self.calls = []

    def begin(self, start, end):
        self.calls.append((start, end))

    def commit(self):
        self.calls.append("commit")

    def roll_back(self):
        self.calls.append("roll back")


def test_what_a_term_is_told_in_the_course_of_a_walk(monkeypatch):
    """A step that fails is rolled back, and begins anew as its first half."""
    bar, told = Bar(), Told()
    hardening = dm.WeakForm(bar.solid, energy=1e4 * bar.u[1] ** 4 * bar.ds)
    problem = bar.problem(told, hardening)
    solve, tried = stepping.solve_step, []

    def short(problem, **options):
        tried.append(options["level"])
        return solve(problem, **options | {"max_it": 2 if len(tried) == 1 else 50})

    monkeypatch.setattr(stepping, "solve_step", short)
    list(dm.load_steps(problem, [1.0], on_time=lambda t: bar.move(-0.3 * t)))
    first, second = [(0.0, 0.5), "commit"], [(0.5, 1.0), "commit"]
    assert told.calls == [(0.0, 1.0), "roll back", *first, *second]


@pytest.mark.parametrize(
    ("what", "kind", "message"),
    [
        ({"energy": np.nan}, ValueError, r"terms\[0\], a Broken is nan at the present"),
        ({"add_forces": np.inf}, ValueError, r"terms\[0\], a Broken: add_forces gives NaN"),
        ({"add_tangent": np.nan}, ValueError, r"terms\[0\], a Broken: add_tangent gives NaN"),
        ({"begin": ValueError("too early")}, ValueError, r"a Broken: begin\(\): too early"),
        ({"add_forces": "returned"}, ValueError, r"a Broken: add_forces\(\): it returns a ndarray"),
        ({"add_forces": np.zeros(99)}, ValueError, r"a Broken: add_forces\(\): .*\(99,\)"),
        ({"add_tangent": [0.0, 1e3]}, ValueError, r"a Broken: add_tangent\(\) is not symmetric"),
        ({"meet": OSError("of one rank")}, OSError, r"a Broken: meet\(\): of one rank"),
        ({"stride": np.nan}, ValueError, r"a Broken: stride\(\): it is nan: give a finite length"),
        ({"couplings": 5}, ValueError, r"a Broken: couplings: it is 5: give a list"),
        ({"state": OSError("of one rank")}, OSError, "of one rank"),
    ],
)
def test_what_one_rank_does_wrong_is_raised_on_all(what, kind, message):
    bar, broken = Bar(moved=0.01), Broken(**what)
    owns = bar.V.dofmap.index_map.size_local > 0  # of three ranks one has nothing
    broken.on = COMM.allreduce(COMM.rank if owns else -1, op=MPI.MAX)
    with pytest.raises(kind, match=message):
        dm.newton(bar.problem(broken))
    assert not bar.u.x.array.any()


def test_entries_beyond_the_pattern_are_named(guide):
    """A rank adds to a row of another one, which finds it out when the matrix is assembled."""

    class Far(guide["Cable"]):
        def add_tangent(self, K):
            owns = self.at[0].any()
            adding = COMM.allreduce(COMM.size if owns else COMM.rank, op=MPI.MIN) % COMM.size
            if COMM.rank == adding:
                K.setValues(self.dofs, self.dofs, np.ones((4, 4)), addv=True)

    bars = Bar(count=2)
    far = Far(bars.solid, (1.0, 0.0), (3.0, 0.0), 300.0)
    far.couplings = []
    with pytest.raises(ValueError, match=r"a Far: add_tangent\(\): an entry .* couplings"):
        dm.newton(bars.problem(far))


def test_a_tangent_with_a_zero_diagonal(guide):
    """The energy of one component in the other: where that one is held, nothing changes."""
    bar = Bar(moved=0.01)
    dm.newton(bar.problem(potential=50.0 * bar.u[0] * bar.u[1] * bar.ds), rtol=1e-10)
    assert np.isclose(bar.bottom(), 0.01, rtol=1e-8)


def test_commit_fails_on_all_ranks():
    bar = Bar(moved=0.01)
    problem = bar.problem(Broken(commit=ValueError("full")))
    dm.newton(problem)
    with pytest.raises(ValueError, match="full"):
        problem.commit()


class Giving(Broken):
    couplings, state = (), {}

    def __init__(self, name, value):
        super().__init__()
        setattr(self, name, value)


def test_what_is_no_term_is_refused():
    bar, same = Bar(), Broken()
    elsewhere = fem.Function(Bar().V)
    for terms, *words in (
        ([Broken], "terms[0] is <class ", "give an instance"),
        ([same, same], "holds the same object ", " twice"),
        (
            [Giving("couplings", [np.array([0, 10**6])])],
            "couplings: one is [0, 1000000]: give arrays of global dofs",
        ),
        ([Giving("couplings", None)], "couplings: it is None: give a list of arr"),
        ([Giving("state", {"a/b": bar.u})], "has the name 'a/b'"),
        ([Giving("state", [bar.u])], "give a dictionary of Functions by name"),
        ([Giving("state", {"u_n": elsewhere})], "'u_n' is ", "give a Function on solid.V"),
    ):
        with rejected(*words):
            bar.problem(*terms)
    for terms in ("springs", same):
        with rejected("terms is ", ": give a list"):
            dm.ContactProblem(bar.solid, bcs=bar.bcs, terms=terms)
    with rejected("level is nan: give a finite number"):
        dm.newton(bar.problem(), level=np.nan)


def test_weak_forms_that_cannot_work_are_refused():
    bar = Bar()
    u, v = bar.u, ufl.TestFunction(bar.V)
    for forms, message in (
        ({}, "give either energy= or residual="),
        ({"energy": u[0] * bar.ds, "residual": u[0] * v[0] * bar.ds}, "give either energy="),
        ({"residual": u[0] ** 2 * bar.ds}, "residual has 0 test or trial functions"),
        ({"residual": v[0] * bar.ds}, "residual does not contain the displacement"),
    ):
        with rejected(message):
            dm.WeakForm(bar.solid, **forms)
    with rejected("solid is 5: give the Solid of the bodies"):
        dm.WeakForm(5, energy=u[0] ** 2 * bar.ds)
    w = fem.Function(bar.V)
    for name, form, message in (
        ("loads", u[1] * v[1] * bar.ds, "loads contain the displacement "),
        ("loads", u.sub(1) * v[1] * bar.ds, "loads contain the displacement "),
        ("potential", 3.0, "is a float"),
        ("potential", fem.form(u[0] ** 2 * bar.ds), "compiled form"),
        ("potential", ufl.inner(u, v) * bar.ds, "has 1 test"),
        ("potential", ufl.jump(u)[0] ** 2 * ufl.dS, "interior_facet"),
        ("potential", Bar().u[0] ** 2 * ufl.dx, "another mesh"),
        ("potential", w[0] ** 2 * bar.ds, "does not contain"),
        ("potential", u.sub(1) ** 2 * bar.ds, "write u[i]"),
    ):
        with rejected(name, message):
            bar.problem(**{name: form})
    bar.problem(loads=w[1] * v[1] * bar.ds)


def test_a_tangent_that_varies_on_one_rank_is_assembled_by_all():
    """Otherwise that one would wait for the others in the assembly."""

    class Spring(dm.WeakForm):
        """Tells on the last rank alone that its tangent is another."""

        def varies(self, K):
            return COMM.rank == COMM.size - 1

    bar = Bar()
    problem = bar.problem(Spring(bar.solid, energy=0.5 * bar.u[1] ** 2 * bar.ds))
    assert problem.terms.linear and not problem.solid.points.follows
    assert problem.terms.vary(problem.K)
