# SPDX-License-Identifier: MIT
"""Reactions: forces of Dirichlet conditions on the bodies.

A prescribed component is an unknown of y, u = T y, where r = T^T (F - f) without contact forces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import array, check, is_integer
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.compat import on_same_mesh
from dolfinx_mortar.common.tags import all_labels, label, tag_of
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.mortar.surface import check_tags
from dolfinx_mortar.persistence.committed import SupportForces
from dolfinx_mortar.problem.checks import check_conditions, check_problem
from dolfinx_mortar.problem.linearisation import Balance, support_slots
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.supports import marked_dofs, prescribed_dofs


@dataclass(frozen=True)
class Reaction:
    """Force and moment of a support on the bodies."""

    force: Floats  # (d,) resultant; of rings (sum of outward forces, axial force)
    moment: Floats | float  # (3,) in space, a number in the plane
    about: Floats  # (d,) point of the moment

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}


def reaction(
    problem: ContactProblem,
    support: Any = None,
    facet_tags: MeshTags | None = None,
    *,
    about: Sequence[float] | Floats | None = None,
) -> Reaction:
    """Force and moment of a support in the last converged step; collective.

        base = fem.dirichletbc(np.zeros(3), dofs, V)
        problem = dm.ContactProblem(solid, interfaces, bcs=[base, symmetry])
        dm.newton(problem)
        dm.reaction(problem, base).force

    R = sum r_i and M = sum (x_i - about) x r_i over the prescribed dofs i, r = F(u) - f - c:
    internal forces minus loads minus forces of contacts and ties. R acts on the bodies, in the
    plane per thickness, of rings on the whole ring. x is X + u with a contact in updated geometry
    or at finite strain, otherwise X.

    Args:
        problem: after a step.
        support: a Dirichlet condition or a list of them; a tag or name for all prescribed
            components at its nodes; an array of this rank's local dofs, d * node + component, as
            from ``bc.dof_indices()[0]``; None for all supports.
        facet_tags: of the tag, also of cells, edges or vertices; by default those of all interfaces
            if they are the same.
        about: point of the moment, default the origin; not for rings, whose moment is 0.

    Raises:
        ValueError: on all ranks, for invalid arguments, and before the first step.
    """
    check_problem(problem, ContactProblem)
    check_owned(problem.interfaces, problem.supports)
    point = _check_point(problem, about)
    mask = _find(problem, support, facet_tags)
    if problem.committed.supports is None:
        raise ValueError("problem has no reactions yet: solve a step first, newton(problem)")
    (found,) = resultants(problem, [mask], point)
    return found


def reactions(problem: ContactProblem) -> list[Reaction]:
    """Reaction of each Dirichlet condition; collective."""
    masks = [prescribed_dofs(problem.V, [bc])[: problem.n] for bc in problem.bcs]
    return resultants(problem, masks, np.zeros(problem.d))


def support_forces(problem: ContactProblem, balance: Balance) -> SupportForces:
    """Forces of supports and rigid sides, and their points; collective."""
    dofs, slots = support_slots(problem)
    forces = np.zeros(problem.d * problem.n)
    for link in problem.system.links:
        if link.sides.hold:
            own = problem.d * link.nodes[:, None] + np.arange(problem.d)
            forces[own] = -np.einsum("nji,nj->ni", link.coupling.rows, balance.reduced.array_r[own])
    forces[dofs] = -balance.reduced.array_r[slots]
    follows = problem.configuration is not None and not all(i.stays for i in problem.interfaces)
    moved = follows or problem.solid.strain == "finite"
    u = problem.u.x.array[: forces.size].reshape(-1, problem.d)
    return SupportForces(
        forces.reshape(-1, problem.d), problem.X + u if moved else problem.X.copy()
    )


def resultants(problem: ContactProblem, masks: Sequence[Bools], about: Floats) -> list[Reaction]:
    """Reactions of masks of owned components (n, d); collective."""
    supports, d = problem.committed.supports, problem.d
    assert supports is not None
    arms, forces = np.zeros((2, problem.n, 3))
    arms[:, :d] = supports.points - about
    sums = np.zeros((len(masks), 2, 3))
    for k, mask in enumerate(masks):
        forces[:, :d] = np.where(mask, supports.forces, 0.0)
        sums[k] = forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)
    sums = problem.comm.allreduce(sums, op=MPI.SUM)
    if problem.solid.kinematics.radius is not None:
        sums[:, 1] = 0.0  # cancel on a ring
    return [
        Reaction(force[:d], moment if d == 3 else float(moment[2]), about.copy())
        for force, moment in sums
    ]


def _check_point(problem: ContactProblem, about: Any) -> Floats:
    check_same_on_all_ranks(problem.comm, about=about)
    if about is None:
        return np.zeros(problem.d)
    if problem.solid.kinematics.radius is not None:
        raise ValueError(
            f"about is {about!r}, but forces on rings have no moment about points of the axis: "
            "leave it out"
        )
    return check("about", about, array((problem.d,)))


def _find(problem: ContactProblem, support: Any, facet_tags: Any) -> Bools:
    """Mask (n, d) of owned components of a support; collective."""
    comm, held, V = problem.comm, problem.supports.owned, problem.V
    tag = is_integer(support) or isinstance(support, str)
    bcs = [support] if isinstance(support, fem.DirichletBC) else support
    conditions = isinstance(bcs, list | tuple) and any(isinstance(b, fem.DirichletBC) for b in bcs)
    kind = "conditions" if conditions else "None" if support is None else "dofs"
    check_same_on_all_ranks(comm, support=str(support) if tag else kind)
    if support is None:
        return held
    with raised_together(comm):
        if tag:
            tags = _tags_of(problem) if facet_tags is None else facet_tags
            dofs = [_tagged(problem, support, tags)]
        elif conditions:
            dofs = [bc.dof_indices()[0] for bc in check_conditions("support", bcs, V)]
        else:
            dofs = [_check_dofs(problem, support)]
    mask = marked_dofs(V, dofs)[: problem.n]
    loose, count = comm.allreduce(np.array([(mask & ~held).sum(), mask.sum()]), op=MPI.SUM)
    if tag and not count:
        there = all_labels(comm, tags)
        raise ValueError(f"support is {support!r}: nothing has this tag; there are {there}")
    if tag and loose == count:
        raise ValueError(
            f"support is {label(tags, tag_of(tags, support, 'support'))}, at whose nodes "
            "problem.bcs prescribe nothing, so that nothing is exerted: give the tag of a support"
        )
    if loose and not tag:
        raise ValueError(
            f"support: {loose} of {count} dofs are not prescribed by problem.bcs. Dofs are "
            "d * node + component; locate_dofs_topological(V, ..) returns nodes: give the "
            "Dirichlet condition that is made of them"
        )
    return mask & held


def _tagged(problem: ContactProblem, support: int | str, tags: MeshTags) -> Ints:
    """Dofs of all components at the nodes of a tag; not collective."""
    check_tags(tags)
    if not on_same_mesh(tags, problem.V.mesh):
        raise ValueError("facet_tags is of another mesh than that of the displacement")
    tag = tag_of(tags, support, "support")
    problem.V.mesh.topology.create_connectivity(tags.dim, problem.V.mesh.topology.dim)
    nodes = fem.locate_dofs_topological(problem.V, tags.dim, tags.find(tag), remote=False)
    return np.asarray((problem.d * nodes[:, None] + np.arange(problem.d)).ravel())


def _tags_of(problem: ContactProblem) -> MeshTags:
    tags = [interface.facet_tags for interface in problem.interfaces]
    if not tags or any(one is not tags[0] for one in tags):
        raise ValueError(
            "facet_tags is None, and the interfaces do not say which are meant: give the tags in "
            "which the support is, reaction(problem, support, facet_tags)"
        )
    return tags[0]


def _check_dofs(problem: ContactProblem, support: Any) -> Ints:
    remedy = "give a Dirichlet condition, a tag, or an array of local dofs"
    dofs = check("support", support, array((None,), remedy=remedy))
    layout = problem.V.dofmap.index_map
    size = problem.d * (layout.size_local + layout.num_ghosts)
    bad = dofs[(dofs < 0) | (dofs >= size)]
    if bad.size:
        raise ValueError(f"support holds dof {bad[0]}: local dofs are 0 to {size - 1}")
    return dofs.astype(np.int32)
