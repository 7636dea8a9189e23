# SPDX-License-Identifier: MIT
"""Causes of failed steps: limit loads, unsupported bodies, friction."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.tool import Tool
from dolfinx_mortar.mortar.facing_bodies import facing_edges
from dolfinx_mortar.mortar.surface import accumulate, mean_facet_length
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.step_report import NewtonNotConverged, Note, StepReport
from dolfinx_mortar.supports.bodies import name_of
from dolfinx_mortar.terms.pressure import Pressure

# Softness u.K u / u.K_e u at a limit load: up to 3e-5 (von Mises) or 6e-3 (Drucker-Prager) in
# failed steps without hardening; with modulus H about H / E, .05 and more for metals.
SOFT = 0.01
# Stretch of nearly inverted cells: 0 to .1 in steps that ended by it (rubber, metal pressed to a
# fifth), .69 and more in others.
SQUEEZED = 0.3
AS_BEFORE = (
    ". The displacement and the committed state are as before the step: retry with a smaller one "
    "(dm.load_steps does); problem.diagnose() says more"
)
MOVES_AWAY = (
    "What contact alone holds moves away if the loads do not press the sides together, or it "
    "slides or rolls freely (then prescribe that motion)"
)
TOO_MUCH = {
    True: "The loads may exceed what friction carries (then prescribe displacements instead of "
    "forces), the step may be too large for it (then take smaller ones), or friction of at least "
    "the cotangent of an angle between sides and supports wedges a body fast (then release it)",
    False: "The step may be too large for friction (then take smaller ones), or drag a body that "
    "friction does not hold (then support it) or wedges fast between sides and supports at an "
    "angle (then release it)",
}
UNSTABLE = {
    True: "Beyond a limit point of loads tangents are indefinite: if they exceed what the bodies "
    "carry, prescribe displacements instead of forces or pressures",
    False: "Tangents are indefinite where bodies buckle or snap. Displacements are prescribed "
    "already, so take smaller steps, and give a symmetric mesh an imperfection; if small steps "
    "fail, too, the next equilibrium is far away: prescribe the displacement of another point, or "
    "follow the motion in time, dm.time_steps with dm.Inertia",
}
IN_CORNER = "at ({}) the body reaches into an inner corner of the tool, which has no one normal"
ROUND_IT = (
    "there: give each side of the body its own tag and Obstacle with one face of the tool, or "
    "round the corner of the tool by a radius of a quarter of a facet to a whole one"
)
AT_FACETS = "around X = ({}) an edge or a corner of the master lies at facets of the slave side"
EXCHANGE = (
    "where a gap is a mean over both flanks of an edge, not even in small steps: exchange slave "
    "and master, or refine the slave there"
)
HARDEN = "or give the law hardening"
# Blocks of MooneyRivlin (NeoHooke), K/mu = 500, between smooth plates become unstable at a height
# of .62 (.64) with quadrilaterals of degree 2, of .54 as a continuum.
BY_THEMSELVES = (
    "Under compression by 30 % or more, cells of degree 2 with volumetric='reduced' may buckle "
    "by themselves, in waves as long as cells: compare with cells of degree 1 or, where the law is "
    "compressible, with volumetric='full'"
)


class StepFailed(Exception):
    """A step failed; nothing has been undone or diagnosed yet."""

    def __init__(self, seen: str, why: str = "") -> None:
        """Set message and explanation."""
        super().__init__(seen)
        self.why = why


def failed(problem: ContactProblem, report: StepReport, seen: str, *why: str) -> NewtonNotConverged:
    """Error of a step; `ContactProblem.diagnose` explains it."""
    note = Note(seen, ". ".join(filter(None, why)))
    problem.told[:] = report.notes, [note]
    return NewtonNotConverged(f"{seen}{AS_BEFORE}", report)


def explain(
    problem: ContactProblem, report: StepReport, error: Exception, at: Floats
) -> NewtonNotConverged:
    """Error of a failed step that ended ``at`` u, with ghosts, and is undone; collective."""
    seen, why = str(error), [getattr(error, "why", "")]
    if not isinstance(error, StepFailed):
        seen = f"the QP of Newton iteration {len(report.iterations) + 1}: {seen.rstrip('. ')}"
    flowing, squeezed = _look_at(problem, at)
    if flowing:  # solvers report a singular matrix as a free body
        report.notes.append(seen)
        seen, least = flowing, "reduce the load" if is_loaded(problem) else "take smaller steps"
        why = [f"Without hardening a law carries no more than its limit load: {least}, {HARDEN}"]
    elif held := problem.held_by_contact():
        seen += f"; contact alone holds {'; '.join(held)}"
        if problem.system.has_friction:
            why.append(TOO_MUCH[is_loaded(problem)])
        why.append(MOVES_AWAY)
    inverted = bool(squeezed) or "inside out" in seen
    shifted, count = sum(it.shift > 0.0 for it in report.iterations), len(report.iterations)
    if 2 * shifted > count and (not inverted or is_loaded(problem)):
        seen += f"; the tangent was indefinite in {shifted} of {count} iterations"
        why += [UNSTABLE[is_loaded(problem)], describe_cells(problem)]
    if squeezed and "inside out" not in seen:
        seen += f"; where it ended, {squeezed}"
        why.append("Take smaller load steps, or compress it less")
    return failed(problem, report, seen, *why, *_pressures(problem), _own_laws(problem))


def _look_at(problem: ContactProblem, u: Floats) -> tuple[str, str]:
    """Flowing body and shortened cells at a displacement; collective."""
    before, shown = problem.u.x.array.copy(), problem.solid.points.keep()
    try:
        problem.u.x.array[:] = u
        flowing = _flow(problem)
        finite = problem.solid.strain == "finite"
        return flowing, problem.solid.gradients.describe_shortened(SQUEEZED) if finite else ""
    finally:
        problem.u.x.array[:] = before
        problem.solid.points.put_back(shown)


def describe_cells(problem: ContactProblem) -> str:
    """Warning about unstable cells of degree 2, or ""."""
    second = problem.V.element.basix_element.degree > 1
    return BY_THEMSELVES if second and problem.solid.volumetric == "reduced" else ""


def is_loaded(problem: ContactProblem) -> bool:
    """Whether terms or tool loads act; collective."""
    driven = any(link.interface.driven() is not None for link in problem.system.links)
    return driven or problem.terms.assemble_forces(problem.K.createVecLeft()) > 0.0


def _pressures(problem: ContactProblem) -> list[str]:
    told, where = [], "where the surface is closed, or its edges are held or slide in planes "
    where += "through the origin"
    for name, term in problem.terms.named:
        if not isinstance(term, Pressure) or term.has_potential(~problem.supports.owned):
            continue
        if term.energy() is None:
            remedy = (
                "" if problem.solid.kinematics.plane_stress else f", or say closed=True {where}"
            )
            told.append(
                f"{name}, has no potential, so that steps are whole, without a line search: take "
                f"smaller load steps{remedy}"
            )
        else:
            told.append(
                f"{name}: closed=True holds {where}, with a uniform p, and does not hold "
                "here: leave it out"
            )
    return told


def _own_laws(problem: ContactProblem) -> str:
    package = __name__.partition(".")[0]
    kinds = {type(law): None for region in problem.solid.regions for law, _ in region.parts}
    own = [kind.__name__ for kind in kinds if not kind.__module__.startswith(f"{package}.")]
    told = (
        f"{', '.join(own)}: {package}.materials.check tells whether the potential of a law is "
        "convex and its tangent the derivative of its stress"
    )
    return told if own else ""


def _flow(problem: ContactProblem) -> str:
    """Body at a limit load, where u.K u is small beside u.K_e u; collective."""
    solid, u = problem.solid, problem.u
    try:
        solid.evaluate()
    except ValueError:
        return ""
    solid.assemble_tangent(problem.K)
    step = problem.vector(problem.owned_u)
    if not step.dot(problem.K * step) < SOFT * solid.elastic_norm(u) ** 2:
        return ""
    flowing, weights = solid.points.flowing(), solid.fields.weights
    body, count = problem.bodies.of_cells[: len(weights)], problem.bodies.count
    parts = [(weights * part).sum(axis=1) for part in (flowing, np.ones_like(weights))]
    volumes = np.stack([np.bincount(body, part, minlength=count) for part in parts])
    flow, whole = problem.comm.allreduce(volumes, op=MPI.SUM)
    most = int(np.argmax(flow / whole))
    if flow[most] == 0.0:
        return ""
    return (
        f"limit load? {name_of(problem.bodies, [most])} flows in "
        f"{100 * flow[most] / whole[most]:.0f} % of its volume at the last iterate"
    )


def with_corners(problem: ContactProblem, error: StepFailed) -> StepFailed:
    """Error with corners without a normal, a possible cause; collective."""
    seen, why, x = list[str](), [error.why], problem.positions()
    for link in problem.system.unilateral:
        where, tool = "", link.interface.tool
        if tool is not None:
            where, what, remedy = _tool_corners(link, tool, x), IN_CORNER, ROUND_IT
        elif link.pairing is not None and not link.sides.meet_themselves:
            where, what, remedy = _master_corners(link, x), AT_FACETS, EXCHANGE
        if where:
            seen.append(f"{link.interface!r}: {what.format(where)}")
            why.append(f"Newton's method need not converge {remedy}")
    told = StepFailed(". ".join(["; ".join(seen), str(error)]), ". ".join(filter(None, why)))
    return told if seen else error


def _master_corners(link: Link, x: PETSc.Vec) -> str:
    """Place where an edge or corner of the master presses on slave facets; collective."""
    pairing, operators = link.mortar
    slave, comm = link.sides.slave, link.sides.V.mesh.comm
    near, length = np.zeros(len(slave.nodes)), mean_facet_length(slave)
    near[: slave.owned] = link.coupling.kept[:, 0] & (np.abs(link.gaps(x)) <= length)
    faced = facing_edges(pairing, operators.segments, link.interface.feature_angle)
    found = faced & (accumulate(slave, near) > 0)[slave.facets].any(axis=1)
    return _first_place(comm, slave.X[slave.facets[found]].mean(axis=1), length)


def _tool_corners(link: Link, tool: Tool, x: PETSc.Vec) -> str:
    """Place where nodes lie in an inner corner of the tool; collective."""
    comm, d = link.sides.V.mesh.comm, link.sides.fixed.shape[1]
    at = x.array_r.reshape(-1, d)[link.nodes][link.coupling.kept[:, 0]]
    length, pose = mean_facet_length(link.sides.slave), tool.pose()
    with raised_together(comm):
        near = at[np.abs(pose.distance(tool.asked, at).value) <= length]
        ridge = np.zeros(len(near), dtype=bool)
        for way in np.eye(d):
            beside = 0.25 * length * way
            ahead, behind = (pose.distance(tool.asked, near + s * beside) for s in (1, -1))
            turn = (ahead.gradient - behind.gradient) @ way
            ridge |= turn <= -2.0 * np.sin(np.radians(0.5 * FEATURE_ANGLE))
    return _first_place(comm, near[ridge], length)


def _first_place(comm: MPI.Comm, places: Floats, length: float) -> str:
    """Coordinates of the first of places (p, d) of all ranks, or ""."""
    told = [place for part in comm.allgather(places[:1].tolist()) for place in part][:1]
    least = HALF_OF_DIGITS * length
    return ", ".join(f"{c if abs(c) > least else 0.0:.3g}" for place in told for c in place)
