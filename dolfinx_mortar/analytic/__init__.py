# SPDX-License-Identifier: MIT
"""Closed solutions of contact mechanics: pure functions of numbers, in any consistent units."""

from dolfinx_mortar.analytic.cattaneo import PartialSlip, cattaneo_line
from dolfinx_mortar.analytic.fit import fit_pressure
from dolfinx_mortar.analytic.flattening import (
    Flattening,
    YieldOfSphere,
    first_yield_sphere,
    jackson_green,
    kogut_etsion,
)
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
from dolfinx_mortar.analytic.tee import TeeStub, tee_stub

__all__ = [
    "FirstYield",
    "Flattening",
    "LineContact",
    "PartialSlip",
    "PartialSlipPoint",
    "PointContact",
    "ShrinkFit",
    "TeeStub",
    "YieldOfSphere",
    "cattaneo_line",
    "effective_modulus",
    "effective_radius",
    "first_yield_line",
    "first_yield_sphere",
    "fit_pressure",
    "hertz_line",
    "hertz_point",
    "jackson_green",
    "kogut_etsion",
    "line_axis_stress",
    "mindlin_point",
    "shrink_fit",
    "tee_stub",
]
