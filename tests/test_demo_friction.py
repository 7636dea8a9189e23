# SPDX-License-Identifier: MIT
"""The demos with friction as commands, beside Cattaneo, Lame and Coulomb."""

import json

import pytest

from tests.test_demo import run, shown

pytestmark = pytest.mark.serial


def summary(folder, demo, *options, ranks=1):
    done = run(*options, "--output", str(folder), demo=demo, ranks=ranks)
    assert done.returncode == 0, done.stderr
    return read(folder)


def read(folder):
    assert (folder / "result.png").stat().st_size > 5000
    return json.loads((folder / "summary.json").read_text())


def check_cattaneo(found, h, traction, energy):
    """Stick zone to the facet, traction away from its edges, and the energy of the closed loop."""
    rows = [row for row in found["steps"] if "share" in row]
    assert 0.6 < rows[-1]["share"] < 0.65
    for row in rows:
        assert abs(row["stick_half_width"] - row["stick_half_width_cattaneo"]) < h
        assert row["traction_error"] < traction and row["traction_error_mean"] < traction
        assert row["certificate"]["equilibrium"] < 1e-6
    loop = found["loop"]
    assert loop["closed_by"] < 1e-4
    assert loop["dissipation"] == pytest.approx(loop["cattaneo"], rel=energy)
    return rows, loop


@pytest.mark.slow
def test_a_disc_pushed_to_and_fro(tmp_path):
    """On a coarse mesh, a seventh of the half width, with one step for each push."""
    found = summary(tmp_path, "cattaneo", "--h", "0.15", "--steps", "1")
    assert len(found["steps"]) == 1 + 1 + 2 + 2
    check_cattaneo(found, 0.15, 0.05, 0.06)


@pytest.mark.slow
def test_a_disc_pushed_to_and_fro_is_cattaneos():
    """A twentieth of the half width: tractions and energy within two per cent."""
    check_fine_cattaneo(read(shown("cattaneo")))


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(("slave", "ranks"), [("disc", 1), ("block", 2)])
def test_either_slave_and_two_ranks_are_cattaneos(slave, ranks, tmp_path):
    check_fine_cattaneo(summary(tmp_path, "cattaneo", "--slave", slave, ranks=ranks))


def check_fine_cattaneo(found):
    rows, loop = check_cattaneo(found, 0.05, 0.02, 0.02)
    assert 18.0 < rows[-1]["half_width"] / 0.05 < 22.0
    assert loop["area"] == pytest.approx(loop["cattaneo"], rel=0.02)


@pytest.mark.slow
@pytest.mark.nightly
def test_energy_and_tractions_converge(tmp_path):
    coarse, fine = (
        summary(tmp_path, "cattaneo", "--h", h, "--steps", "2")["loop"] for h in ("0.1", "0.025")
    )
    errors = [abs(loop["dissipation"] / loop["cattaneo"] - 1.0) for loop in (coarse, fine)]
    assert errors[1] < 0.005 < errors[0]


@pytest.mark.slow
def test_a_rough_contact_is_sheared_before_it_is_pushed(tmp_path):
    """The curved body and the flat one do not stretch alike under the pressure."""
    options = ("--h", "0.1", "--steps", "1")
    smooth, rough = (
        summary(tmp_path, "cattaneo", *options, *more)["steps"][1] for more in ((), ("--rough",))
    )
    assert rough["tangential_force"] == pytest.approx(smooth["tangential_force"], rel=0.01)
    assert 0.02 < rough["traction_error"] < 0.08


def check_fit(found, mesh):
    """Lame's pressure, a shaft that dead loads do not move, and Coulomb's force where it slides."""
    last, held = found["steps"][-1], found["steps"][-5]
    assert found["pressure"] == pytest.approx(found["pressure_lame"], rel=mesh)
    assert held["time"] == 2.0 and 0 < held["slipping"] < held["closed"]
    assert held["force"] == pytest.approx(0.9 * found["sliding_force_lame"], rel=5 * mesh)
    assert found["sliding_force"] == pytest.approx(found["sliding_force_stretched"], rel=5 * mesh)
    check_sliding(found, last, mesh)


def check_sliding(found, last, mesh):
    """All of the contact slips, and more motion takes no more force."""
    assert last["slipping"] == last["closed"]
    assert last["force"] == pytest.approx(found["sliding_force_mu_N"], rel=5 * mesh)
    before = found["steps"][-2]
    assert last["force"] == pytest.approx(before["force"], rel=1e-4)
    moved = last["slid"] - before["slid"]
    assert moved > 0.0
    work = last["dissipation"] - before["dissipation"]
    assert work == pytest.approx(moved * last["force"], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("slave", ["shaft", "hub"])
def test_a_shaft_is_held_by_friction(slave, tmp_path):
    found = summary(tmp_path, "shrink_fit", "--cells", "5", "--slave", slave)
    check_fit(found, 0.002)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_a_shaft_is_held_by_friction_in_space(ranks, tmp_path):
    found = summary(tmp_path, "shrink_fit", "--space", "--cells", "2", ranks=ranks)
    check_fit(found, 0.003)


@pytest.mark.slow
def test_a_dry_fit_slides_at_the_same_force(tmp_path):
    """Friction while the hub shrinks changes pressures and slips, not the force at the end."""
    options = ("--cells", "5")
    oiled, dry = (summary(tmp_path, "shrink_fit", *options, *m) for m in ((), ("--dry",)))
    assert dry["sliding_force"] == pytest.approx(oiled["sliding_force"], rel=5e-4)
    fitted = [next(s for s in found["steps"] if s["time"] == 1.0) for found in (oiled, dry)]
    assert fitted[1]["pressure_max"] > 1.05 * fitted[0]["pressure_max"]
    assert abs(fitted[0]["dissipation"]) < 1e-4 * fitted[1]["dissipation"]
    check_sliding(dry, dry["steps"][-1], 0.002)


@pytest.mark.slow
def test_a_hub_that_flows_holds_less(tmp_path):
    """Its pressure is bounded by Tresca's rule; the shaft slides at Coulomb's force again."""
    found = summary(tmp_path, "shrink_fit", "--plastic")
    assert found["pressure_tresca"] < found["pressure"] < found["pressure_tresca_upper"]
    assert found["pressure"] < 0.8 * found["pressure_lame"]
    check_sliding(found, found["steps"][-1], 0.002)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("demo", "options", "named"),
    [
        ("cattaneo", ("--steps", "0"), "--steps 0"),
        ("cattaneo", ("--friction", "0"), "--friction 0"),
        ("shrink_fit", ("--friction", "-1"), "--friction -1"),
        ("shrink_fit", ("--cells", "-1"), "--cells -1"),
    ],
)
def test_numbers_out_of_range_are_named(demo, options, named):
    done = run(*options, demo=demo)
    assert done.returncode == 2 and named in done.stderr and "Traceback" not in done.stderr
