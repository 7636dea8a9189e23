# SPDX-License-Identifier: MIT
"""Solve the problems of the verification manual; write docs/verification.json.

Run with ``containers/run python3 docs/tools/verification.py``; words after it choose the cases
whose names hold one of them, the others are left as they are in the file. Problems are those of the
tests and the demos, references closed solutions, fits of others, and fine meshes. The page is made
of the file by `tables.py`; no number in it is typed.
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from mpi4py import MPI

import numpy as np

DOCS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(DOCS.parent), str(DOCS / "tools")]

import gallery  # noqa: E402

import dolfinx_mortar as dm  # noqa: E402
from dolfinx import fem  # noqa: E402

Row = tuple[str, float, float, str]  # quantity, reference, ours, unit
CASES: list[tuple[str, str, Callable[[], Iterator[Row]]]] = []


def case(problem: str, source: str) -> Callable:
    """Add a function that yields rows to the manual."""

    def add(found: Callable[[], Iterator[Row]]) -> Callable[[], Iterator[Row]]:
        CASES.append((problem, source, found))
        return found

    return add


@case("Patch test: blocks of different lengths under uniform pressure", "exact, uniform stress")
def patch() -> Iterator[Row]:
    """Reach of the pressures at all slave nodes."""
    from tests.test_patch import P, solve_patch

    problem, contact, _ = solve_patch("lower", np.linspace(0, 1.5, 6), np.linspace(0, 1, 5))
    dm.newton(problem, rtol=1e-11)
    kept = contact.multiplier[problem.system.link(contact).constrained[:, 0]]
    yield "largest pressure", P, float(kept.max()), "MPa"
    yield "smallest pressure", P, float(kept.min()), "MPa"


@case(
    "Half disc on a block, elastic, plane strain (P1, 0.05 mm)",
    "force: two independent finite element codes; pressure and width: Hertz (Johnson, Contact "
    "Mechanics, 4.2) at our force, on a block that is no half space",
)
def hertz_line() -> Iterator[Row]:
    """Force, width and peak."""
    from tests.test_hertz import REFERENCE, solve

    found, _ = solve(0.05, "block", "updated")
    width, peak = found.fit()
    hertz = dm.analytic.hertz_line(found.force, 8.0, 206_900.0, 0.29, 206_900.0, 0.29)
    yield "force", REFERENCE["updated"][0], found.force, "N/mm"
    yield "half width", hertz.half_width, width, "mm"
    yield "peak pressure", hertz.peak_pressure, peak, "MPa"


@case(
    "Half ball on a block, elastic, a quarter in 3D (hexahedra, 0.125 mm)",
    "Hertz (Johnson, 4.2) at our force",
)
def hertz_point() -> Iterator[Row]:
    """Radius and peak."""
    from tests.test_axisymmetric_contact import SPHERE

    mesh, cell_tags, tags = dm.meshing.sphere(MPI.COMM_WORLD, cell="hexahedron", h=0.125)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    solid = dm.Solid(fem.Function(V), dm.Elastic(206_900.0, 0.29), cell_tags)
    bcs = []
    held = [(1, i, 0.0) for i in range(3)] + [(2, 0, 0.0), (2, 1, 0.0)]
    for tag, component, value in [*held, (2, 2, -0.05), (5, 0, 0.0), (6, 1, 0.0)]:
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, 2, tags.find(tag))
        bcs.append(fem.dirichletbc(fem.Constant(mesh, value), dofs, W))
    contact = dm.Contact(tags, slave=3, master=4)
    dm.newton(dm.ContactProblem(solid, [contact], bcs=bcs))
    nodes = contact.gather(solid.u)
    on, force = nodes["active"] > 0, 4.0 * abs(contact.force[2])
    r = np.hypot(*nodes["x"][on, :2].T)
    peak, radius = dm.analytic.fit_pressure(r, nodes["pressure"][on])
    hertz = dm.analytic.hertz_point(force, 8.0, 206_900.0, 0.29, 206_900.0, 0.29)
    yield "contact radius", hertz.contact_radius, radius, "mm"
    yield "peak pressure", hertz.peak_pressure, peak, "MPa"
    yield "force (reference: axisymmetric)", SPHERE["updated", 3], force, "N"


@case("Ball on a rigid flat, axisymmetric (quadrilaterals)", "Hertz, half spaces")
def ball_on_flat() -> Iterator[Row]:
    """Force and peak."""
    from tests import test_axisymmetric_contact as t
    from tests.cases.rings import ball_on_flat, pressed_ball

    problem, contact = pressed_ball(
        ball_on_flat(t.RADIUS, (20, 24)), dm.Elastic(t.E, t.NU), t.RADIUS**2, rigid=True
    )
    dm.newton(problem)
    force, peak = t.hertz(t.RADIUS**2, t.E / (1 - t.NU**2))
    r, p, found = t.profile(problem, contact)
    yield "force", force, found, "(E = 1000)"
    yield "peak pressure", peak, dm.analytic.fit_pressure(np.r_[-r, r], np.r_[p, p])[0], ""


@case("Shrink fit of two rings, plane strain, 192 and 144 facets", "Lame")
def shrink_fit() -> Iterator[Row]:
    """Pressure between the rings."""
    from tests.cases.close_fits import create_shrink_fit

    found = create_shrink_fit((192, 144), False)
    dm.newton(found.problem)
    pressure = found.contact.gather(found.problem.u)["pressure"]
    yield "mean pressure", found.pressure, float(pressure.mean()), "MPa"


@case("Shrink fit of two tubes, axisymmetric", "Lame")
def shrink_fit_of_tubes() -> Iterator[Row]:
    """Radial force over the whole ring."""
    from tests.cases.rings import shrink_fit_pressure
    from tests.test_axisymmetric_contact import NU, TUBE, E, fitted_tubes

    problem, contact = fitted_tubes(8, "upper", overlap=1e-6)
    dm.newton(problem, rtol=1e-10)
    expected = shrink_fit_pressure(E, NU, TUBE, 1e-6) * 2 * np.pi * TUBE[1]
    yield "radial force", expected, float(contact.force[0]), ""


@case("Two tied rings under pressure inside, 96 and 144 facets", "Lame")
def tied_rings() -> Iterator[Row]:
    """Largest error of the pressure between the rings."""
    from tests.test_smooth_tie import pressure_errors

    for slave in (2, 3):
        error = pressure_errors((4,), slave)[0, 0]
        yield f"pressure at the worst node, slave tag {slave}", 1.0, 1.0 + error, ""


@case(
    "Pin in a hole with 1 % clearance, 60 and 88 facets", "our own finer meshes, up to 700 facets"
)
def pin() -> Iterator[Row]:
    """Peak of the pressure."""
    from tests.cases.close_fits import create_pin
    from tests.test_smooth_contact import PEAK

    for swap, name in ((False, "first"), (True, "second")):
        _, found = create_pin((60, 88), swap).solve()
        yield f"peak pressure, {name} side as slave", PEAK, float(found["pressure"].max()), "MPa"


@case("Smooth punch on a perfectly plastic block, plane strain", "Prandtl, (2 + pi) k")
def punch() -> Iterator[Row]:
    """Mean pressure at the limit."""
    from tests.test_volumetric import punch

    yield "mean pressure over k", 2 + np.pi, punch("reduced", 4, 0.06)[-1], ""


@case("Orders of convergence of ties, manufactured solution", "theory")
def tying_orders() -> Iterator[Row]:
    """Orders in L2 and H1."""
    from tests.test_tying import solve_smooth

    for degree in (1, 2):
        errors = np.array([solve_smooth(n, "lower", "triangle", degree) for n in (4, 8)])
        orders = np.log2(errors[0] / errors[1])
        for norm, extra, order in zip(("L2", "H1"), (1, 0), orders, strict=True):
            yield f"order in {norm}, triangles of degree {degree}", degree + extra, order, ""


def of_demo(name: str) -> Path:
    """Return the folder of a demo that has run in the present state."""
    (demo,) = (demo for demo in gallery.DEMOS if demo.name == name)
    gallery.run(demo)
    return gallery.KEPT / name


@case("Tube of two glued rings at its limit load (demo tied_cylinder)", "rigid-plastic limit")
def tube() -> Iterator[Row]:
    """Pressure of the last step."""
    folder = of_demo("tied_cylinder")
    for file, name in (("monolithic", "one piece"), ("tied", "two rings")):
        found = json.loads((folder / f"{file}.json").read_text())
        yield f"pressure, {name}", found["limit"], found["steps"][-1]["pressure"], "MPa"


@case(
    "Ball flattened by a rigid plate to 50 times first yield (demo indentation)",
    "fits of Jackson and Green (2005) and of Kogut and Etsion (2002), which differ themselves",
)
def flattening() -> Iterator[Row]:
    """Force and contact radius beside either fit."""
    steps = json.loads((of_demo("indentation") / "summary.json").read_text())["steps"]
    for fit, name in (("jackson_green", "J & G"), ("kogut_etsion", "K & E")):
        yield f"force over that of first yield, {name}", *both(steps[-1], "force", fit), ""
        yield f"contact radius, {name}", *both(steps[-1], "contact_radius", fit), "mm"


@case(
    "Cone, ball and Berkovich's pyramid pressed into a metal (demo hardness)",
    "modulus: the one put in, by the slope of unloading and the area of contact; ball: Hertz, then "
    "the expanding cavity of Johnson (1970)",
)
def indenters() -> Iterator[Row]:
    """Moduli, and pressures below the ball before metal flows up to the surface."""
    for tool in ("cone", "ball", "berkovich"):
        file = json.loads((of_demo("hardness") / f"{tool}.json").read_text())
        found = file["found"]
        if tool != "ball":  # its slope hangs on the facets at the edge: 0 to 7 % too large
            yield f"modulus, {tool}", found["modulus_given"], found["modulus_contact"], "GPa"
        else:
            yield "first force over that of Hertz, ball", 1.0, found["first_force_over_hertz"], ""
            for row in file["steps"][4:9:2]:
                name = f"mean pressure at a depth of {row['depth']:.3g} micrometres, ball"
                yield name, row["pressure_cavity"], row["force"] / row["area"], "GPa"


@case(
    "Two rings that collide (demo bouncing_rings)",
    "Hoppe (1871) for a thin ring; what is left of the energy by the velocities after it",
)
def collided_rings() -> Iterator[Row]:
    """Period of the oval, and energy of the vibrations."""
    found = json.loads((of_demo("bouncing_rings") / "summary.json").read_text())["found"]
    yield (
        "period of the oval",
        *(1e6 * found[name] for name in ("period_of_a_thin_ring", "period")),
        "us",
    )
    share = found["vibrations_by_momentum"], found["vibrations"]
    yield "share of the energy in vibrations", *share, ""


@case(
    "Taylor's bar, copper at 227 m/s (demo taylor_bar)",
    "codes that do not lock, extrapolated to fine meshes; theirs lie within 1 %",
)
def taylor_bar() -> Iterator[Row]:
    """Radius of the foot on the way and at last, and length."""
    found = json.loads((of_demo("taylor_bar") / "summary.json").read_text())["found"]
    yield "radius of the foot after 12 us", 5.45, found["radius_after_12_microseconds"], "mm"
    yield "radius of the foot at last", 7.226, found["radius"], "mm"
    yield "length at last", 21.42, found["length"], "mm"


def both(step: dict, name: str, fit: str) -> tuple[float, float]:
    """Return the fit's value and ours."""
    return step[f"{name}_{fit}"], step[name]


@case(
    "Ball in its socket, meshes of 0.7 to 1.5 mm (demo ball_joint)",
    "our own finer mesh, hexahedra with 120 000 unknowns",
)
def ball_joint() -> Iterator[Row]:
    """Force with smooth surfaces on the four meshes, either slave."""
    from tests.test_demo import SOCKET_FORCE

    said = (of_demo("ball_joint") / "said.txt").read_text()
    line = r"h = ([\d.]+), ([\d.]+), .*slave (\w+), smooth: (\d+) N"
    for outer, inner, slave, force in re.findall(line, said):
        name = f"force, socket {outer} mm, ball {inner} mm, slave {slave}"
        yield name, SOCKET_FORCE, float(force), "N"


@case(
    "Half disc on a block, pushed sideways with friction, elastic (P1, 0.05 mm)",
    "another active-set code with the same D and M",
)
def pushed_disc() -> Iterator[Row]:
    """Tangential forces until it slides."""
    from tests.test_friction_hertz import DEPTH, SIDEWAYS, SLIDING, pushed

    forces = {s: Q for s, (Q, _) in SIDEWAYS.items()} | {SLIDING[0]: SLIDING[1]}
    levels = [(DEPTH, 0.0), *((DEPTH, s) for s in forces)]
    cases = pushed("graded", 0.05, levels, geometry="reference", surface="facets")
    next(cases)
    for (s, Q), found in zip(forces.items(), cases, strict=True):
        yield f"tangential force at {s} mm", Q, float(found.contact.force[0]), "N/mm"


@case(
    "Half disc on a block, pushed sideways with friction, mesh of the paper",
    "CalculiX, which takes ten facets of this coarse mesh in two ways; ours with updated geometry",
)
def pushed_disc_of_the_paper() -> Iterator[Row]:
    """Forces beside both ways."""
    from tests.test_friction_hertz import CALCULIX, coarse

    found = coarse("updated", "block")
    Q = float(found.contact.force[0])
    for (P, T), name in zip(CALCULIX, ("surface to surface", "mortar"), strict=True):
        yield f"normal force, {name}", P, found.force, "N/mm"
        yield f"tangential force, {name}", T, Q, "N/mm"


@case(
    "Disc pushed back and forth, a twentieth of the half width (demo cattaneo)",
    "Cattaneo, Mindlin, Deresiewicz, for half spaces, at our forces; the computed stick zone ends "
    "within a facet, of which the middle is taken",
)
def partial_slip() -> Iterator[Row]:
    """Stick zone, traction, and the energy of a loop."""
    found = json.loads((of_demo("cattaneo") / "summary.json").read_text())
    row, loop = found["steps"][-1], found["loop"]
    zone = row["stick_half_width"] + 0.5 * found["options"]["h"]
    yield "stick half width", row["stick_half_width_cattaneo"], zone, "mm"
    middle = row["middle_traction_cattaneo"], row["middle_traction"]
    yield "shear traction in the middle", *middle, "MPa"
    yield "energy of a loop, by slip", loop["cattaneo"], loop["dissipation"], "N"
    yield "energy of a loop, as its area", loop["cattaneo"], loop["area"], "N"


@case(
    "Half ball on a block, pushed back and forth in 3D (hexahedra, a sixth of the radius)",
    "Mindlin, Deresiewicz, for half spaces, at our forces",
)
def partial_slip_in_space() -> Iterator[Row]:
    """Stick zone at the largest force, and the energy of a loop, for either slave."""
    from tests.test_friction_hertz import SIDES, pushed_ball

    for slave in SIDES:
        first, _, last = pushed_ball(0.125, slave, (0.005, -0.005, 0.005))
        loop = last["state"].dissipation - first["state"].dissipation
        yield f"stick radius, slave {slave}", first["state"].stick_radius, first["sticks"], "mm"
        yield f"energy of a loop, slave {slave}", loop, last["energy"] - first["energy"], "N mm"


@case(
    "Disc that rolls over a block while it drives (five facets on a half width)",
    "Carter (Johnson, 8.3): steady, at half the creep that makes all slip; rolled by four half "
    "widths, mean of both ways, from a push that is larger and one that is smaller",
)
def rolling() -> Iterator[Row]:
    """Tangential force over friction times normal force."""
    from tests.test_friction_rolling import STEADY, between

    for slave in ("block", "disc"):
        last = np.mean([between(slave, shift)[-1] for shift in (0.039, 0.033)])
        yield f"share of sliding, slave {slave}", STEADY, float(last), ""


@case("Hub on a shaft, which is pulled out (demo shrink_fit)", "Lame; slices of shaft and hub")
def pulled_shaft() -> Iterator[Row]:
    """Pressure, and the force at which it slides."""
    found = json.loads((of_demo("shrink_fit") / "summary.json").read_text())
    yield "pressure", found["pressure_lame"], found["pressure"], "MPa"
    force = found["sliding_force"]
    yield "sliding force, friction times pressure", found["sliding_force_lame"], force, "N"
    yield "sliding force, of the stretched shaft", found["sliding_force_stretched"], force, "N"


def main(words: list[str]) -> None:
    """Solve all cases, or those that words choose; write the file."""
    path = DOCS / "verification.json"
    old = {case["problem"]: case for case in json.loads(path.read_text())["cases"]}
    found = []
    for problem, source, solve in CASES:
        if words and problem in old and not any(word in problem for word in words):
            found.append(old[problem])
            continue
        rows = [
            {"quantity": q, "reference": float(r), "ours": float(o), "unit": unit}
            for q, r, o, unit in solve()
        ]
        found.append({"problem": problem, "source": source, "rows": rows})
        for row in rows:
            off = row["ours"] / row["reference"] - 1
            print(f"{problem}: {row['quantity']}: {off:+.2%}", flush=True)
    more = {"version": dm.__version__, "cases": found}
    path.write_text(json.dumps(more, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
