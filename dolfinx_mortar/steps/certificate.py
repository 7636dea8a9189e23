# SPDX-License-Identifier: MIT
"""The certificate of a converged step: how well equilibrium and contact laws are satisfied."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.steps.report import Certificate, StepReport

if TYPE_CHECKING:
    from dolfinx_mortar.steps.problem import ContactProblem


def _largest(problem: ContactProblem, *arrays: Floats) -> Floats:
    """Return the maxima of arrays over all ranks, 0 for empty ones."""
    return maximum(problem.comm, *(a.max(initial=0.0) for a in arrays))


def _share(value: npt.ArrayLike, scale: npt.ArrayLike) -> float:
    """Return value / scale, 0 where nothing acts at all."""
    share = float(np.asarray(value) / scale) if np.asarray(scale) > 0 else 0.0
    return share + 0.0  # no -0.0


def _operator_errors(interface: Interface) -> tuple[float, float]:
    """Return the linear-field error and the row-sum error of D and M; collective.

    On a flat interface (D - M) X has no tangential part, whatever the gap; on a curved one it has
    the angle between the projections and the nodal normals, times the gap. Rows of D - M sum to
    zero on every interface. Both per D_jj, the first in parts of gap plus facet length.
    """
    D, M = interface.pairing.D, interface.pairing.M
    nodes, d = interface.pattern.nodes, interface.d
    weight = D.getDiagonal().array_r[nodes]
    kept = weight > 0
    X = interface.V.tabulate_dof_coordinates()[: interface.n_owned, :d]
    v, out = D.createVecRight(), D.createVecLeft()

    def apply(values: Floats) -> Floats:
        v.array[:] = values
        relative = (D * v).array_r - (M * v).array_r
        out.array[:] = relative
        return np.asarray(relative[nodes][kept] / weight[kept])

    sums = np.abs(apply(np.ones(interface.n_owned))).max(initial=0.0)
    gap = np.column_stack([apply(x) for x in X.T])
    normals = interface.normals[kept]
    along = np.einsum("ni,ni->n", gap, normals)
    tangential = np.linalg.norm(gap - along[:, None] * normals, axis=1)
    linear = (tangential / (np.abs(along) + interface.facet_length)).max(initial=0.0)
    linear, sums = maximum(interface.V.mesh.comm, linear, sums)
    return float(linear), float(sums)


def _balances(interfaces: list[Interface]) -> tuple[float, float]:
    """Return the largest relative imbalances of forces and moments between the two sides."""
    force = moment = 0.0
    for i in interfaces:
        scale = np.linalg.norm(i.force)
        arm = np.linalg.norm(i.moment) + scale * i.facet_length
        force = max(force, _share(np.linalg.norm(i.force + i.master_force), scale))
        moment = max(moment, _share(np.linalg.norm(i.moment + i.master_moment), arm))
    return force, moment


def create_certificate(
    problem: ContactProblem, report: StepReport, reaction: PETSc.Vec
) -> Certificate:
    """Judge the present state of a problem whose results are set; collective."""
    gap: list[Floats] = [np.zeros(0)]
    multiplier: list[Floats] = [np.zeros(0)]
    nodal = problem.gaps()
    for contact in problem.contacts:
        constrained = contact.kept[:, 0]
        gap.append(nodal[contact.pattern.nodes[constrained]])
        multiplier.append(contact.multiplier[constrained])
    g, p = np.concatenate(gap), np.concatenate(multiplier)
    deepest, tensile, pressure, product = _largest(problem, -g, -p, np.abs(p), np.abs(g * p))
    errors = [_operator_errors(i) for i in problem.interfaces] or [(0.0, 0.0)]
    force, moment = _balances(problem.interfaces)
    kept = [i.kept.any(axis=1) for i in problem.interfaces]
    counts = [
        sum(int(k.sum()) for k in kept),
        sum(
            int(((i.coverage > 0) & ~k).sum())
            for i, k in zip(problem.interfaces, kept, strict=True)
        ),
        int(problem.active.sum()),
    ]
    counts = problem.comm.allreduce(np.array(counts), op=MPI.SUM)
    coverage = min(
        (i.coverage[k].min(initial=1.0) for i, k in zip(problem.interfaces, kept, strict=True)),
        default=1.0,
    )
    length = problem.facet_length
    return Certificate(
        equilibrium=report.iterations[-1].force_residual,
        gap=_share(deepest, length),
        sign=_share(tensile, pressure),
        complementarity=_share(product, pressure * length),
        force_balance=force,
        moment_balance=moment,
        linear_field_error=max(e[0] for e in errors),
        row_sum_error=max(e[1] for e in errors),
        smallest_coverage=float(-maximum(problem.comm, -coverage)[0]),
        kept_nodes=int(counts[0]),
        removed_nodes=int(counts[1]),
        active_nodes=int(counts[2]),
        active_set_changes=sum(i.changed for i in report.iterations),
        newton_iterations=report.newton_iterations,
        qp_iterations=report.qp_iterations,
        line_search_steps=sum(i.line_search_steps for i in report.iterations),
        geometry_change=report.iterations[-1].geometry_change,
    )
