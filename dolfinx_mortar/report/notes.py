# SPDX-License-Identifier: MIT
"""Notes on a step that has converged: diagnoses of one signature, made one after the other."""

import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.audit.stand_off import note_on_facets
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.newton_method.linearisation import Balance
from dolfinx_mortar.newton_method.residuals import gap_round_off
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.interface_results import (
    notes_on_missed_tools,
    notes_on_sliding,
    notes_on_turns,
)
from dolfinx_mortar.report.overlaps import notes_on_overlaps
from dolfinx_mortar.report.pulls import notes_on_pulls
from dolfinx_mortar.report.resolution import note_on_resolution, notes_on_rims
from dolfinx_mortar.report.small_strain import LeftOut, notes_on_lost_stress, notes_on_small_strain
from dolfinx_mortar.report.uncoupled import Crossing, notes_on_crossings

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StepEnd:
    """The end of a step, as diagnoses read it."""

    problem: ContactProblem  # in the geometry of the end, its stresses evaluated
    balance: Balance
    contacts: Contacts
    stiffness: Floats  # (n,) owned, diagonal of the last K^
    overlap: float  # of the sides at X, left to later steps
    left_out: LeftOut
    crossing: Crossing
    pull: float  # of contacts, see `find_pull`
    rtol: float  # of the step
    limit: float  # norm of the forces that it may leave out of balance

    @property
    def links(self) -> Sequence[Link]:
        """The interfaces as they are coupled."""
        return self.problem.system.links

    @property
    def unilateral(self) -> Sequence[Link]:
        """Those of them that can open."""
        return self.problem.system.unilateral


Diagnosis = Callable[[StepEnd], list[str]]  # collective; returns the same notes on all ranks


def _pressures(end: StepEnd) -> list[str]:
    forces, stiffness = np.zeros((2, end.problem.n))
    forces[end.balance.nodes] = end.contacts.reactions(end.balance)
    stiffness[end.balance.nodes] = end.stiffness[end.balance.bounds.dofs]
    # less than what is left out of balance, or than gaps are worth that are round-off, is nothing
    forces[forces <= np.maximum(end.limit, stiffness * gap_round_off(end.problem.u))] = 0.0
    x, u = end.problem.positions(), end.problem.configuration
    notes, few = [], []
    for link in end.unilateral:
        diagonal, potential = end.problem.K.getDiagonal, end.problem.solid.potential
        spoilt = note_on_facets(link, x, u, forces, stiffness, diagonal, potential)
        notes += [spoilt] if spoilt else []
        if any_rank(end.problem.comm, forces[link.nodes].any())[0]:
            few.append(note_on_resolution(link, end.contacts, not spoilt))
    return notes + [note for note in few if note]


def _overlaps(end: StepEnd) -> list[str]:
    if end.overlap > 0.0:  # of an initial overlap a part is left, which is as deep as was asked for
        return []
    return notes_on_overlaps(end.unilateral, end.problem.u, end.contacts.active, end.rtol)


DIAGNOSES: tuple[Diagnosis, ...] = (
    lambda end: notes_on_missed_tools(end.unilateral),
    lambda end: notes_on_sliding(end.problem, end.contacts),
    lambda end: notes_on_turns(end.problem, end.contacts),
    lambda end: notes_on_pulls(end.pull, end.rtol),
    _pressures,
    lambda end: notes_on_rims(end.links),
    _overlaps,
    lambda end: notes_on_crossings(end.problem, end.crossing),
    lambda end: notes_on_small_strain(end.problem, end.left_out),
    lambda end: notes_on_lost_stress(end.problem),
)


def find_notes(end: StepEnd) -> list[str]:
    """Return the notes of all diagnoses; rank 0 logs them, each kind once; collective."""
    notes = [note for diagnose in DIAGNOSES for note in diagnose(end)]
    if end.problem.comm.rank == 0:
        for note in notes:
            if end.problem.is_new(_kind(note, [repr(i) for i in end.problem.interfaces])):
                more = "; problem.diagnose() says more" * hasattr(note, "why")
                log.warning("%s%s", note, more)
    return notes


def _kind(note: str, names: Sequence[str]) -> str:
    """Return a note without its numbers, but for those in the name of its interface.

    >>> _kind("Contact(slave=1): 1.5e-3 deep in 2 facets", ["Contact(slave=1)"])
    'Contact(slave=1): # deep in # facets'
    """
    name = max((name for name in names if note.startswith(name)), key=len, default="")
    return name + re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note[len(name) :])
