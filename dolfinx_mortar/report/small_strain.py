# SPDX-License-Identifier: MIT
"""Error of the small-strain measure, estimated after every step, and notes.

Neglected is H^T H / 2 of the Green-Lagrange strain, H = grad u: relatively e / 2 of a strain e (the
spread of finite measures), a^2 / 2 of a rotation a.
"""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum, ratio
from dolfinx_mortar.arrays import CHUNK, HALF_OF_DIGITS, Floats
from dolfinx_mortar.materials.tensor import double_contraction, frobenius_norm
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.pointwise import largest_stress_lost
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.step_report import Note
from dolfinx_mortar.supports.bodies import name_of

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

    felt: int  # number of bodies above the limits
    strain: float
    largest: float
    rotation: float
    work: float  # error of forces: share of the stress work, of the worst body
    lengths: float  # mean |H^T H| / 2 of that body
    told: int  # body of the note: the worst above the limits, else the one of `steepest`
    own: tuple[float, float]  # largest strain and rotation in it

    @property
    def relative(self) -> float:
        """Largest |H^T H| / 2 over the largest strain."""
        return ratio(self.strain, self.largest)


def _measure(solid: Solid, weights: Floats, cells: slice) -> Floats:
    """Rows of `find_left_out` (9, cells)."""
    volume = weights[cells]
    points, dofmap = volume.shape[1], solid.stress.function_space.dofmap

    def per_cell(values: Floats) -> Floats:
        return np.asarray((values.reshape(-1, points) * volume).sum(axis=1))

    def peak(values: Floats) -> Floats:
        return np.asarray(values.reshape(-1, points).max(axis=1))

    own = np.arange(len(weights), dtype=np.int32)[cells]
    found = solid.gradients.evaluate(own)
    shown = solid.stress.x.array.reshape(-1, dofmap.bs)[dofmap.list[own].ravel()]
    stress: Floats = np.asfortranarray(shown)
    size, strains = frobenius_norm(found.left_out), frobenius_norm(found.strain)
    seen = strains if found.seen is found.strain else frobenius_norm(found.seen)
    angles = np.linalg.norm(found.rotation, axis=1)
    # per cell: under volume constraints point values vary
    work = np.abs(per_cell(double_contraction(stress, found.seen)))
    made = [per_cell(double_contraction(stress, E)) for E in (found.left_out, found.turned)]
    sums = [volume.sum(axis=1), per_cell(size), work, *made]
    return np.stack([*sums, *(peak(values) for values in (size, strains, seen, angles))])


def find_left_out(problem: ContactProblem) -> LeftOut:
    """Measure strain and rotation at u, after `Solid.evaluate`; collective."""
    solid, comm, count = problem.solid, problem.comm, problem.bodies.count
    body, weights = problem.bodies.of_cells, solid.fields.weights
    many = CHUNK // weights.shape[1]
    chunks = [slice(i, i + many) for i in range(0, len(body), many)]
    parts = [_measure(solid, weights, cells) for cells in chunks]
    columns = np.concatenate([np.zeros((9, 0)), *parts], axis=1)
    space, left, work, whole, made, size, *highest = columns
    summed = (space, left, work, work * left / space, made, whole)
    # without cells NumPy counts in integers
    sums = np.array([np.bincount(body, column, count) for column in summed], dtype=float)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    peaks = np.zeros((3, count))
    for peak, values in zip(peaks, highest, strict=True):
        np.maximum.at(peak, body, values)
    strains, seen, angles = maximum(comm, *peaks.ravel()).reshape(peaks.shape)
    # without strain the stress is round-off
    strained = (seen > HALF_OF_DIGITS * angles) & (sums[2] > 0.0)
    share, whole = (
        np.divide(np.abs(sums[k]), sums[2], out=np.zeros(count), where=strained) for k in (4, 5)
    )
    means = np.divide(sums[3], sums[2], out=np.zeros(count), where=sums[2] > 0.0)
    means = np.maximum(means, sums[1] / sums[0])
    felt = np.maximum(share, 2.0 * means) / LARGEST_SHARE
    worst = int(np.argmax(felt))
    largest = float(maximum(comm, size.max(initial=0.0))[0])
    told = worst if felt[worst] >= 1.0 else int(np.argmax(np.maximum(strains, angles)))
    return LeftOut(
        felt=int((felt >= 1.0).sum()),
        strain=largest,
        largest=float(strains.max()),
        rotation=float(angles.max()),
        work=float(max(share[worst], whole[worst] / 2)),
        lengths=float(means[worst]),
        told=told,
        own=(float(strains[told]), float(angles[told])),
    )


def notes_on_small_strain(problem: ContactProblem, found: LeftOut) -> list[str]:
    """Note if the neglected term or any strain or rotation is large; collective."""
    large = problem.solid.gradients.small and max(found.largest, found.rotation) > LARGE
    if not found.felt and not large:
        return []
    strain, rotation = found.own
    others = f" (and {found.felt - 1} more)" if found.felt > 1 else ""
    seen = (
        f"{name_of(problem.bodies, [found.told])}{others}: strains of up to {strain:.1%} "
        f"and rotations of up to {np.degrees(rotation):.1f} degrees"
        f"{'' if found.felt else ' are no longer small'}; the small strain leaves out "
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
