# SPDX-License-Identifier: MIT
"""Laws by cell tag, and invalid displacements and tags."""

import numpy as np
import pytest

from dolfinx import fem, mesh
from dolfinx_mortar.materials import Elastic, VonMises
from dolfinx_mortar.solid.solid import Solid
from tests.cases.pressed_blocks import rejected
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


def test_what_is_no_displacement_or_no_law_of_all_cells() -> None:
    """Refused on all ranks."""
    domain, other = create_domain("triangle"), create_domain("triangle")
    u, none = create_displacement(domain), np.zeros(0, dtype=np.int32)
    tags, others = (create_tags(m, lambda x: 1 + (x[:, 1] > 1.0)) for m in (domain, other))
    owned = domain.topology.index_map(2).size_local
    count = int(total(tags.values[:owned] == 2))
    elements = {
        "shape ()": ("Lagrange", 1),
        "shape (3,)": ("Lagrange", 1, (3,)),
        "degree 3": ("Lagrange", 3, (2,)),
        "continuous": ("DG", 1, (2,)),
    }
    both = {1: STEEL, 2: STEEL}
    for given, words in (
        *(((fem.Function(fem.functionspace(domain, e)), STEEL), w) for w, e in elements.items()),
        ((3.0, STEEL), "dolfinx.fem.Function"),
        ((u, {1: STEEL}, tags), f"no entry for {count} cells of the tags 2"),
        ((u, both | {5: STEEL}, tags), "no cell has the tag 5"),
        ((u, {1: STEEL}), "cell_tags"),
        ((u, both, others), "of the same mesh"),
        (
            (u, {1: STEEL}, mesh.meshtags(domain, 2, none, none)),
            "no entry for 40 cells",
        ),
        ((u, {1: STEEL}, mesh.meshtags(domain, 1, none, none)), "cell_tags"),
        ((u, {1: STEEL, 2: VonMises}, tags), "not a material"),
        ((u, 206_900.0), "not a material"),
    ):
        with rejected(words):
            Solid(*given)


def test_tags_of_owned_cells_suffice() -> None:
    """Ghost cells take the material of their owner, so tags need not list them."""
    domain = create_domain("triangle")
    owned = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    tags = mesh.meshtags(domain, 2, owned, np.full(len(owned), 3, dtype=np.int32))
    solids = [Solid(create_displacement(domain), *m) for m in (({3: STEEL}, tags), (STEEL, None))]
    for solid in solids:
        set_wave(solid.u, 2e-3)
    assert np.isclose(*(total(solid.energy()) for solid in solids), rtol=1e-14)
