# SPDX-License-Identifier: MIT
"""Closed solutions of contact mechanics: pure functions of numbers, in any consistent units."""

from dolfinx_mortar.analytic.cattaneo import PartialSlip, cattaneo_line
from dolfinx_mortar.analytic.fit import fit_pressure
from dolfinx_mortar.analytic.hertz import (
    FirstYield,
    LineContact,
    PointContact,
    effective_modulus,
    effective_radius,
    first_yield_line,
    hertz_line,
    hertz_point,
    line_axis_stress,
)
from dolfinx_mortar.analytic.mindlin import PartialSlipPoint, mindlin_point
from dolfinx_mortar.analytic.shrink_fit import ShrinkFit, shrink_fit

__all__ = [
    "FirstYield",
    "LineContact",
    "PartialSlip",
    "PartialSlipPoint",
    "PointContact",
    "ShrinkFit",
    "cattaneo_line",
    "effective_modulus",
    "effective_radius",
    "first_yield_line",
    "fit_pressure",
    "hertz_line",
    "hertz_point",
    "line_axis_stress",
    "mindlin_point",
    "shrink_fit",
]
