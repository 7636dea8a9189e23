# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Hardness: indentation of a metal by a cone, a ball or a pyramid
#
# This demo computes instrumented indentation with rigid tools, loading and unloading, at finite
# strain. It shows how to
#
# - describe rigid tools without a mesh by their distance functions: `dm.shapes.Cone`,
#   `dm.shapes.Sphere`, `dm.shapes.berkovich`,
# - move a tool through a load table, and read its force,
# - determine hardness and modulus from the curve, and from the true contact area.
#
# **Problem.** A rigid tool is pressed 1 micrometre into a half-space of elastic, perfectly plastic
# material ($E$ = 200 GPa, $\nu$ = 0.3, yield stress $Y$ = 1 GPa) and withdrawn, without friction.
# `--tool` chooses one or several of a cone with an angle of 70.3 degrees to its axis, which
# displaces the same volume as Berkovich's pyramid at the same depth; that pyramid, in 3D, of which
# a sixth is modelled; and a ball of radius 40 micrometres. Units: micrometres, GPa, mN.
#
# **Result.** The picture has one row for each tool. On the left is the force $P$ over the depth $h$
# and the slope $S$ at the start of unloading. On the right is the surface at the largest depth with
# the contact pressure, for the pyramid as a map with the nodes in contact. The material piles up
# beside the cone and the pyramid.
#
# **Compare with.** The method of Oliver and Pharr (1992) computes hardness $H$ and reduced modulus
# $E_r$ from the curve,
#
# $$h_c = h_\max - \epsilon \frac{P_\max}{S}, \qquad A = A(h_c), \qquad
#   H = \frac{P_\max}{A}, \qquad E_r = \frac{\sqrt\pi}{2 \beta} \frac{S}{\sqrt A},$$
#
# with the slope $S = dP/dh$ at the start of unloading, the cross-section $A(h)$ of the tool,
# $\epsilon = 0.75$ (exact for a paraboloid, and used for Berkovich's pyramid by experience) and
# $E_r = E / (1 - \nu^2)$ for a rigid tool. Where material piles up, the contact is larger than
# $A(h_c)$, so that the method overestimates modulus and hardness (Bolshakov and Pharr 1998, who
# find areas wrong by up to 60 %). The computation also gives the true area. With it the modulus
# should be the given one, and the hardness nearly three yield stresses (Tabor 1951).
#
# The factor $\beta$ is 1 for a circular punch, and 1.034 for a flat punch with Berkovich's
# cross-section (King 1987). For a cone it is (Hay, Bolshakov and Pharr 1999)
#
# $$\beta = \pi \frac{\pi/4 + 0.15483073 \cot\alpha\, q}{(\pi/2 - 0.83119312 \cot\alpha\, q)^2},
#   \qquad q = \frac{1 - 2\nu}{4 (1 - \nu)}.$$
#
# On an elastic half-space, `--elastic`, the forces to compare with are for the cone this factor
# times Sneddon's force (1948), for the ball Hertz' force, and for the pyramid a fit of Larsson and
# others (1996) to their computations:
#
# $$P = \frac{2 \beta}{\pi} E_r \tan\alpha\, h^2, \qquad P = \tfrac43 E_r \sqrt{R h^3},$$
#
# $$P = 2.1891\, (1 - 0.21 \nu - 0.01 \nu^2 - 0.41 \nu^3) E_r h^2.$$
#
# In the elasto-plastic case, too, the first forces of the ball are those of Hertz; at the end the
# mean pressure $p$ is the hardness. In between, Johnson (1970) models the contact as half a
# spherical cavity with the contact radius $a$ in an elasto-plastic space, which is expanded by the
# volume that the ball displaces. An increment $da$ displaces the volume $\pi a^3 / R\, da$, and the
# wall of the cavity, of area $2 \pi a^2$, moves by this volume over its area. With Hill's solution
# for the cavity (1950), and two thirds of a yield stress added since the core is not a fluid,
#
# $$\frac pY = \frac23 \left[2 + \ln \frac{E a / (Y R) + 4 (1 - 2 \nu)}{6 (1 - \nu)}\right].$$
#
# This holds until the plastic flow reaches the surface, at $E a / (Y R)$ of about 30.
#
# **Options to try.** `--tool cone ball berkovich` computes all three tools. `--elastic` compares
# with the formulas for elastic half-spaces. `--h` is the element size at the tip of the cone,
# `--steps` the number of steps of loading.
#
# *Sources.* W. C. Oliver, G. M. Pharr, J. Mater. Res. 7 (1992) 1564 and 19 (2004) 3; A. Bolshakov,
# G. M. Pharr, J. Mater. Res. 13 (1998) 1049; J. C. Hay, A. Bolshakov, G. M. Pharr, J. Mater. Res.
# 14 (1999) 2296; R. B. King, Int. J. Solids Struct. 23 (1987) 1657; I. N. Sneddon, Proc. Camb.
# Phil. Soc. 44 (1948) 492; P.-L. Larsson and others, Int. J. Solids Struct. 33 (1996) 221; K. L.
# Johnson, J. Mech. Phys. Solids 18 (1970) 115; R. Hill, The Mathematical Theory of Plasticity
# (1950), chapter V; D. Tabor, The Hardness of Metals (1951). Of Bolshakov and Pharr the abstract
# was read. The formulas of Oliver and Pharr, King, Hay and Larsson were compared with the manual of
# another program for such tests (NIMS, D. Mercier). Johnson's formula was derived anew, for a rigid
# ball. Tabor's book was not available; others give 2.8 to 3.0 as generally accepted (Y.
# Tirupataiah, Metall. Trans. A 22 (1991) 2375).

import argparse
import logging
from pathlib import Path
from typing import Any

import figures
import numpy as np
from tools import DEPTH, TOOLS, TOP, Ball, Tool

import dolfinx_mortar as dm
from dolfinx import fem

E, NU, STRENGTH = 200.0, 0.3, 1.0  # GPa, -, GPa
REDUCED = E / (1.0 - NU**2)
OUT = np.array([1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1])  # of the elastic recovery

parser = argparse.ArgumentParser(description="A rigid tool pressed into a metal and withdrawn.")
parser.add_argument("--tool", choices=list(TOOLS), nargs="+", default=["cone"])
parser.add_argument("--h", type=float, default=0.15, help="element size at a cone's tip")
parser.add_argument("--steps", type=int, default=16, help="of loading; a quarter for the pyramid")
parser.add_argument("--elastic", action="store_true", help="an elastic half-space")
parser.add_argument("--output", type=Path, default=Path("results/hardness"))


def main(options: argparse.Namespace) -> None:
    """Load and unload with each tool; write summaries and the picture."""
    options.output.mkdir(parents=True, exist_ok=True)
    results = [indent(name, options) for name in options.tool]
    if results[0].problem.comm.rank == 0:
        figures.draw(options.output / "result.png", results)
        for result in results:
            print(result.name)
            for name, value in result.found.items():
                print(f"  {name.replace('_', ' ')}: {value:.4g}")


# ## Loading and unloading
#
# The slope at the start of unloading is that of a parabola through the last point of loading and
# the first two points of unloading. The tool is then withdrawn until the force is zero.


def indent(name: str, options: argparse.Namespace) -> figures.Result:
    """Press one tool in and withdraw it; write its summary."""
    tool = TOOLS[name]()
    domain, facets = tool.block(options.h)
    V = fem.functionspace(domain, ("Lagrange", 1, (domain.geometry.dim,)))
    u = fem.Function(V, name="displacement")
    yielding = dm.VonMises.from_uniaxial(E, NU, yield_stress=STRENGTH, plastic_modulus=0.0)
    solid = dm.Solid(
        u,
        dm.Elastic(E, NU) if options.elastic else yielding,
        strain="small" if options.elastic else "finite",
        volumetric="reduced",
        **tool.kinematics,
    )
    contact = dm.Obstacle(facets, slave=TOP, shape=tool.shape)
    problem = dm.ContactProblem(
        solid,
        [contact],
        bcs=tool.supports(V),
        potential=tool.potential(u, facets, E),
        geometry="reference" if options.elastic else "updated",
    )
    steps = max(options.steps // tool.sparse, 1)
    loading = DEPTH * (np.arange(1, steps + 1) / steps) ** tool.power
    unloading = DEPTH - tool.recovery * OUT
    levels = loading if options.elastic else np.concatenate([loading, unloading])

    rows, surfaces = [], []
    path, start = np.arange(0.0, len(levels) + 1.0), contact.position.value.copy()
    down = np.zeros((len(path), len(start)))
    down[1:, -1] = levels
    table = list(zip(path, start - down, strict=True))
    for step in dm.load_steps(problem, path[1:], ramp={contact.position: table}):
        surfaces.append(contact.gather(u))
        row = {"depth": float(levels[step.number - 1])}
        row["force"] = tool.share * float(contact.tool_force[-1])
        row["area"] = tool.touched(surfaces[-1])
        rows.append(dm.summarise(step) | row)
    found = compare_elastic(tool, rows) if options.elastic else compare(tool, rows, steps)
    dm.write_summary(options.output / f"{name}.json", problem, rows, found=found)
    return figures.Result(name, tool, problem, rows, surfaces[steps - 1], found)


# ## Results


def compare(tool: Tool, rows: list[dict[str, Any]], last: int) -> dict[str, float]:
    """Return hardness and modulus by Oliver and Pharr, and by the true area of contact."""
    top, out = rows[last - 1], rows[last - 1 : last + 2]
    S = np.polyfit([row["depth"] - DEPTH for row in out], [row["force"] for row in out], 2)[1]
    area = {
        "oliver_pharr": tool.area(DEPTH - tool.epsilon * top["force"] / S),
        "contact": top["area"],
    }
    found = {"slope": float(S)}
    found["piled_up"] = float(np.sqrt(area["contact"] / area["oliver_pharr"]))
    for name, a in area.items():
        modulus = 0.5 * np.sqrt(np.pi / a) * S / tool.beta(NU)
        found[f"modulus_{name}"] = float(modulus * (1.0 - NU**2))
        found[f"hardness_{name}"] = float(top["force"] / a)
    found |= {"modulus_given": E, "yield_stress": STRENGTH}
    if isinstance(tool, Ball):
        found["first_force_over_hertz"] = over_theory(tool, rows[0])
        for row in rows[:last]:
            row["pressure_cavity"] = tool.cavity(row["area"], E, NU, STRENGTH)
    return found


def compare_elastic(tool: Tool, rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the force over that of Hertz, Larsson, or Sneddon times beta."""
    return {"force_over_theory": over_theory(tool, rows[-1])}


def over_theory(tool: Tool, row: dict[str, Any]) -> float:
    """Return the force over that on an elastic half-space."""
    return float(row["force"] / tool.elastic(row["depth"], REDUCED, NU))


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    chosen = parser.parse_args()
    if not 0.0 < chosen.h <= 0.5:
        parser.error(f"--h {chosen.h}: a positive number, at most 0.5")
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    main(chosen)
