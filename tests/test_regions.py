# SPDX-License-Identifier: MIT
"""Laws by cell tag, and invalid displacements and tags."""

from typing import Any

import numpy as np
import pytest

from dolfinx import fem, mesh
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.solid.solid import Solid
from tests.cases.solid import (
    STEEL,
    create_displacement,
    create_domain,
    create_tags,
    residual,
    set_wave,
    total,
)

pytestmark = pytest.mark.mpi


def test_materials_by_tag() -> None:
    """Parameters and laws follow the tags: elastic is von Mises that never yields."""
    domain = create_domain("triangle", 6)
    tags = create_tags(domain, lambda x: np.where(x[:, 1] < 1.0, 7, np.where(x[:, 0] < 0.5, 2, 30)))
    soft = VonMises(E=50_000.0, nu=0.4, Y=200.0, a=0.0)
    never = VonMises(E=100_000.0, nu=0.1, Y=1e9, a=1.0)
    results = []
    for laws in (
        {2: soft, 7: STEEL, 30: never},
        {30: Elastic(never.E, never.nu), 7: STEEL, 2: soft},
    ):
        solid = Solid(create_displacement(domain), laws, tags)
        set_wave(solid.u, 2e-3)
        solid.evaluate()
        solid.commit()
        set_wave(solid.u, 2e-3, 0.7)
        K = solid.create_matrix()
        solid.assemble_tangent(K)
        solid.evaluate()
        norms = [solid.max(n) for n in ("von_mises", "back_stress_norm", "plastic_strain_norm")]
        forces = np.sqrt(total(residual(solid) ** 2))
        numbers = [total(solid.energy()), K.norm(), forces, solid.elastic_norm(solid.u), *norms]
        results.append([*numbers, solid.element_force_norm(), solid.plastic_area()])
        assert not solid.linear
    assert np.allclose(*results, rtol=1e-11)


def wrong_spaces() -> list[tuple[str, Any]]:
    """Return what a message should say, with a displacement in the wrong space."""
    domain = create_domain("triangle")
    return [
        (r"shape \(\)", fem.Function(fem.functionspace(domain, ("Lagrange", 1)))),
        (r"shape \(3,\)", fem.Function(fem.functionspace(domain, ("Lagrange", 1, (3,))))),
        ("degree 3", fem.Function(fem.functionspace(domain, ("Lagrange", 3, (2,))))),
        ("continuous", fem.Function(fem.functionspace(domain, ("DG", 1, (2,))))),
        ("dolfinx.fem.Function", 3.0),
    ]


@pytest.mark.parametrize("case", range(5))
def test_wrong_displacement(case: int) -> None:
    """A displacement that is not one is refused on all ranks."""
    message, u = wrong_spaces()[case]
    with pytest.raises(ValueError, match=message):
        Solid(u, STEEL)


def test_wrong_tags() -> None:
    """Tags and materials that do not cover each other are refused on all ranks."""
    domain, other = create_domain("triangle"), create_domain("triangle")
    u = create_displacement(domain)
    tags = create_tags(domain, lambda x: 1 + (x[:, 1] > 1.0))
    owned = domain.topology.index_map(2).size_local
    count = int(total(tags.values[:owned] == 2))
    with pytest.raises(ValueError, match=rf"no entry for {count} cells of the tags 2"):
        Solid(u, {1: STEEL}, tags)
    with pytest.raises(ValueError, match="no cell has the tag 5"):
        Solid(u, {1: STEEL, 2: STEEL, 5: STEEL}, tags)
    with pytest.raises(ValueError, match="cell_tags"):
        Solid(u, {1: STEEL})
    with pytest.raises(ValueError, match="of the same mesh"):
        Solid(u, {1: STEEL, 2: STEEL}, create_tags(other, lambda x: 1 + (x[:, 1] > 1.0)))
    none = np.zeros(0, dtype=np.int32)
    with pytest.raises(ValueError, match=r"no entry for 40 cells of the tags none"):
        Solid(u, {1: STEEL}, mesh.meshtags(domain, 2, none, none))
    with pytest.raises(ValueError, match="cell_tags"):
        Solid(u, {1: STEEL}, mesh.meshtags(domain, 1, none, none))
    with pytest.raises(ValueError, match="not a material"):
        Solid(u, {1: STEEL, 2: VonMises}, tags)
    with pytest.raises(ValueError, match="not a material"):
        Solid(u, 206_900.0)


def test_tags_of_owned_cells_suffice() -> None:
    """Ghost cells take the material of their owner, so tags need not list them."""
    domain = create_domain("triangle")
    owned = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    tags = mesh.meshtags(domain, 2, owned, np.full(len(owned), 3, dtype=np.int32))
    solids = [Solid(create_displacement(domain), *m) for m in (({3: STEEL}, tags), (STEEL, None))]
    for solid in solids:
        set_wave(solid.u, 2e-3)
    assert np.isclose(*(total(solid.energy()) for solid in solids), rtol=1e-14)
