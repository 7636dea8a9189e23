# SPDX-License-Identifier: MIT
"""Notes on a converged step: separation from the partner, neglected strains, resolution."""

import logging
import re
from collections.abc import Sequence

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.common.arrays import QUARTER_OF_DIGITS
from dolfinx_mortar.common.step_report import Note
from dolfinx_mortar.interfaces.coupling import slipped
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.surface import coordinates, nodal_normals
from dolfinx_mortar.problem.contacts import Contacts, gap_round_off
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.certificate import StepEnd
from dolfinx_mortar.report.penetration import notes_on_crossings, notes_on_overlaps
from dolfinx_mortar.report.resolution import note_on_facets, notes_on_resolution
from dolfinx_mortar.report.small_strain import (
    LARGE,
    notes_on_lost_stress,
    notes_on_small_strain,
)

log = logging.getLogger(__name__)


def note_partners(end: StepEnd) -> list[str]:
    """Notes on slides, rotations, tension and overlaps of contacts."""
    notes = _missed_tools(end)
    notes += _frozen(end) if end.problem.geometry == "reference" else _turned_tools(end)
    if end.pull > max(end.report.rtol, QUARTER_OF_DIGITS):
        seen = f"contacts pull, by {end.pull:.1%} of the largest push: forces are wrong there"
        why = "Refine the slave side where the master ends, or let the other side be the slave"
        notes.append(Note(seen, why))
    if end.overlap == 0.0:  # otherwise an initial overlap remains
        notes += notes_on_overlaps(end.problem, end.overlaps, end.contacts.active, end.report.rtol)
    return notes + notes_on_crossings(end.problem, end.overlaps)


def _missed_tools(end: StepEnd) -> list[str]:
    notes, links = list[str](), end.problem.system.links
    why = (
        "Either no facet of the side faces the tool (its normal has to point out of the tool, "
        "towards the body), or Dirichlet data hold all nodes: see problem.audit()"
    )
    for link in links:
        shared = [np.isin(link.nodes, other.nodes).any() for other in links if other is not link]
        met = link.pairing is not None or link.constrained.any() or any(shared)
        if not any_rank(end.problem.comm, met)[0]:
            seen = "no slave node carries a multiplier, so that the tool had no effect in this step"
            notes.append(Note(f"{link.interface}: {seen}", why))
    return notes


def _frozen(end: StepEnd) -> list[str]:
    notes, problem, length = list[str](), end.problem, end.problem.system.facet_length
    for link in end.problem.system.unilateral:
        slip = slipped(link, problem.vector(problem.owned_u))
        slip[~end.contacts.active[link.nodes]] = 0.0
        farthest = float(maximum(problem.comm, slip.max(initial=0.0))[0])
        finite = problem.solid.strain == "finite" and link.pairing is not None
        angle, seen = _turn(problem, link, end.contacts) if finite else 0.0, []
        if farthest > length:
            seen.append(f"has slid {farthest:.3g}, {farthest / length:.1f} facet lengths")
        if angle > LARGE:
            seen.append(f"has turned by {np.degrees(angle):.2g} degrees where it is closed")
        if seen:
            why = "Frozen geometry keeps partners and normals at X: choose geometry='updated'"
            notes.append(Note(f"{link.interface} {' and '.join(seen)}, in frozen geometry", why))
    return notes


def _turn(problem: ContactProblem, link: Link, contacts: Contacts) -> float:
    """Rotation of normals, atan2(|sum_j z_j N_j x n_j|, sum_j z_j N_j . n_j); collective."""
    slave, d = link.sides.slave, problem.d
    at_X, now = np.zeros((2, slave.owned, 3))
    for normals, u in ((at_X, None), (now, problem.u)):
        normals[:, :d] = nodal_normals(slave, coordinates(slave, u))[: slave.owned]
    z = link.coupling.weight[:, 0] * contacts.multipliers[link.nodes]
    mine = np.append(z @ np.cross(at_X, now), z @ (at_X * now).sum(axis=1))
    total = np.sum(problem.comm.allgather(mine), axis=0)
    return float(np.arctan2(np.linalg.norm(total[:3]), total[3]))


def _turned_tools(end: StepEnd) -> list[str]:
    notes, sliding = list[str](), end.contacts.sliding
    for link in end.problem.system.links:
        tool = link.interface.tool
        if tool is None or link.interface.law is None or sliding is None:
            continue
        turn, slides = tool.turn(), sliding[link.nodes].any(axis=1)
        about = np.abs(link.coupling.normals[slides] @ turn) if len(turn) > 1 else np.zeros(0)
        spin, moves = maximum(end.problem.comm, about.max(initial=0.0), slides.any())
        angle, missed = float(np.linalg.norm(turn)), 1.0 - np.sinc(spin / np.pi)
        if moves and (angle >= np.pi or missed > LARGE):
            seen = (
                f"{link.interface}: the tool turns by {np.degrees(angle):.0f} degrees in this step "
                f"and by {np.degrees(spin):.0f} about normals of the side, which slides on it"
            )
            why = (
                "Slips are taken along the shorter way around, back beyond 180 degrees, and about "
                f"normals along straight ways, which are {missed:.0%} too short: take steps of 30 "
                "degrees at most"
            )
            notes.append(Note(seen, why))
    return notes


def note_strains(end: StepEnd) -> list[str]:
    """Notes on strains and stresses that the kinematics neglect."""
    return notes_on_small_strain(end.problem, end.left_out) + notes_on_lost_stress(end.problem)


def note_pressures(end: StepEnd) -> list[str]:
    """Notes on the resolution of pressures."""
    forces, stiffness = np.zeros((2, end.problem.n))
    forces[end.balance.nodes] = end.contacts.reactions(end.balance)
    stiffness[end.balance.nodes] = end.stiffness.array_r[end.balance.bounds.dofs]
    forces[forces <= np.maximum(end.residual.limit, stiffness * gap_round_off(end.problem.u))] = 0.0
    notes, few = list[str](), list[str]()
    for link in end.problem.system.unilateral:
        notes += note_on_facets(link, end.problem, forces, stiffness)
        if any_rank(end.problem.comm, forces[link.nodes].any())[0]:
            few += notes_on_resolution(link, end.contacts)
    return notes + few


DIAGNOSES = note_partners, note_strains, note_pressures  # the same order on all ranks


def find_notes(end: StepEnd) -> list[str]:
    """All notes; rank 0 logs each kind once; collective."""
    notes = [note for diagnose in DIAGNOSES for note in diagnose(end)]
    if end.problem.comm.rank == 0:
        for note in notes:
            kind = _kind(note, [repr(i) for i in end.problem.interfaces])
            if kind not in end.problem.logged:
                end.problem.logged.add(kind)
                more = "; problem.diagnose() says more" * hasattr(note, "why")
                log.warning("%s%s", note, more)
    return notes


def _kind(note: str, names: Sequence[str]) -> str:
    """Note without numbers, except in the name of its interface.

    >>> _kind("Contact(slave=1): 1.5e-3 deep in 2 facets", ["Contact(slave=1)"])
    'Contact(slave=1): # deep in # facets'
    """
    name = max((name for name in names if note.startswith(name)), key=len, default="")
    return name + re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note[len(name) :])
