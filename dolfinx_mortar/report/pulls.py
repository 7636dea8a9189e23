# SPDX-License-Identifier: MIT
"""Whether contacts pull: single multipliers as forces, and the resultants of patches."""

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum, ratio
from dolfinx_mortar.arrays import QUARTER_OF_DIGITS, SAME, Floats
from dolfinx_mortar.geometry.curvature import unit
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.newton_method.contacts import Contacts
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.report.resolution import find_patches


def find_pull(problem: ContactProblem, contacts: Contacts) -> float:
    """Return the largest pull of the contacts, over their largest push of the same kind.

    Multipliers lambda_j act with D_jj lambda_j on their own node, and with lambda_j int Phi_j on
    all. The resultants of connected patches along their mean normals are those of the forces on the
    nodes; a patch that bends around by 90 degrees from it has none. Collective.
    """
    found = [0.0]
    for link in problem.system.unilateral:
        p, coupling = link.pattern, link.coupling
        z = coupling.weight[:, 0] * contacts.multipliers[link.nodes] * link.constrained[:, 0]
        shared_out = np.bincount(p.row[: p.split], coupling.P[: p.split, 0], minlength=len(z))
        forces = np.stack([z, z * (1.0 - shared_out)])
        pull, push = maximum(
            problem.comm, -forces.min(initial=0.0), np.abs(forces).max(initial=0.0)
        )
        found += [ratio(pull, push), _pull_of_patches(link, z[:, None] * coupling.normals)]
    return max(found)


def _pull_of_patches(link: Link, forces: Floats) -> float:
    """Return the largest pull of a patch over the sum of forces; these are on slave nodes (n, d).

    Collective.
    """
    d, n = forces.shape[1], link.coupling.normals
    area, exerted = link.coupling.weight[:, :1] * n, link.transpose(forces)[0][link.nodes]
    size = np.linalg.norm(exerted, axis=1)
    off = np.linalg.norm(exerted - size[:, None] * n, axis=1) > SAME * size
    if not any_rank(link.sides.V.mesh.comm, off.any())[0]:
        return 0.0  # each node pushes along its own normal
    patches = find_patches(link, np.asarray(exerted.any(axis=1)), exerted, area)
    whole = sum(float(np.linalg.norm(patch[:, :d], axis=1).sum()) for patch in patches)
    pulls = [0.0]
    for patch in patches:
        mean = unit(patch[:, d:].sum(axis=0)[None])[0]
        if (patch[:, d:] @ mean >= 0.0).all():
            pulls.append(-float(patch[:, :d].sum(axis=0) @ mean))
    return ratio(max(pulls), whole)


def notes_on_pulls(pull: float, rtol: float) -> list[str]:
    """Return a note if contacts pull by more than a step of this rtol may leave."""
    if pull <= max(rtol, QUARTER_OF_DIGITS):
        return []
    return [
        f"contacts pull, by {pull:.1%} of the largest push: forces are wrong there. Refine the "
        "slave side where the master ends, or let the other side be the slave"
    ]
