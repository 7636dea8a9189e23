# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # Partial slip: a disc pushed sideways, and the energy of a load cycle
#
# This demo computes contact with Coulomb friction under an alternating tangential load (Cattaneo
# 1938, Mindlin 1949). It shows how to
#
# - add friction to a contact, with a coefficient that is a `Constant` and changes between steps,
# - read tractions, stick and slip states of nodes, and the dissipated energy,
# - compare with the closed solution, `dm.analytic.cattaneo_line`.
#
# **Problem.** In plane strain, a half disc of radius 40 mm is pressed on a block with a force $P$,
# then pushed sideways with $Q < \mu P$, back to $-Q$, and forward again. Both are elastic ($E$ =
# 206.9 GPa, $\nu$ = 0.29), the coefficient of friction is $\mu$ = 0.2. The flat face of the disc is
# displaced: 0.06 mm down, then 0.011 mm to either side. Units: mm, MPa, N per mm.
#
# **Result.** The upper half shows the shear traction during the first push and on the way back,
# computed (points) and by the formula (lines), between the limits $\pm \mu p$ (dotted). The lower
# half shows the half-width $c$ of the stick zone, and the loop of the force over the displacement.
#
# **Compare with.** The middle of the contact sticks, its edges slip. With Hertz' half-width $a$ and
# peak pressure $p_0$ the stick zone and the shear traction are
#
# $$\frac{c}{a} = \sqrt{1 - \frac{Q}{\mu P}}, \qquad
#   q(x) = \mu p_0 \left(\sqrt{1 - \frac{x^2}{a^2}}
#          - \frac{c}{a} \sqrt{1 - \frac{x^2}{c^2}}\right),$$
#
# where the last term applies for $|x| < c$. When the force reverses, the whole contact sticks
# again, and slip spreads from the edges: a change of $Q$ after the reversal has the effect of a
# first load with twice the coefficient of friction. A force that alternates between $-Q$ and $Q$
# therefore describes a closed loop, which dissipates the energy
#
# $$W = \frac{2 \mu^2 P^2}{\pi E^*} \left(1 - k^2 + 2 k \ln k\right), \qquad
#   k = 1 - \frac{Q}{\mu P}, \qquad E^* = \frac{E}{2 (1 - \nu^2)}$$
#
# per unit thickness, for two bodies of one material.
#
# **Options to try.** `--rough` applies friction while the disc is pressed down, too. `--slave disc`
# exchanges slave and master side. `--h` is the element size at the contact. `--geometry updated`
# follows the motion of the surfaces. `--sideways` and `--friction` change the share $Q / \mu P$.

import argparse
import logging
from pathlib import Path

from mpi4py import MPI

import figures
import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem

STEEL = (206_900.0, 0.29)  # MPa, -; the formulas are those of two bodies of one material

parser = argparse.ArgumentParser(description="A disc pushed back and forth, with friction.")
parser.add_argument("--friction", type=float, default=0.2, help="coefficient of friction")
parser.add_argument("--radius", type=float, default=40.0, help="of the disc, in mm")
parser.add_argument("--displacement", type=float, default=0.06, help="of the flat face, in mm")
parser.add_argument("--sideways", type=float, default=0.011, help="of the flat face, in mm")
parser.add_argument(
    "--steps", type=int, default=6, help="of the first push; each later way has twice as many"
)
parser.add_argument("--h", type=float, default=0.05, help="element size at the contact, in mm")
parser.add_argument("--slave", choices=["block", "disc"], default="block")
parser.add_argument("--rough", action="store_true", help="friction while it is pressed down, too")
parser.add_argument("--cell", choices=["triangle", "quadrilateral"], default="triangle")
parser.add_argument("--degree", type=int, choices=[1, 2], default=1, help="of the displacement")
parser.add_argument("--geometry", choices=["reference", "updated"], default="reference")
parser.add_argument("--output", type=Path, default=Path("results/cattaneo"))


def main(options: argparse.Namespace) -> None:
    """Press, push back and forth, compare with the formulas, draw."""
    comm = MPI.COMM_WORLD

    # ## Bodies
    #
    # The formulas are those of half spaces. A disc whose radius is large compared with the
    # half-width of the contact, on a block of three times this radius, approximates them. Elements
    # grow with the distance from the contact.

    R = options.radius
    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        comm,
        kind="graded",
        h=options.h,
        radius=R,
        block=(3.0 * R, 1.5 * R),
        cell=options.cell,
        limit=100.0,
    )
    V = fem.functionspace(mesh, ("Lagrange", options.degree, (2,)))
    solid = dm.Solid(fem.Function(V, name="displacement"), dm.Elastic(*STEEL), cell_tags)

    # ## Supports, contact and friction
    #
    # The block is held at the bottom. The flat face of the disc is displaced, first down and then
    # sideways. Cattaneo's solution starts from a contact without shear traction. The coefficient of
    # friction is therefore a Constant, which is zero until the disc has been pressed down. With
    # `--rough` it has its final value from the beginning: since a disc and a block are not two
    # equal half spaces, pressing down then causes shear tractions of some per cent.

    push, friction = fem.Constant(mesh, np.zeros(2)), fem.Constant(mesh, 0.0)
    bottom, flat = (
        fem.locate_dofs_topological(V, 1, facet_tags.find(side)) for side in ("bottom", "flat")
    )
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, flat, V)]
    slave, master = ("top", "arc") if options.slave == "block" else ("arc", "top")
    contact = dm.Contact(facet_tags, slave=slave, master=master, friction=friction)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry=options.geometry)

    def move(t: float) -> None:
        """Down until t = 1, then to the right (2), to the left (3) and to the right again (4)."""
        sideways = np.interp(t, [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, -1.0, 1.0])
        push.value[:] = sideways * options.sideways, -min(t, 1.0) * options.displacement
        friction.value = options.friction if t > 1.0 or options.rough else 0.0

    # ## Load steps

    n = options.steps
    levels = [1.0, *(1.0 + np.arange(1, n + 1) / n), *(2.0 + np.arange(1, 4 * n + 1) / (2 * n))]
    options.output.mkdir(parents=True, exist_ok=True)
    steps, surfaces = [], []
    with dm.Writer(options.output / "cattaneo.xdmf", problem, notes={"units": "mm, MPa"}) as writer:
        for step in dm.load_steps(problem, levels, on_time=move):
            if step.time in (1.0, 2.0, 3.0, 4.0):
                writer.write(step.time)
            surfaces.append(contact.gather(solid.u))
            steps.append(dm.summarise(step) | measure(contact, options, push.value[0]))
    frozen = options.geometry == "reference"
    surfaces = [centred(nodes, "X" if frozen else "x") for nodes in surfaces]
    rows, states = compare(steps, surfaces, options)
    more = {"options": vars(options), "loop": loop(rows, states)}
    dm.write_summary(options.output / "summary.json", problem, rows, **more)
    if comm.rank == 0:
        show(rows, more["loop"])
        figures.draw(options.output / "result.png", rows, surfaces, states, options.h)


# ## What is measured in a step


def measure(contact: dm.Contact, options: argparse.Namespace, sideways: float) -> dict:
    """Return the forces per unit thickness on the block, and the energy dissipated so far."""
    force = contact.force * (1.0 if options.slave == "block" else -1.0)
    return {
        "sideways": sideways,
        "normal_force": -force[1],
        "tangential_force": force[0],
        "dissipation": contact.dissipation,
    }


def centred(nodes: dict[str, np.ndarray], place: str) -> dict[str, np.ndarray]:
    """Return the slave nodes in the order of x, measured from the centroid of the pressure.

    The disc tilts a little, because it is pushed at its flat face.
    """
    order = np.argsort(nodes[place][:, 0])
    x, p = nodes[place][order, 0], nodes["pressure"][order]
    q = nodes["traction"][order, 0]
    middle = np.trapezoid(p * x, x) / np.trapezoid(p, x)
    return {"x": x - middle, "p": p, "q": q, "status": nodes["status"][order]}


# ## Comparison with the formulas
#
# $a$ and $p_0$ are Hertz' values for the normal force $P$ of the step; $Q$ is the tangential force
# of the step.


def compare(
    steps: list[dict], surfaces: list[dict[str, np.ndarray]], options: argparse.Namespace
) -> tuple[list[dict], list[dm.analytic.PartialSlip | None]]:
    """Add Cattaneo's stick zone, traction and energy to the rows; return his solutions, too."""
    sign = 1.0 if options.slave == "block" else -1.0
    path: list[float] = []  # the forces at which the direction of the push was reversed
    rows, states = [], []
    for step, nodes in zip(steps, surfaces, strict=True):
        nodes["q"] *= sign
        if step["time"] <= 1.0:
            rows.append(step)
            states.append(None)
            continue
        hertz = dm.analytic.hertz_line(step["normal_force"], options.radius, *STEEL * 2)
        limit = options.friction * hertz.force
        # the discretisation error may take the force slightly beyond the one that closes the loop
        bound = min([limit, *(abs(Q) for Q in path)])
        present = float(np.clip(step["tangential_force"], -bound, bound))
        state = dm.analytic.cattaneo_line(hertz, options.friction, (*path, present))
        if step["time"] in (2.0, 3.0):
            path.append(present)
        rows.append(step | beside(state, nodes, options.h))
        states.append(state)
    return rows, states


def beside(state: dm.analytic.PartialSlip, nodes: dict[str, np.ndarray], h: float) -> dict:
    """Return the stick zone and the error of the traction.

    The traction has a kink at each end of a stick zone and of the contact. Errors, in units of
    mu p0: the largest one farther than two facets from all kinks, and the mean over the contact.
    """
    x, q = nodes["x"], nodes["q"]
    a, peak = state.contact.half_width, state.friction * state.contact.peak_pressure
    edges = np.array([a, *state.stick_half_widths])
    error = np.abs(q - state.traction(x)) / peak
    away = (np.abs(np.abs(x)[:, None] - edges) > 2.0 * h).all(axis=1) & (np.abs(x) < a)
    inside = np.abs(x) < a + 2.0 * h
    stick = x[nodes["status"] == 1]
    return {
        "half_width": a,
        "peak_pressure": state.contact.peak_pressure,
        "share": state.force / (state.friction * state.contact.force),
        "stick_half_width": float(np.ptp(stick) / 2) if stick.size else 0.0,
        "stick_half_width_cattaneo": state.stick_half_width,
        "middle_traction": float(np.interp(0.0, x, q)),
        "middle_traction_cattaneo": float(state.traction(0.0)),
        "traction_error": float(error[away].max(initial=0.0)),
        "traction_error_mean": float(np.trapezoid(error[inside], x[inside]) / (2.0 * a)),
        "dissipation_cattaneo": state.dissipation,
    }


# ## The loop
#
# In plane strain the displacement of two half spaces under a force is unbounded, but only its part
# $C Q$, linear in the force, depends on the size of the bodies. The part that slip adds is given by
# the formula. The area of the loop is the dissipated energy, too.


def loop(rows: list[dict], states: list[dm.analytic.PartialSlip | None]) -> dict:
    """Return the energy of the closed loop, by slip and as area, beside the formula."""
    turned = [i for i, row in enumerate(rows) if row["time"] >= 2.0]
    first, last = turned[0], turned[-1]
    s, Q = (np.array([rows[i][name] for i in turned]) for name in ("sideways", "tangential_force"))
    compliance = (rows[first]["sideways"] - states[first].displacement) / states[first].force
    return {
        "dissipation": rows[last]["dissipation"] - rows[first]["dissipation"],
        "area": float(np.sum(0.5 * (Q[1:] + Q[:-1]) * np.diff(s))),
        "cattaneo": states[last].dissipation - states[first].dissipation,
        "closed_by": abs(Q[-1] / Q[0] - 1.0),
        "compliance": compliance,
    }


def show(rows: list[dict], found: dict) -> None:
    """Print the table."""
    print("sideways      P        Q     Q/(mu P)    c/a  Cattaneo   error of q  mean error   W")
    for r in rows:
        if "share" not in r:
            continue
        print(
            f"{r['sideways']:8.5f} {r['normal_force']:9.2f} {r['tangential_force']:9.3f}"
            f" {r['share']:8.3f} {r['stick_half_width'] / r['half_width']:9.3f}"
            f" {r['stick_half_width_cattaneo'] / r['half_width']:7.3f}"
            f" {r['traction_error']:11.2%} {r['traction_error_mean']:11.2%}"
            f" {r['dissipation']:11.4e}"
        )
    W = found["cattaneo"]
    print(
        f"closed loop: {found['dissipation']:.5e} N ({found['dissipation'] / W - 1:+.2%}), area"
        f" {found['area']:.5e} ({found['area'] / W - 1:+.2%}), formula {W:.5e}"
    )


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    chosen = parser.parse_args()
    if chosen.steps < 1:
        parser.error(f"--steps {chosen.steps}: at least 1")
    if not 0.0 < chosen.friction < float("inf"):
        parser.error(f"--friction {chosen.friction}: a positive number")
    main(chosen)
