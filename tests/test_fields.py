# SPDX-License-Identifier: MIT
"""Fields at the integration points by name, whatever the materials are."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh

COMM = MPI.COMM_WORLD
STEEL = dm.VonMises(1000.0, 0.3, 1.0, 100.0)
PLASTIC = (
    "plastic",
    "plastic_strain_norm",
    "plastic_strain_xy",
    "back_stress_norm",
    "back_stress_vector_norm",
    "hardening",
)


def stretched(law):
    """Return a solid of the law, far beyond yield, committed."""
    domain = mesh.create_unit_square(COMM, 4, 4)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    u.interpolate(lambda x: np.array([0.01 * x[1], 0.02 * x[1]]))
    solid = dm.Solid(u, law)
    solid.evaluate()
    solid.commit()
    return solid


@pytest.mark.parametrize("name", PLASTIC)
def test_what_plasticity_has_is_zero_in_elastic_bodies(name):
    """A script need not know the material; the shapes are those of plastic bodies."""
    plastic, elastic = stretched(STEEL), stretched(dm.Elastic(STEEL.E, STEEL.nu))
    assert plastic.max(name) > 0.0 and elastic.max(name) == 0.0
    assert elastic.fields.values(name).shape == plastic.fields.values(name).shape
    average = elastic.cell_values(name)
    assert average.ufl_shape == plastic.cell_values(name).ufl_shape and not average.x.array.any()


@pytest.mark.parametrize("law", [STEEL, dm.Elastic(STEEL.E, STEEL.nu)])
@pytest.mark.parametrize("name", ["stress", "plastic_strain", "back_stress"])
def test_tensors_have_no_maximum(law, name):
    solid = stretched(law)
    with pytest.raises(ValueError, match=f"'{name}' is a tensor.*'{name}_norm'"):
        solid.max(name)
    assert solid.max(f"{name}_norm") == pytest.approx(solid.fields.values(f"{name}_norm").max())


@pytest.mark.parametrize("law", [STEEL, dm.Elastic(STEEL.E, STEEL.nu)])
@pytest.mark.parametrize("name", ["vonmises", "plastic_work", "stress_zy"])
def test_unknown_names(law, name):
    with pytest.raises(ValueError, match="no field"):
        stretched(law).max(name)
