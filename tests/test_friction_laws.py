# SPDX-License-Identifier: MIT
"""Coefficients of friction by pressure, speed, temperature and state: closed forms, wrong ones."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.interfaces.constraints import Coefficient
from tests.cases.friction import COMM
from tests.cases.friction import create as create_pushed
from tests.cases.mortar import largest
from tests.cases.pressed_blocks import rejected

REST, SLIDING = 0.5, 0.3
NAMES = "step_slip", "pressure", "traction"
LIGHT = -1e-6  # of the top: so light a pressure that blocks slide as rigid ones


def scalar(V):
    """Return a scalar Function on the mesh of V."""
    return fem.Function(V.sub(0).collapse()[0])


def drag(case):
    """Return the tangential over the normal force."""
    force = np.abs(case.contact.force)
    return force[:-1].max() / force[-1]


def create_timed(law, **options):
    """Return the blocks with a law of (dt, p, s, ..), and the Constant dt."""
    box = []
    timed = Coefficient(lambda *given: law(float(box[0].value), *given), **options)
    case = create_pushed(slave="upper", friction=timed)  # whose nodes are covered as a whole
    box.append(fem.Constant(case.problem.V.mesh, 0.0))
    return case, box[0]


def slide(case, dt, way, down=LIGHT, **options):
    """Yield steps whose top goes along a table of (time, x), pressed by the way down."""
    case.solve(way[0][1], down)
    rows = {case.top: [(t, (x, down)) for t, x in way]}
    times = options.pop("times", [t for t, _ in way[1:]])
    yield from dm.load_steps(
        case.problem, times, start=way[0][0], ramp=rows, dt=dt, **{"rtol": 1e-9} | options
    )


@pytest.mark.mpi
def test_static_and_kinetic_friction():
    """The drag rises to the coefficient at rest, and falls once all has slipped."""
    case = create_pushed(friction=lambda p, s: np.where(s > 0.0, SLIDING, REST))
    case.solve(0.0, -0.02)
    case.solve(0.002, -0.02)
    assert drag(case) < SLIDING
    case.solve(0.05, -0.02)
    assert drag(case) == pytest.approx(REST, rel=1e-10)
    case.solve(0.06, -0.02)
    assert drag(case) == pytest.approx(SLIDING, rel=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("frozen", [True, False])
def test_a_coefficient_that_falls_with_the_pressure(frozen):
    """A block that slides on is dragged by the pressures of the last step, or of this one."""
    law = lambda p, s: 0.3 / (1.0 + p / 20.0)  # noqa: E731
    case = create_pushed(friction=Coefficient(law, frozen=frozen))
    case.solve(0.0, -0.02)
    case.solve(0.05, -0.02)
    last = case.contact.gather(case.problem.u)["pressure"]
    case.solve(0.06, -0.03, rtol=1e-9)
    now = case.contact.gather(case.problem.u)
    assert (now["status"][last > 0.0] == 2.0).all() and last.max() > 10.0
    sliding = np.linalg.norm(now["traction"], axis=1)
    pressure = last if frozen else now["pressure"]
    assert sliding == pytest.approx(law(pressure, None) * now["pressure"], rel=1e-7)
    assert now["coefficient"] == pytest.approx(law(now["pressure"], None), rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("frozen", [True, False])
def test_a_step_is_repeated_from_the_last_commit(frozen):
    """The same coefficient and states, however often a step is solved before it is accepted."""
    law = Coefficient(
        lambda p, s, worn: (0.3 / (1.0 + worn + p / 20.0), worn + p * s),
        state={"worn": 0.5},
        frozen=frozen,
    )
    found = []
    for times in (1, 3):
        case = create_pushed(friction=law)
        for x in (0.0, 0.02, 0.05):
            case.push(x, -0.02)
            for _ in range(times):
                dm.newton(case.problem, rtol=1e-10)
            case.problem.commit()
        found.append([case.contact.gather(case.problem.u)[n] for n in ("traction", "worn")])
    assert largest(found[0][0] - found[1][0]) < 1e-8 * largest(found[0][0])
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-8) and found[0][1].max() > 0.6


@pytest.mark.mpi
def test_a_failure_leaves_the_step_before():
    """After a step that fails in its second turn, the step before is what is committed."""
    calls = []

    def law(p, s, worn):
        if calls and calls.pop():
            raise RuntimeError("for the test")
        return 0.3 / (1.0 + worn + p / 20.0), worn + p * s

    case = create_pushed(friction=Coefficient(law, state={"worn": 0.0}))
    case.solve(0.0, -0.02, rtol=1e-9)
    case.push(0.02, -0.02)
    dm.newton(case.problem, rtol=1e-9)
    before = ended(case.contact)
    case.push(0.05, -0.02)
    calls[:] = [True, False]
    with pytest.raises(RuntimeError, match="for the test"):
        dm.newton(case.problem, rtol=1e-9)
    found = ended(case.contact)
    assert before.keys() == found.keys() > {"step_slip", "worn", "coefficient"}
    assert all(np.array_equal(before[n], found[n], equal_nan=True) for n in before)
    case.problem.commit()
    for name in ("worn", "coefficient"):
        owned = case.contact.nodal[name].x.array[: len(before[name])]
        assert np.array_equal(owned, before[name])


def ended(contact):
    """Return the results of a step, and what its commit will make of them."""
    return {k: f.x.array.copy() for k, f in contact.nodal.items()} | dict(contact.ended)


@pytest.mark.mpi
def test_a_coefficient_that_falls_with_the_speed():
    """Steady sliding at several speeds: mu_k + (mu_s - mu_k) exp(-V / V_c)."""

    def law(dt, p, s):
        return SLIDING + (REST - SLIDING) * np.exp(-s / (dt or 1.0) / 2.0)

    case, dt = create_timed(law)
    speeds, way = np.repeat([1.0, 4.0, 0.5, 2.0], 2), [(0.0, 0.0)]  # twice: from rest, shear grows
    for k, speed in enumerate(speeds):
        way.append((way[-1][0] + 0.01 * (1 + k % 2), way[-1][1] + 0.01 * (1 + k % 2) * speed))
    for k, step in enumerate(slide(case, dt, way)):
        assert step.report.converged
        if k % 2:
            assert drag(case) == pytest.approx(law(1.0, None, speeds[k]), rel=1e-8)


@pytest.mark.mpi
def test_a_coefficient_that_rises_steeply_with_the_speed():
    """Elastic blocks, whose slip falls by more than it raises the coefficient: turns are damped."""

    def law(dt, p, s):
        return 0.1 + s / (dt or 1.0)

    case, dt = create_timed(law)
    for step in slide(case, dt, [(0.0, 0.0), (0.01, 0.01)], down=-0.02, rtol=1e-7):
        now = case.closed()
        slips, sticks = now["status"] == 2.0, now["status"] == 1.0
        s, p, tau = (np.linalg.norm(np.atleast_2d(now[n].T), axis=0) for n in NAMES)
        assert len(step.parts) == 1 and slips.sum() > 2
        assert tau[slips] == pytest.approx(law(0.01, p, s)[slips] * p[slips], rel=1e-6)
        assert (tau[sticks] <= 0.1 * p[sticks] * (1 + 1e-6)).all()


MU, A, B, LENGTH, V0 = 0.6, 0.01, 0.015, 1e-3, 1.0


def ageing(dt, p, s, theta):
    """Dieterich's law, d theta/dt = 1 - V theta / L by the implicit rule of Euler."""
    V = np.maximum(s / dt, 1e-9) if dt else 1e-9 + 0.0 * s
    theta = (theta + dt) / (1.0 + V * dt / LENGTH)
    return MU + A * np.log(V / V0) + B * np.log(V0 * theta / LENGTH), theta


@pytest.mark.mpi
def test_rate_and_state():
    """A jump of the speed: the direct effect a ln(V / V_1), and mu_0 + (a - b) ln(V / V_0) at last.

    Source: J. H. Dieterich, J. Geophys. Res. 84 (1979) 2161-2168; C. Marone, Annu. Rev. Earth
    Planet. Sci. 26 (1998) 643-696, eqs. 1 to 3.
    """
    slow, fast = 1.0, 10.0
    case, dt = create_timed(ageing, state={"theta": LENGTH / slow})
    times = [0.05, 0.06, *(0.06 + np.array([1e-6, 1e-3, 0.01, 0.02, 0.03, 0.04]))]
    way = [(t, slow * t + (fast - slow) * max(t - 0.06, 0.0)) for t in [0.0, *times]]
    found = []
    for _ in slide(case, dt, way, times=times):
        on = case.closed()
        found.append((drag(case), on["theta"].min(), on["theta"].max()))
    mu, least, most = np.array(found).T
    assert mu[1] == pytest.approx(MU + (A - B) * np.log(slow / V0), abs=1e-7)
    assert [least[1], most[1]] == pytest.approx([LENGTH / slow] * 2, rel=1e-5)
    assert mu[2] - mu[1] == pytest.approx(A * np.log(fast / slow), rel=0.02)
    assert mu[-1] == pytest.approx(MU + (A - B) * np.log(fast / V0), abs=1e-7)
    assert [least[-1], most[-1]] == pytest.approx([LENGTH / fast] * 2, rel=1e-5)


@pytest.mark.mpi
def test_parts_of_a_step_that_is_cut():
    """States and coefficients go back with a part that fails; numbers are those of its parts."""
    found = []
    for cut in (True, False):
        case, dt = create_timed(ageing, state={"theta": 1e-3})
        way = [(0.0, 0.0), (0.01, 0.01), (0.05, 0.05), (0.07, 0.45)]
        evaluate, calls = case.problem.solid.evaluate, []

        def fails(*given, case=case, calls=calls, evaluate=evaluate, **options):
            calls.append(case.problem.committed.level)
            # after the first turn of the last step
            if calls.count(0.05) == 2 and calls.append(None) is None:
                raise dm.NewtonNotConverged("for the test", dm.StepReport())
            return evaluate(*given, **options)

        case.problem.solid.evaluate = fails if cut else evaluate
        times = [0.01, 0.05, 0.07] if cut else [0.01, 0.05, 0.06, 0.07]
        *_, last = slide(case, dt, way, times=times)
        assert len(last.parts) == 1 + cut
        found.append(case.contact.gather(case.problem.u))
    for name in ("traction", "theta", "coefficient"):
        assert largest(found[0][name] - found[1][name]) < 1e-8 * largest(found[0][name])


@pytest.mark.mpi
@pytest.mark.parametrize("frozen", [True, False])
def test_a_coefficient_that_rises_with_a_temperature(frozen):
    """Sources r heat bodies of capacity c by r t / c; the coefficient is that temperature's."""
    box = []
    law = lambda p, s, T: 0.1 + 0.02 * T  # noqa: E731
    made = create_pushed(slave="upper")
    T = fem.Function(fem.functionspace(made.problem.V.mesh, ("Lagrange", 1)))
    case = made.again(friction=Coefficient(law, reads=[T], frozen=frozen))
    heat = dm.Heat(T, 1.0, capacity=2.0, sources=10.0)
    box.append(heat)
    case.solve(0.0, LIGHT)
    rows = {case.top: [(0.0, (0.0, LIGHT)), (1.0, (0.5, LIGHT))]}
    before = 0.0
    for step in dm.load_steps(case.problem, [0.2, 0.6, 1.0], ramp=rows, heat=heat, start=0.0):
        at = before if frozen else step.time
        assert drag(case) == pytest.approx(0.1 + 0.02 * 5.0 * at, rel=1e-6)
        before = step.time


@pytest.mark.mpi
def test_states_are_in_a_checkpoint(tmp_path):
    """A run that goes on from a file ends with the same numbers."""
    file, found = COMM.bcast(tmp_path / "run.h5"), []
    for stop in (True, False):
        case, dt = create_timed(ageing, state={"theta": 1e-3})
        if stop:
            for step in slide(case, dt, [(0.0, 0.0), (0.02, 0.1), (0.05, 0.13)], down=-0.02):
                if step.time == 0.02:
                    case.problem.save(file)
            found.append(case.contact.gather(case.problem.u))
            continue
        case.problem.restore(file)
        rows = {case.top: [(0.02, (0.1, -0.02)), (0.05, (0.13, -0.02))]}
        list(dm.load_steps(case.problem, [0.05], ramp=rows, dt=dt, rtol=1e-9))
        found.append(case.contact.gather(case.problem.u))
    for name in ("traction", "theta", "coefficient"):
        assert largest(found[0][name] - found[1][name]) < 1e-9 * largest(found[0][name])


@pytest.mark.mpi
@pytest.mark.parametrize("frozen", [True, False])
@pytest.mark.parametrize("bad", [-0.1, np.nan])
def test_a_wrong_coefficient_is_named_with_its_place(bad, frozen):
    """At one end of the side only, so on one rank; the step is undone on all."""
    made = create_pushed(slave="upper")
    x = fem.Function(made.contact.pressure.function_space)
    x.interpolate(lambda x: x[0])
    law = lambda p, s, x: np.where((p > 0.0) & (x > 0.99), bad, 0.3)  # noqa: E731
    case = made.again(friction=Coefficient(law, reads=[x], frozen=frozen))
    case.solve(0.0, 0.01)
    u = case.problem.u.x.array.copy()
    case.push(0.0, -0.02)
    with rejected("friction", f"{bad:g}", "at (1, ", ">= 0"):
        case.solve(0.0, -0.02)
    assert np.array_equal(case.problem.u.x.array, u)


@pytest.mark.mpi
def test_a_wrong_state_is_named_with_its_place():
    law = Coefficient(
        lambda p, s, n: (0.3 + 0.0 * s, n / (1.0 - 1.0 * (p > 0.0))), state={"n": -1.0}
    )
    case = create_pushed(friction=law)
    with np.errstate(divide="ignore"), rejected("n is -inf at (", "finite"):
        case.solve(0.0, -0.02)


def test_a_coefficient_that_never_agrees():
    """The cause and the remedies are told; the state is as before."""
    case = create_pushed(friction=Coefficient(lambda p, s: np.where(s > 0.0, 0.9, 0.01)))
    u = case.problem.u.x.array.copy()
    with pytest.raises(dm.NewtonNotConverged, match=r"friction.*frozen"):
        case.solve(0.0, -0.02)
    assert np.array_equal(case.problem.u.x.array, u)


@pytest.mark.parametrize(
    ("friction", "words"),
    [
        (lambda p, s: [0.1, 0.2, 0.3], ("friction", "(n,)")),
        (lambda p, s: (0.1, 0.2), ("friction", "(n,) of each of coefficient")),
        (
            Coefficient(lambda p, s, a: 0.1, state={"a": 0.0}),
            ("friction", "(n,) of each of coefficient, a"),
        ),
    ],
)
def test_a_function_that_returns_something_else(friction, words):
    case = create_pushed(friction=friction)
    with rejected(*words):
        case.solve(0.0, -0.02)


WORN = {"wear_depth": 0.0}


@pytest.mark.parametrize(
    ("create", "words"),
    [
        (lambda V: Coefficient(0.3), ("function", "0.3")),
        (lambda V: Coefficient(max, state={"a": np.nan}), ("state['a']", "nan")),
        (lambda V: Coefficient(max, reads=[fem.Function(V)]), ("reads[0]", "scalar")),
        (lambda V: Coefficient(max, reads=[0.3]), ("reads[0]", "0.3")),
        (lambda V: create_pushed(friction=Coefficient(max, state={"gap": 0.0})), ("gap",)),
        (lambda V: create_pushed(friction=Coefficient(max, state=WORN)), ("wear_depth", "rename")),
        (lambda V: create_pushed(friction=Coefficient(max, reads=[scalar(V)])), ("another mesh",)),
    ],
)
def test_wrong_arguments(create, words):
    V = create_pushed().problem.V
    with rejected(*words):
        create(V)
