# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Shrink fit, and the force that pulls the shaft out of the hub
#
# This demo computes an interference fit with friction, axisymmetric or in 3D, elastic or plastic.
# It shows how to
#
# - describe thermal strain as an eigenstrain, `eigenstrain=`,
# - apply dead loads as a linear form, and springs as a potential of the displacement,
# - compare with Lame's thick cylinders, of `lame.py` beside the demo.
#
# **Problem.** The bore of a hub (outer radius 30 mm) is smaller than the hollow shaft (radius 20
# mm, bore of radius 10 mm) by the interference, 0.02 mm in the radius. Both are of steel ($E$ = 200
# GPa, $\nu$ = 0.3) and 20 mm long; the coefficient of friction is 0.2. Only friction holds the
# shaft. The load history has three parts:
#
# 1. The hub is cooled until the interference is reached, without friction: the surfaces are
#    lubricated. A weak spring keeps the shaft in its place.
# 2. The lubrication and the spring are removed, so that friction acts. Dead loads pull at the end
#    of the shaft. The shaft does not slide.
# 3. A spring pulls further until the shaft slides.
#
# Units: mm, MPa, N; forces are those of the whole bodies.
#
# **Result.** The picture shows pressure and shear traction along the shaft at several pulling
# forces, and the pulling force over the motion of the end of the shaft.
#
# **Compare with.** Without axial stress Lame's thick cylinders give the pressure for the
# interference $d$,
#
# $$p = \frac{d}{c} \left(\frac{1}{E_1} \left(\frac{c^2 + a^2}{c^2 - a^2} - \nu_1\right)
#       + \frac{1}{E_2} \left(\frac{b^2 + c^2}{b^2 - c^2} + \nu_2\right)\right)^{-1},$$
#
# with the radii $a < c < b$ of the shaft's bore, of the common surface and of the outer surface.
# The shaft then slides at the force
#
# $$F = \mu p \, 2 \pi c L,$$
#
# or at a slightly smaller one, because the shaft contracts as it is stretched:
# `lame.py` includes this, too.
#
# **Options to try.** `--dry` applies friction from the beginning: the hub, which becomes shorter as
# it cools, compresses the shaft, and the pressure differs from Lame's; at the end the shaft slides
# at the same force. `--plastic` has an interference of 0.06 mm, at which the hub yields. `--space`
# computes a quarter in 3D, on a coarse mesh. `--slave hub` exchanges slave and master side.

import argparse
import logging
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np
from lame import shrink_fit
from scipy.optimize import brentq
from tubes import tubes

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

RADII = (10.0, 20.0, 30.0)  # mm: bore of the shaft, common surface, outside of the hub
LENGTH = 20.0  # mm, of both
E, NU, STRENGTH = 200e3, 0.3, 250.0  # MPa, -, MPa: steel; the uniaxial yield stress of the hub
INTERFERENCE = {False: 0.02, True: 0.06}  # mm, in the radius; True: the hub yields
PULLED = (0.3, 0.6, 0.9)  # dead loads, over mu p A
WEAK, STRONG = 1e-4 * E / LENGTH, E / LENGTH  # N/mm^3, springs at the end of the shaft
SECTION = np.pi * (RADII[1] ** 2 - RADII[0] ** 2)  # mm^2, of the shaft
CONTACT = 2.0 * np.pi * RADII[1] * LENGTH  # mm^2

parser = argparse.ArgumentParser(description="A hub shrunk on a shaft, which is then pulled.")
parser.add_argument("--friction", type=float, default=0.2, help="coefficient of friction")
parser.add_argument("--space", action="store_true", help="in 3D, a quarter of both")
parser.add_argument("--plastic", action="store_true", help="larger interference: the hub yields")
parser.add_argument("--dry", action="store_true", help="friction while the hub is cooled, too")
parser.add_argument("--slave", choices=["shaft", "hub"], default="shaft")
parser.add_argument("--cells", type=int, default=0, help="across the shaft; default 8, 3D: 3")
parser.add_argument("--output", type=Path, default=Path("results/shrink_fit"))


# ## The problem
#
# Everything that changes during the load history is a Constant.


@dataclass
class Fit:
    """Hub and shaft, and the Constants that drive them."""

    problem: dm.ContactProblem
    contact: dm.Contact
    whole: float  # the whole bodies over the meshed part
    cooling: fem.Constant
    friction: fem.Constant
    load: fem.Constant  # MPa, at the end of the shaft
    stiffness: fem.Constant  # N/mm^3, of the spring there
    anchor: fem.Constant  # mm, position of the end at which the spring is without force
    mean: fem.Form  # integral of the axial displacement over that end
    area: float  # of the meshed part of that end
    thrust: fem.Form  # integral of the pressure over the meshed part of the contact

    def end(self) -> float:
        """Return the mean motion of the end of the shaft."""
        return self.problem.comm.allreduce(fem.assemble_scalar(self.mean)) / self.area

    def normal_force(self) -> float:
        """Return the integral of the pressure over the whole contact."""
        return self.whole * self.problem.comm.allreduce(fem.assemble_scalar(self.thrust))


def create(options: argparse.Namespace) -> Fit:
    """Create the problem: the half section, or a quarter in 3D."""
    # The meshes of hub and shaft do not match at their common surface.
    comm = MPI.COMM_WORLD
    n = options.cells or (3 if options.space else 8)
    cells: tuple = ((n, 2 * n), (n + 1, 2 * n + 3))
    if options.space:
        cells = ((n, 2 * n, 3 * n), (n + 1, 2 * n + 1, 4 * n))
    mesh, cell_tags, facet_tags = tubes(comm, RADII, LENGTH, cells)
    d = mesh.topology.dim

    # ### Bodies
    #
    # The cooling of the hub is an eigenstrain, the same in all directions.

    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    u = fem.Function(V, name="displacement")
    steel = dm.Elastic(E, NU)
    soft = dm.VonMises.from_uniaxial(E, NU, yield_stress=STRENGTH, plastic_modulus=0.0)
    cooling = fem.Constant(mesh, 0.0)
    solid = dm.Solid(
        u,
        {"inner": steel, "outer": soft if options.plastic else steel},
        cell_tags,
        kinematics="spatial" if options.space else "axisymmetric",
        eigenstrain={"outer": cooling},
        volumetric="reduced",
    )

    # ### Supports
    #
    # The hub is held in the axial direction at one end; the shaft is pulled at the other end. The
    # edge of the hub's bore is not held: where a support prescribes the slip of a slave node,
    # friction grows to its limit over a twentieth of a facet. In 3D both bodies are cut by two
    # planes of symmetry. The half section needs no other support.

    def but_the_edge(x: np.ndarray) -> np.ndarray:
        r = np.hypot(x[0], x[1]) if options.space else x[0]
        return (x[d - 1] < 1e-9 * LENGTH) & (r > (1.0 + 1e-6) * RADII[1])

    held = [(d - 1, dmesh.locate_entities_boundary(mesh, d - 1, but_the_edge))]
    if options.space:
        held += [(0, facet_tags.find("on_y")), (1, facet_tags.find("on_x"))]
    bcs = []
    for component, facets in held:
        W = V.sub(component)
        dofs = fem.locate_dofs_topological(W, d - 1, facets)
        bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, W))

    # ### Contact, dead load and spring
    #
    # The dead load is given as the linear form of its virtual work, the spring as a potential of
    # the displacement.

    load, stiffness, anchor, friction = (fem.Constant(mesh, 0.0) for _ in range(4))
    sides = {"shaft": "around_inner", "hub": "within_outer"}
    other = "hub" if options.slave == "shaft" else "shaft"
    contact = dm.Contact(
        facet_tags, slave=sides[options.slave], master=sides[other], friction=friction
    )
    ds = ufl.Measure("ds", mesh, subdomain_data=facet_tags)
    end, touching = ds(facet_tags.tag("inner_end")), ds(facet_tags.tag(sides[options.slave]))
    problem = dm.ContactProblem(
        solid,
        [contact],
        bcs=bcs,
        loads=load * ufl.TestFunction(V)[d - 1] * end,
        potential=0.5 * stiffness * (u[d - 1] - anchor) ** 2 * end,
    )
    # weight of integrals over the whole body
    weight = (
        fem.Constant(mesh, 1.0) if options.space else 2.0 * np.pi * ufl.SpatialCoordinate(mesh)[0]
    )
    # axisymmetric pressures are per deformed circumference
    around = 1.0 if options.space else 1.0 + u[0] / ufl.SpatialCoordinate(mesh)[0]
    return Fit(
        problem=problem,
        contact=contact,
        whole=4.0 if options.space else 1.0,
        cooling=cooling,
        friction=friction,
        load=load,
        stiffness=stiffness,
        anchor=anchor,
        mean=fem.form(weight * u[d - 1] * end),
        area=comm.allreduce(fem.assemble_scalar(fem.form(weight * end))),
        thrust=fem.form(weight * around * contact.pressure * touching),
    )


# ## The steps
#
# From time 0 to 1 the hub is cooled, from 1 to 2 the dead loads grow, from 2 to 3 the spring pulls.


def main(options: argparse.Namespace) -> None:
    """Cool, pull, compare with the formulas, draw."""
    case, interference = create(options), INTERFERENCE[options.plastic]
    problem, contact, u = case.problem, case.contact, case.problem.u
    pressure = expected_pressure(interference, STRENGTH if options.plastic else np.inf)
    stress = options.friction * pressure * CONTACT / SECTION  # about that in the sliding shaft
    rest = 0.0  # mm, displacement of the end of the shaft when the spring begins to pull

    def drive(t: float) -> None:
        case.cooling.value = -interference / RADII[1] * min(t, 1.0)
        case.friction.value = options.friction if t > 1.0 or options.dry else 0.0
        case.load.value = stress * np.interp(t, np.linspace(1.0, 2.0, 4), (0.0, *PULLED))
        case.stiffness.value = WEAK if t <= 1.0 else STRONG if t > 2.0 else 0.0
        case.anchor.value = rest + 0.9 * stress / STRONG * (t - 2.0) if t > 2.0 else 0.0

    cooled = np.linspace(0.0, 1.0, 9 if options.plastic or options.dry else 2)[1:]
    loaded, pulled = 1.0 + np.arange(1, 4) / 3, np.linspace(2.25, 3.0, 4)
    options.output.mkdir(parents=True, exist_ok=True)
    rows: list[dict] = []
    surfaces: list[dict[str, np.ndarray]] = []
    with dm.Writer(options.output / "shrink_fit.xdmf", problem, notes={"units": "mm, MPa"}) as out:
        for step in dm.load_steps(problem, [*cooled, *loaded, *pulled], on_time=drive):
            out.write(step.time)
            surfaces.append(contact.gather(u))
            start = surfaces[len(cooled) - 1] if step.time > 1.0 else surfaces[-1]
            slid = (surfaces[-1]["slip"] - start["slip"]).max()
            found = measure(case, surfaces[-1], options.slave) | {"slid": slid}
            rows.append(dm.summarise(step) | found)
            if step.time == 2.0:
                rest = rows[-1]["end"]
    found = compare(rows, interference, options)
    dm.write_summary(options.output / "summary.json", problem, rows, options=vars(options), **found)
    if problem.comm.rank == 0:
        show(rows, found)
        figures.draw(options.output / "result.png", rows, surfaces, found)


def measure(case: Fit, nodes: dict[str, np.ndarray], slave: str) -> dict:
    """Return the pulling force (the axial force on the hub), pressures and slipping nodes."""
    contact, on = case.contact, nodes["active"] > 0
    # Lame's pressure is per undeformed area, the pressure of a contact per deformed area
    grown = (np.linalg.norm(nodes[x][:, :-1], axis=1) for x in ("x", "X"))
    p = nodes["pressure"] * np.divide(*grown)
    sign = -1.0 if slave == "shaft" else 1.0
    return {
        "force": sign * case.whole * contact.force[-1],
        "normal_force": case.normal_force(),
        "pressure_min": p.min(),
        "pressure_max": p.max(),
        "pressure_median": float(np.median(p)),
        "traction_max": np.linalg.norm(nodes["traction"], axis=1).max(),
        "closed": int(np.count_nonzero(on)),
        "slipping": int(np.count_nonzero(nodes["status"] == 2)),
        "dissipation": case.whole * contact.dissipation,
        "end": case.end(),
        "plastic_volume": case.whole * case.problem.solid.plastic_area(),
    }


# ## A hub that yields
#
# By Tresca's yield criterion the hub is plastic up to a radius $\rho$ (free ends, no hardening),
# with
#
# $$p = Y \left(\ln \frac{\rho}{c} + \frac12 \left(1 - \frac{\rho^2}{b^2}\right)\right), \qquad
#   u(c) = \frac{Y \rho^2}{E c} - \frac{1 - \nu}{E} c\, p.$$
#
# The pressure of a hub that obeys von Mises' criterion with the same uniaxial yield stress lies
# between those by Tresca's criterion for $Y$ and for $2 Y / \sqrt 3$.


def expected_pressure(interference: float, strength: float) -> float:
    """Return the pressure between a hub that obeys Tresca's criterion and an elastic shaft."""
    a, c, b = RADII
    lame = shrink_fit(interference, RADII, E, NU, E, NU).pressure
    if lame <= 0.5 * strength * (1.0 - (c / b) ** 2):
        return lame

    def pressure(rho: float) -> float:
        return strength * (np.log(rho / c) + 0.5 * (1.0 - (rho / b) ** 2))

    def misfit(rho: float) -> float:
        p = pressure(rho)
        grown = strength * rho**2 / (E * c) - (1.0 - NU) / E * c * p
        shrunk = c * p / E * ((c**2 + a**2) / (c**2 - a**2) - NU)
        return grown + shrunk - interference

    return float(pressure(brentq(misfit, c, b)))


# ## Comparison with the formulas


def compare(rows: list[dict], interference: float, options: argparse.Namespace) -> dict:
    """Return pressures and the sliding force beside the formulas."""
    fitted, held = (next(row for row in rows if row["time"] == t) for t in (1.0, 2.0))
    fit = shrink_fit(interference, RADII, E, NU, E, NU)
    found = {
        "pressure": fitted["pressure_median"],
        "pressure_lame": fit.pressure,
        "held_force": held["force"],
        "held_slipping": held["slipping"],
        "sliding_force": rows[-1]["force"],
        "sliding_force_mu_p_A": options.friction * fitted["pressure_median"] * CONTACT,
        "sliding_force_mu_N": options.friction * rows[-1]["normal_force"],
    }
    if options.plastic:
        found["pressure_tresca"] = expected_pressure(interference, STRENGTH)
        found["pressure_tresca_upper"] = expected_pressure(interference, 2 / 3**0.5 * STRENGTH)
    else:
        found["sliding_force_lame"] = fit.sliding_force(options.friction, LENGTH)
        found["sliding_force_stretched"] = fit.pull_force(options.friction, LENGTH)
    return found


def show(rows: list[dict], found: dict) -> None:
    """Print the tables."""
    print("  time   pull [N]    pressure [MPa]    slipping of closed  slid [µm]  end [µm]")
    for r in rows:
        print(
            f"{r['time']:6.3f} {r['force']:10.1f} {r['pressure_min']:8.2f} to"
            f" {r['pressure_max']:7.2f} {r['slipping']:9d} {r['closed']:9d}"
            f" {1e3 * r['slid']:10.3f} {1e3 * r['end']:9.3f}"
        )
    for name, value in found.items():
        print(f"{name.replace('_', ' ')}: {value:.6g}")


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    chosen = parser.parse_args()
    if not 0.0 < chosen.friction < float("inf"):
        parser.error(f"--friction {chosen.friction}: a positive number")
    if chosen.cells < 0:
        parser.error(f"--cells {chosen.cells}: a positive number, or 0 for the default")
    main(chosen)
