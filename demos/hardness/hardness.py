# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Hardness: a cone is pressed into a metal, and drawn out
#
# A rigid cone of 70.3 degrees to its axis displaces as much as Berkovich's pyramid. It is a
# `dm.shapes.Cone`, a tool without a mesh, and the metal a half-space of elastic, ideally plastic
# material at finite strain, of which the half section is enough. What an instrument would measure
# is the force $P$ over the depth $h$, and what it makes of it (Oliver and Pharr 1992) is
#
# $$h_c = h_\max - \epsilon \frac{P_\max}{S}, \qquad A = \pi (h_c \tan\alpha)^2, \qquad
#   H = \frac{P_\max}{A}, \qquad E_r = \frac{\sqrt\pi}{2 \beta} \frac{S}{\sqrt A},$$
#
# with the slope $S = dP/dh$ where unloading begins, $\epsilon = 0.75$ and $E_r = E / (1 - \nu^2)$
# of a rigid tool. Here the contact is known, too: where metal piles up beside the tool it is wider
# than $h_c$ says, so that Oliver and Pharr find too large a modulus and hardness (Bolshakov and
# Pharr 1998). With its true area both come out: the modulus that was put in, and the hardness of
# nearly three yield stresses (Tabor 1951). The slope of a cone that is not flat is larger than
# that of a punch by the factor of Hay, Bolshakov and Pharr (1999), eq. 20,
#
# $$\beta = \pi \frac{\pi/4 + 0.15483073 \cot\alpha\, q}{(\pi/2 - 0.83119312 \cot\alpha\, q)^2},
#   \qquad q = \frac{1 - 2\nu}{4 (1 - \nu)},$$
#
# by which the force on an elastic half-space, `--elastic`, is larger than Sneddon's
# $P = 2/\pi\, E_r \tan\alpha\, h^2$, too. Units: micrometres, GPa, mN.

import argparse
import logging
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

E, NU, STRENGTH = 200.0, 0.3, 1.0  # GPa, -, GPa
ANGLE, TIP, DEPTH = 70.3, 0.05, 1.0  # degrees, micrometres
SIZE = 120.0  # micrometres, depth and radius of the block
TOP = 1  # facet tag
Marker = Callable[[np.ndarray], np.ndarray]

parser = argparse.ArgumentParser(description="A cone pressed into a metal, and drawn out.")
parser.add_argument("--h", type=float, default=0.1, help="element size at the tip, in micrometres")
parser.add_argument("--steps", type=int, default=20, help="steps of loading")
parser.add_argument("--elastic", action="store_true", help="a half-space that does not yield")
parser.add_argument("--output", type=Path, default=Path("results/hardness"))


# ## A block that is fine at the tip


def block(h: float) -> tuple[mesh.Mesh, mesh.MeshTags]:
    """Return a mesh of the half section, graded away from the tip, with its top side tagged."""
    fine = 4.0 * DEPTH
    steps = h * 1.2 ** np.arange(1, 1 + int(np.log(SIZE / h) / np.log(1.2)))
    x = np.concatenate([h * np.arange(int(fine / h) + 1), fine + np.cumsum(steps)])
    x = x[x < SIZE]
    n = len(x) - 1
    domain = mesh.create_rectangle(
        MPI.COMM_WORLD, [[0, 0], [n, n]], [n, n], mesh.CellType.quadrilateral
    )
    r, z = domain.geometry.x[:, 0], domain.geometry.x[:, 1]
    r[:] = np.interp(r, np.arange(n + 1), x)
    z[:] = -np.interp(n - z, np.arange(n + 1), x)
    top = mesh.locate_entities_boundary(domain, 1, lambda p: np.isclose(p[1], 0.0))
    return domain, mesh.meshtags(domain, 1, top, np.full(len(top), TOP, dtype=np.int32))


# ## In, and out


def main(options: argparse.Namespace) -> None:
    """Press and draw out; write the summary and the picture, and compare."""
    domain, facets = block(options.h)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    yielding = dm.VonMises.from_uniaxial(E, NU, yield_stress=STRENGTH, plastic_modulus=0.0)
    solid = dm.Solid(
        u,
        dm.Elastic(E, NU) if options.elastic else yielding,
        kinematics="axisymmetric",
        strain="small" if options.elastic else "finite",
        volumetric="reduced",
    )
    bottom = -float(domain.comm.allreduce(-domain.geometry.x[:, 1].min(), op=MPI.MAX))
    bcs = [
        support(V, 0, lambda x: np.isclose(x[0], 0.0)),
        support(V, 1, lambda x: np.isclose(x[1], bottom)),
    ]
    cone = dm.shapes.Cone((0.0, 0.0), ANGLE, (0.0, 1.0), radius=TIP)
    tool = dm.Obstacle(facets, slave=TOP, shape=cone)
    geometry = "reference" if options.elastic else "updated"
    problem = dm.ContactProblem(solid, [tool], bcs=bcs, geometry=geometry)

    # Where unloading begins the slope is that of the first hundredth; then down to no force.
    loading = np.linspace(0.0, DEPTH, options.steps + 1)[1:]
    unloading = DEPTH - np.array([0.005, 0.01, 0.02, 0.04, 0.06, 0.08])
    levels = loading if options.elastic else np.concatenate([loading, unloading])

    rows, surfaces = [], []
    path = np.arange(1, len(levels) + 1, dtype=float)
    table = [(0.0, (0.0, 0.0)), *((t, (0.0, -d)) for t, d in zip(path, levels, strict=True))]
    for step in dm.load_steps(problem, path, ramp={tool.position: table}):
        surfaces.append(tool.gather(u))
        depth = float(levels[step.number - 1])
        row = {"depth": depth, "force": float(tool.tool_force[1])}
        rows.append(dm.summarise(step) | row | {"radius": edge(surfaces[-1])})
    found = compare_elastic(rows) if options.elastic else compare(rows, options.steps)
    options.output.mkdir(parents=True, exist_ok=True)
    dm.write_summary(options.output / "summary.json", problem, rows, found=found)
    if domain.comm.rank == 0:
        figures.draw(options.output / "result.png", rows, surfaces[options.steps - 1], found)
        for name, value in found.items():
            print(f"{name.replace('_', ' ')}: {value:.4g}")


def support(V: fem.FunctionSpace, component: int, where: Marker) -> fem.DirichletBC:
    """Hold a component."""
    W = V.sub(component)
    dofs = fem.locate_dofs_geometrical((W, W.collapse()[0]), where)[0]
    return fem.dirichletbc(fem.Constant(V.mesh, 0.0), dofs, W)


# ## What comes out


def edge(nodes: dict[str, np.ndarray]) -> float:
    """Return the contact radius: half-way between the last node in contact and the next one."""
    r = nodes["x"][:, 0]
    order = np.argsort(r)
    on = np.flatnonzero(nodes["pressure"][order] > 0.0)
    return float(r[order][on[-1] : on[-1] + 2].mean()) if on.size else 0.0


def factor() -> float:
    """Return the factor of Hay, Bolshakov and Pharr."""
    q = (1.0 - 2.0 * NU) / (4.0 * (1.0 - NU)) / np.tan(np.radians(ANGLE))
    return float(np.pi * (np.pi / 4 + 0.15483073 * q) / (np.pi / 2 - 0.83119312 * q) ** 2)


def compare(rows: list[dict], last: int) -> dict:
    """Return hardness and modulus by Oliver and Pharr, and by the true area of contact."""
    top, tangent = rows[last - 1], np.tan(np.radians(ANGLE))
    out = rows[last - 1 : last + 2]
    S = np.polyfit([row["depth"] - DEPTH for row in out], [row["force"] for row in out], 2)[1]
    depth = DEPTH - 0.75 * top["force"] / S
    area = {"oliver_pharr": np.pi * (depth * tangent) ** 2, "contact": np.pi * top["radius"] ** 2}
    found = {"slope": float(S), "piled_up": float(top["radius"] / (depth * tangent))}
    for name, a in area.items():
        reduced = 0.5 * np.sqrt(np.pi / a) * S / factor()
        found[f"modulus_{name}"] = float(reduced * (1.0 - NU**2))
        found[f"hardness_{name}"] = float(top["force"] / a)
    return found | {"modulus_given": E, "yield_stress": STRENGTH}


def compare_elastic(rows: list[dict]) -> dict:
    """Return the force over that of Sneddon, and the factor by which it should be larger."""
    sneddon = 2.0 / np.pi * E / (1.0 - NU**2) * np.tan(np.radians(ANGLE))
    ratio = rows[-1]["force"] / (sneddon * rows[-1]["depth"] ** 2)
    return {"force_over_sneddon": float(ratio), "factor": factor()}


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    chosen = parser.parse_args()
    if not 0.0 < chosen.h <= 0.5:
        parser.error(f"--h {chosen.h}: a positive number, at most 0.5")
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    main(chosen)
