# SPDX-License-Identifier: MIT
"""dolfinx_mortar: contact and tying of elasto-plastic bodies by the dual mortar method.

    solid = dm.Solid(u, {1: steel, 2: steel}, cell_tags)
    contact = dm.Contact(facet_tags, slave=3, master=4)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    report = dm.newton(problem)
    problem.commit()

The theory is in Cermak, Svetlik, Varga, Pospisil (2024), doi 10.4203/ccc.9.10.3.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dolfinx_mortar import materials, shapes
from dolfinx_mortar.audit.pairs import find_pairs
from dolfinx_mortar.common.step_report import Ledger, LoadStep, NewtonNotConverged, StepReport
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.heat import Conductance, Heat
from dolfinx_mortar.interfaces.contact import Contact
from dolfinx_mortar.interfaces.obstacle import Obstacle
from dolfinx_mortar.interfaces.rigid_side import RigidSide
from dolfinx_mortar.interfaces.tie import Tie
from dolfinx_mortar.materials import (
    DruckerPrager,
    Elastic,
    Material,
    MooneyRivlin,
    NeoHooke,
    Ogden,
    Orthotropic,
    VonMises,
    VonMisesVoce,
)
from dolfinx_mortar.mortar.assembly import assemble_mortar, segments
from dolfinx_mortar.output import Writer
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.qp import QPNotSolved
from dolfinx_mortar.report.reaction import reaction
from dolfinx_mortar.report.summary import summarise, write_summary
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.steps.newton import newton
from dolfinx_mortar.steps.time_steps import time_steps
from dolfinx_mortar.steps.walk import load_steps
from dolfinx_mortar.terms.inertia import Damping, Inertia
from dolfinx_mortar.terms.loads import PointForce, PointSpring, Pressure
from dolfinx_mortar.terms.weak_forms import WeakForm

if TYPE_CHECKING:
    from dolfinx_mortar import analytic, meshing, plotting

__version__ = "0.2.0"

__all__ = [
    "Conductance",
    "Contact",
    "ContactProblem",
    "Damping",
    "DruckerPrager",
    "Elastic",
    "Heat",
    "Inertia",
    "Ledger",
    "LoadStep",
    "Material",
    "MooneyRivlin",
    "NeoHooke",
    "NewtonNotConverged",
    "Obstacle",
    "Ogden",
    "Orthotropic",
    "PointForce",
    "PointSpring",
    "Pressure",
    "QPNotSolved",
    "RigidSide",
    "Solid",
    "StepReport",
    "Tags",
    "Term",
    "Tie",
    "VonMises",
    "VonMisesVoce",
    "WeakForm",
    "Writer",
    "analytic",
    "assemble_mortar",
    "find_pairs",
    "load_steps",
    "materials",
    "meshing",
    "newton",
    "plotting",
    "reaction",
    "segments",
    "shapes",
    "summarise",
    "time_steps",
    "write_summary",
]


def __getattr__(name: str) -> Any:
    """Import a companion of the package at first use."""
    if name in ("analytic", "meshing", "plotting"):
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
