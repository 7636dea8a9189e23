# SPDX-License-Identifier: MIT
"""Error of the small-strain measure, estimated after every step, and notes.

Neglected is H^T H / 2 of the Green-Lagrange strain, H = grad u: relatively e / 2 of a strain e (the
spread of finite measures), a^2 / 2 of a rotation a.
"""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import CHUNK, HALF_OF_DIGITS, Floats, Ints
from dolfinx_mortar.common.step_report import Note
from dolfinx_mortar.materials.tensor import double_contraction, frobenius_norm
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.pointwise import largest_stress_lost
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.supports import name_of

# Largest error without a note: of forces, by the work of rotations (6.4 % for 6.7 % between two
# blocks) or half of the whole term (6 to 48 % for 5 to 35 % below a ball); in logarithmic strain
# space of the stress norm (.02 for 2.7 % of the shear stress).
LARGEST_SHARE = 0.02
# of the mean |H^T H|: a strip bent by 11 %, a bar stretched by 14 %, a body turned by 7 degrees
# have 1 %

# strain or rotation (radians, 2.9 degrees) for a note
LARGE = 0.05


@dataclass(frozen=True)
class LeftOut:
    """Term that the small strain neglects; zero for other measures."""

    strain: float  # largest |H^T H| / 2
    largest: float  # largest strain
    rotation: float
    work: float  # error of forces: share of the stress work, of the worst body
    lengths: float  # mean |H^T H| / 2 of that body
    felt: Floats  # (bodies,) errors over the limits
    own: Floats  # (2, bodies) largest strain and rotation


def _measure(solid: Solid, cells: Ints) -> tuple[Floats, Floats]:
    """Sums (6, cells) and maxima (4, cells) for `find_left_out`."""
    volume, dofmap = solid.fields.weights[cells], solid.stress.function_space.dofmap
    found = solid.gradients.evaluate(cells)
    shown = solid.stress.x.array.reshape(-1, dofmap.bs)[dofmap.list[cells].ravel()]
    stress: Floats = np.asfortranarray(shown)
    size, strains = frobenius_norm(found.left_out), frobenius_norm(found.strain)
    seen = strains if found.seen is found.strain else frobenius_norm(found.seen)
    angles = np.linalg.norm(found.rotation, axis=1)
    made = [double_contraction(stress, E) for E in (found.seen, found.turned, found.left_out)]
    at_points = np.stack([np.ones_like(size), size, *made]).reshape(5, *volume.shape)
    space, left, work, *missed = (at_points * volume).sum(axis=2)
    work = np.abs(work)  # per cell: under volume constraints point values vary
    peaks = np.stack([size, strains, angles, seen]).reshape(4, *volume.shape).max(axis=2)
    return np.stack([space, left, work, work * left / space, *missed]), peaks


def find_left_out(problem: ContactProblem) -> LeftOut:
    """Measure strain and rotation at u, after `Solid.evaluate`; collective."""
    solid, comm, count = problem.solid, problem.comm, problem.bodies.count
    sums, peaks = np.zeros((6, count)), np.zeros((4, count))
    cells: Ints = np.arange(len(problem.bodies.of_cells), dtype=np.int32)
    many = CHUNK // solid.fields.weights.shape[1]
    for some in (cells[first : first + many] for first in range(0, len(cells), many)):
        body, found = problem.bodies.of_cells[some], _measure(solid, some)
        for total, values in zip(sums, found[0], strict=True):
            total += np.bincount(body, values, count)
        for peak, values in zip(peaks, found[1], strict=True):
            np.maximum.at(peak, body, values)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    space, left, work, felt, *missed = sums
    strains, *own, seen = maximum(comm, *peaks.ravel()).reshape(peaks.shape)
    # without strain the stress is round-off
    strained = (seen > HALF_OF_DIGITS * own[1]) & (work > 0.0)
    turned, whole = np.divide(np.abs(missed), work, out=np.zeros((2, count)), where=strained)
    means = np.divide(felt, work, out=np.zeros(count), where=work > 0.0)
    means = np.maximum(means, left / space)
    felt = np.maximum(turned, 2.0 * means) / LARGEST_SHARE
    worst, forces = felt.argmax(), np.maximum(turned, whole / 2.0)
    return LeftOut(
        strain=float(strains.max()),
        largest=float(own[0].max()),
        rotation=float(own[1].max()),
        work=float(forces[worst]),
        lengths=float(means[worst]),
        felt=felt,
        own=np.stack(own),
    )


def notes_on_small_strain(problem: ContactProblem, found: LeftOut) -> list[str]:
    """Note if the neglected term or any strain or rotation is large; collective."""
    felt = found.felt
    large = problem.solid.gradients.small and max(found.largest, found.rotation) > LARGE
    if felt.max() < 1.0 and not large:
        return []
    body = int(np.argmax(felt if felt.max() >= 1.0 else found.own.max(axis=0)))
    (strain, rotation), others = found.own[:, body], int((felt >= 1.0).sum()) - 1
    more = f" (and {others} more)" if others > 0 else ""
    seen = (
        f"{name_of(problem.bodies, [body])}{more}: strains "
        f"of up to {strain:.1%} and rotations of up to {np.degrees(rotation):.1f} degrees"
        f"{' are no longer small' if others < 0 else ''}; the small strain leaves out "
        f"up to {found.strain:.2g}, {found.work:.1%} of the work of the stresses and "
        f"{found.lengths:.2%} of lengths"
    )
    why = (
        f"Strains beyond {LARGE:.0%} or rotations beyond {np.degrees(LARGE):.1f} degrees are wrong "
        "by half of themselves and more, forces by the share of the work. Choose a finite strain, "
        "Solid(.., strain='finite'), reduce strains and rotations, or mesh the body nearer to its "
        "final position"
    )
    return [Note(seen, why)]


def notes_on_lost_stress(problem: ContactProblem) -> list[str]:
    """Note on laws of the additive form out of range; collective."""
    share, name = largest_stress_lost(problem.comm, problem.solid.points.found)
    if share < LARGEST_SHARE:
        return []
    seen = (
        f"{name} is computed in the logarithmic strain space, where shear softens: the norm of the "
        f"stress is up to {100 * share:.0f} % below that of the law"
    )
    why = (
        "It is 2 % at a shear of 1, whose shear stress is 3 % too low; 9 % and 17 % at a shear of "
        "2. Isotropic laws without kinematic hardening have no such limit"
    )
    return [Note(seen, why)]
