# SPDX-License-Identifier: MIT
"""Steps in which bodies pass through each other, and causes of failed steps."""

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, is_defined_here, largest
from dolfinx_mortar.audit.audit import find_free_motions
from dolfinx_mortar.common.arrays import Floats
from dolfinx_mortar.common.spaces import with_values
from dolfinx_mortar.common.step_report import NewtonNotConverged, Note, StepReport
from dolfinx_mortar.mortar.passing import (
    Passing,
    find_middles,
    find_passed,
    find_passed_tool,
    is_far,
)
from dolfinx_mortar.mortar.surface import cells_of
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.terms.loads import Pressure

# Softness u.K u / u.K_e u at a limit load: at most 6e-3 without hardening, .05 and more for metals.
SOFT = 0.01
# Stretch of cells that are nearly inverted: 0 to .1; that of others is .69 and more.
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
CORNERS = (
    "Newton's method need not converge, not even in small steps, where gaps are means over both "
    "flanks of an edge or a corner of the master: exchange slave and master, or refine the slave "
    "there. Nor in inner corners of a tool, which have no one normal: give each side of the body "
    "its own tag and Obstacle with one face of the tool, or round the corner of the tool by a "
    "radius of a quarter of a facet to a whole one"
)
WITHOUT_EFFECT = (
    "Dirichlet data prescribe all nodes of its slave side and move them through the master: no "
    "slave node has a multiplier, so that the contact has no effect; let the other side be the "
    "slave"
)
NO_POTENTIAL = (
    "has no potential, so that steps are whole, without a line search, or fail: take smaller load "
    "steps"
)
CLOSED = (
    "closed=True of a Pressure holds where the surface is closed, or its edges are held or slide "
    "in planes through the origin, with a uniform p: say it there, and elsewhere leave it out"
)
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
    elif problem.system.unilateral and not why[0]:
        why = [CORNERS]
    parts = problem.bodies, problem.system, problem.supports
    loaded, finite = is_loaded(problem), problem.solid.strain == "finite"
    before, shown = problem.u.x.array.copy(), problem.solid.points.keep()
    try:
        problem.u.x.array[:] = at
        flowing = _flow(problem)
        squeezed = problem.solid.gradients.describe_shortened(SQUEEZED) if finite else ""
    finally:
        problem.u.x.array[:] = before
        problem.solid.points.put_back(shown)
    if flowing:  # solvers report a singular matrix as a free body
        report.notes.append(seen)
        least = "reduce the load" if loaded else "take smaller steps"
        limit = "Without hardening a law carries no more than its limit load"
        seen, why = flowing, [f"{limit}: {least}, or give the law hardening"]
    elif held := find_free_motions(*parts, problem.terms.resistance())[1]:
        seen += f"; contact alone holds {'; '.join(held)}"
        if problem.system.has_friction:
            why.append(TOO_MUCH[loaded])
        why.append(MOVES_AWAY)
    inverted = bool(squeezed) or "inside out" in seen
    shifted, count = sum(it.shift > 0.0 for it in report.iterations), len(report.iterations)
    if 2 * shifted > count and (not inverted or loaded):
        seen += f"; the tangent was indefinite in {shifted} of {count} iterations"
        why += [UNSTABLE[loaded], describe_cells(problem)]
    if squeezed and "inside out" not in seen:
        seen += f"; where it ended, {squeezed}"
        why.append("Take smaller load steps, or compress it less")
    return failed(problem, report, seen, *why, *_hints_on_terms_and_laws(problem))


def _hints_on_terms_and_laws(problem: ContactProblem) -> list[str]:
    hints = [
        f"{name}, {NO_POTENTIAL}"
        for name, term in problem.terms.named
        if isinstance(term, Pressure) and not term.has_potential(~problem.supports.owned)
    ]
    if hints and not problem.solid.kinematics.plane_stress:
        hints.append(CLOSED)
    kinds = {type(law): None for region in problem.solid.regions for law, _ in region.parts}
    own = [kind.__name__ for kind in kinds if not is_defined_here(kind)]
    if own:
        hints.append(
            f"{', '.join(own)}: dolfinx_mortar.materials.check tells whether the potential of a "
            "law is convex and its tangent the derivative of its stress"
        )
    return hints


def describe_cells(problem: ContactProblem) -> str:
    """Warning about unstable cells of degree 2, or ""."""
    second = problem.V.element.basix_element.degree > 1
    return BY_THEMSELVES if second and problem.solid.volumetric == "reduced" else ""


def is_loaded(problem: ContactProblem) -> bool:
    """Whether terms or tool loads act; collective."""
    driven = any(link.interface.driven() is not None for link in problem.system.links)
    return driven or problem.terms.assemble_forces(problem.K.createVecLeft()) > 0.0


def _flow(problem: ContactProblem) -> str:
    """Bodies at a limit load, where u.K u is small compared with u.K_e u; collective."""
    solid, u = problem.solid, problem.u
    try:
        solid.evaluate()
    except ValueError:
        return ""
    solid.assemble_tangent(problem.K)
    step = problem.vector(problem.owned_u)
    if not step.dot(problem.K * step) < SOFT * solid.elastic_norm(u) ** 2:
        return ""
    weights = solid.fields.weights
    volumes = np.array([(weights * part).sum() for part in (solid.points.flowing(), 1.0)])
    flow, whole = problem.comm.allreduce(volumes)
    if flow == 0.0:
        return ""
    return f"limit load? {100 * flow / whole:.0f} % of the volume flows at the last iterate"


def describe_passing(problem: ContactProblem) -> str:
    """Describe bodies or tools that passed through each other since the last commit; collective.

    Raises:
        ValueError: on all ranks, if all nodes of the slave side are prescribed.
    """
    d, n, system = problem.d, problem.n, problem.system
    before, now = problem.committed.displacement, problem.u.x.array[: d * n]
    if system.middles is None:
        body_of, skin = problem.bodies.of_cells, system.boundary
        system.middles = [
            tuple(
                find_middles(s, body_of[cells_of(s)], skin.facets, body_of[skin.cells])
                for s in surfaces
            )
            for surfaces in system.opposite
        ]
    columns = system.interfaces, system.middles, system.sides
    for interface, middles, sides in zip(*columns, strict=True):
        if not middles:
            continue
        tool, (side, *other) = interface.tool, middles
        if other and not is_far(side, other[0], before.reshape(n, d), now.reshape(n, d)):
            continue
        began = with_values(problem.V, before)
        if tool is None:
            found = find_passed(side, other[0], began, problem.u)
        else:
            links = [link for link in system.links if link.interface is interface]
            offsets = [link.coupling.offset for link in links if link.coupling.offset is not None]
            removed = np.maximum(np.concatenate([np.zeros(1), *offsets]), 0.0)
            at = side, began, problem.u, tool.seen()
            found = find_passed_tool(*at, largest(problem.comm, removed))
        if found is not None:
            free = tool is not None or not sides.fixed[sides.nodes].all()
            if not any_rank(problem.comm, free)[0]:
                raise ValueError(f"{interface}: {WITHOUT_EFFECT}")
            return f"{interface}: {_describe(found, found.surface is side.surface)}"
    return ""


def _describe(found: Passing, master: bool) -> str:
    who, many = "the side has passed through the tool", f" at {found.count} facets"
    if found.surface is not None:
        who = f"the {'master' if master else 'slave'} side has passed through the other one"
    elif not found.count:  # a point of the tool
        who, many = "the tool has passed through the side", ""
    at = [float(f"{x:.4g}") for x in found.place]
    return (
        f"{who}{many}, by more than {found.depth:.3g} in one step, such as where it began around "
        f"{at}: take smaller steps"
    )
