# SPDX-License-Identifier: MIT
"""Results of the interfaces from the last balance of a step, and notes on them."""

from collections.abc import Sequence

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.constraints import SlipLimits
from dolfinx_mortar.interfaces.coupling import slipped
from dolfinx_mortar.interfaces.link import Link, set_results_of, set_sliding
from dolfinx_mortar.interfaces.near import nodal_gaps
from dolfinx_mortar.mortar.surface import coordinates, nodal_normals
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.linearisation import Balance
from dolfinx_mortar.persistence.committed import Slips
from dolfinx_mortar.problem.circumference import growth
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.small_strain import LARGE


def set_results(
    problem: ContactProblem,
    balance: Balance,
    contacts: Contacts,
) -> tuple[Slips | None, tuple[float, float]]:
    """Set the interfaces' resultants and Functions; collective.

    Return the slips until here, and the largest imbalances of the forces and of the moments of two
    sides, see `results`.

    Reactions of equalities are the residual forces that they take; those of contact are D_jj times
    the multipliers. Ties are as open as their jumps. Tractions are shown per area
    of the configuration at which the interface is taken, see `growth`.
    """
    d, n = problem.d, problem.n
    moved = problem.X + problem.u.x.array[: d * n].reshape(-1, d)
    reaction = np.zeros(d * n)
    reaction[balance.equal.dofs] = balance.reduced.array_r[balance.equal.dofs]
    reaction[balance.bounds.dofs] = contacts.reactions(balance)
    known = balance.known(contacts.multipliers)
    if (limits := balance.limits) is not None:
        some = limits.some
        reaction[limits.tangential[some]] = contacts.tangential_reactions(limits)[some]
    forces = reaction.reshape(-1, d)
    gap = nodal_gaps(problem.system.links, problem.vector(moved), n)
    grown = [growth(problem, link) for link in problem.system.links]
    balances = [(0.0, 0.0)]
    for k, link in enumerate(problem.system.links):
        frozen = problem.configuration is None or link.interface.stays
        on = link.constrained
        found = set_results_of(
            link,
            np.where(on, forces[link.nodes], 0.0),
            np.where(on[:, :1], known[link.nodes], 0.0),
            link.shown_gap(gap),
            link.acting(contacts.active),
            problem.X if frozen else moved,  # where the forces act
            grown[k],
        )
        balances.append(found)
    slips = None if limits is None else _set_sliding(problem, limits, contacts, grown)
    force, moment = np.max(balances, axis=0)
    return slips, (float(force), float(moment))


def _set_sliding(
    problem: ContactProblem, limits: SlipLimits, contacts: Contacts, grown: Sequence[Floats]
) -> Slips:
    """Set the results of friction, those of the step added to what is committed; collective."""
    n, d, committed = problem.n, problem.d, problem.committed
    traction, slip = np.zeros((2, n, d))
    assert contacts.sliding is not None
    slides = np.asarray(limits.along(contacts.sliding[limits.nodes]).any(axis=1))
    resisting, known = contacts.tangential_reactions(limits), limits.known(contacts.multipliers)
    slips = np.where(slides[:, None], limits.slip, 0.0)  # of others it is round-off
    aside = limits.slides & known.any(axis=1)
    beside = np.where(aside[:, None], limits.beside, 0.0)
    traction[limits.nodes] = -(limits.vectors(resisting) + known) / limits.weight[:, None]
    slip[limits.nodes] = limits.vectors(slips) + beside
    energy, status = np.zeros((2, n))
    energy[limits.nodes] = (resisting * slips).sum(axis=1) + (known * beside).sum(axis=1)
    slides |= aside
    acts = contacts.active[limits.nodes] | (limits.cohesion > 0.0)
    status[limits.nodes] = np.where(slides, 2.0, acts)
    total = Slips(committed.slid.copy(), committed.dissipated.copy())
    for k, link in enumerate(problem.system.links):
        if link.interface.law is not None:
            nodes, carries = link.nodes, link.constrained[:, 0]
            total.slid[k, nodes] += carries * np.linalg.norm(slip[nodes], axis=1)
            total.dissipated[k, nodes] += carries * energy[nodes]
            way, spent = total.slid[k, nodes], total.dissipated[k, nodes]
            drag, last = (carries[:, None] * v[nodes] for v in (traction, slip))
            drag /= grown[k][:, None]
            set_sliding(link, drag, last, way, carries * status[nodes], spent)
    return total


def notes_on_sliding(problem: ContactProblem, contacts: Contacts) -> list[str]:
    """Return a note where contacts slid or turned too far for frozen geometry; collective."""
    if problem.geometry == "updated":
        return []
    notes, length = [], problem.system.facet_length
    for link in problem.system.unilateral:
        slip = slipped(link, problem.vector(problem.owned_u))
        slip[~contacts.active[link.nodes]] = 0.0
        farthest = float(maximum(problem.comm, slip.max(initial=0.0))[0])
        if farthest > length:
            notes.append(
                f"{link.interface} has slid {farthest:.3g}, {farthest / length:.1f} facet lengths, "
                "but frozen geometry is for small sliding; choose geometry='updated'"
            )
        if problem.solid.strain == "finite" and link.pairing is not None:
            angle = _turn(problem, link, contacts)
            if angle > LARGE:
                notes.append(
                    f"{link.interface} has turned by {np.degrees(angle):.2g} degrees where it is "
                    "closed, but frozen geometry keeps the normals at X; choose geometry='updated'"
                )
    return notes


def _turn(problem: ContactProblem, link: Link, contacts: Contacts) -> float:
    """Return atan2(|sum_j z_j N_j x n_j|, sum_j z_j N_j . n_j), how far normals turned; collective.

    z_j are the reactions, N_j and n_j the averaged normals at X and now. The flanks of a dent turn
    against each other, which cancels.
    """
    slave, d = link.sides.slave, problem.d
    at_X, now = np.zeros((2, slave.owned, 3))
    for normals, u in ((at_X, None), (now, problem.u)):
        normals[:, :d] = nodal_normals(slave, coordinates(slave, u))[: slave.owned]
    z = link.coupling.weight[:, 0] * contacts.multipliers[link.nodes]
    mine = np.append(z @ np.cross(at_X, now), z @ (at_X * now).sum(axis=1))
    total = np.sum(problem.comm.allgather(mine), axis=0)
    return float(np.arctan2(np.linalg.norm(total[:3]), total[3]))


def notes_on_turns(problem: ContactProblem, contacts: Contacts) -> list[str]:
    """Return a note for every tool that turns so far in a step that slips are wrong; collective.

    Along a surface they are those of arcs up to half a turn, see `slip_partners`. Of a turn by a
    about its normal they are the parts r sin(a) of chords, of arcs r a.
    """
    notes: list[str] = []
    if problem.geometry == "reference":
        return notes
    for link in problem.system.links:
        if (tool := link.interface.tool) is None or link.interface.law is None:
            continue
        turn = tool.turn()
        assert contacts.sliding is not None
        slides = contacts.sliding[link.nodes].any(axis=1)
        about: Floats = np.zeros(0)
        if len(turn) > 1:
            about = np.abs(link.coupling.normals[slides] @ turn)
        spin = float(maximum(problem.comm, about.max(initial=0.0))[0])
        angle = float(np.linalg.norm(turn))
        if not any_rank(problem.comm, slides.any())[0]:
            continue
        if angle >= np.pi:
            notes.append(
                f"{link.interface}: the tool turns by {np.degrees(angle):.0f} degrees in this step "
                "while the side slides on it; slips are taken along the shorter way around, back "
                "beyond 180 degrees: take shorter steps"
            )
        elif (missed := 1.0 - np.sinc(spin / np.pi)) > LARGE:
            notes.append(
                f"{link.interface}: the tool turns by {np.degrees(spin):.0f} degrees about normals "
                "of the side in this step, which slides on it; slips are taken along straight "
                f"ways, which are {missed:.0%} too short: take steps of 30 degrees at most"
            )
    return notes


def notes_on_missed_tools(links: Sequence[Link]) -> list[str]:
    """Return a note for every tool that nothing can meet; collective.

    Not of tools on sides that they share: their nodes may belong to another interface.
    """
    notes = []
    for link in links:
        shared = [np.isin(link.nodes, other.nodes).any() for other in links if other is not link]
        met = link.pairing is not None or link.constrained.any() or any(shared)
        if not any_rank(link.sides.V.mesh.comm, met)[0]:
            notes.append(
                f"{link.interface}: no slave node carries a multiplier, so that the tool had no "
                "effect in this step: either no facet of the side faces it (the normal of a tool "
                "has to point out of the tool, towards the body), or Dirichlet data hold all "
                "nodes; see problem.audit()"
            )
    return notes
