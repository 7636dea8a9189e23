# SPDX-License-Identifier: MIT
"""Circumference of rings that move: the areas of slave nodes in axisymmetry."""

import numpy as np

from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.surface import coordinates, sum_at_nodes
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.kinematics import on_axis


def growth(problem: ContactProblem, link: Link) -> Floats:
    """Return the ratio (n,) of present to initial circumference at the slave nodes; collective.

    In axisymmetry D is integrated over the length of the section as it is now, but with 2 pi r at
    X: D_jj times this is the area that a node has now. On the axis it is the mean of the other
    nodes of the facets, to second order of their size. One elsewhere, and at X.
    """
    kinematics, slave = problem.solid.kinematics, link.sides.slave
    u = None if link.interface.stays else problem.configuration
    if kinematics.radius is None or u is None:
        return np.ones(len(link.nodes))
    now, at_X = (kinematics.weight(x.T) for x in (coordinates(slave, u), slave.X))
    # zero on the axis; a node beyond it has no circumference
    known = ~on_axis(kinematics, problem.V.mesh, slave.X) & (now > 0.0)
    factor = np.where(known, now / np.where(known, at_X, 1.0), 0.0)
    columns = np.stack([factor, known], axis=1)[slave.facets].sum(axis=1, keepdims=True)
    around = sum_at_nodes(slave, np.repeat(columns, slave.facets.shape[1], axis=1))
    mean = around[:, 0] / np.maximum(around[:, 1], 1.0)
    return np.asarray(np.where(known, factor, mean)[: slave.owned])
