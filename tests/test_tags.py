"""Names of tags: wherever a tag is taken, and what a mistyped one is told."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from tests.cases.integrals import integral
from tests.cases.pressed_blocks import COMM, PressedBlocks, rejected

SIDES = {"ball": 4, "plate": 3, "plates": 99}
SOFT, HARD = dm.Elastic(E=1.0, nu=0.3), dm.Elastic(E=9.0, nu=0.3)


def case():
    """Return the space, cell tags and facet tags of two blocks, with names."""
    b = PressedBlocks(n_lower=(4, 2), n_upper=(3, 2))
    return b.V, dm.Tags(b.cells, {"low": 1, "up": 2}), dm.Tags(b.facets, SIDES)


def test_a_name_stands_for_its_tag():
    _, _, facet_tags = case()
    assert list(facet_tags.names) == ["plate", "ball", "plates"]
    assert facet_tags.tag("ball") == 4 and facet_tags.tag(7) == 7
    assert (facet_tags.find("ball") == facet_tags.find(4)).all()
    assert COMM.allreduce(len(facet_tags.find("ball"))) > 0
    with pytest.raises(TypeError):
        facet_tags.names["ball"] = 3
    dm.Tie(facet_tags, slave="ball", master="plate")


def falling(V, tags):
    """Return tags, their entities last to first, as lists that are stacked may have them."""
    order = slice(None, None, -1)
    entities, values = tags.indices[order].copy(), tags.values[order].copy()
    return dmesh.meshtags(V.mesh, tags.dim, entities, values)


@pytest.mark.mpi
def test_unsorted_tags_lose_no_facet():
    """Of the facets in falling order ds finds one on each rank."""
    V, _, facet_tags = case()
    sides = dm.Tags(falling(V, facet_tags), SIDES)
    assert (sides.indices == facet_tags.indices).all()
    assert (sides.values == facet_tags.values).all()
    ds, one = ufl.Measure("ds", V.mesh, subdomain_data=sides), fem.Constant(V.mesh, 1.0)
    assert integral(one * ds(sides.tag("plate"))) == pytest.approx(1.0, rel=1e-14)


def inside(V):
    """Return tags 7 of the facets inside the mesh."""
    V.mesh.topology.create_connectivity(1, 2)
    count = V.mesh.topology.index_map(1).size_local
    facets = np.setdiff1d(np.arange(count), dmesh.exterior_facet_indices(V.mesh.topology))
    facets = facets.astype(np.int32)
    return dmesh.meshtags(V.mesh, 1, facets, np.full(len(facets), 7, dtype=np.int32))


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("kind", "choose", "words"),
    [
        ("ds", lambda V, bodies, sides: (falling(V, sides), 3), ["ds(3)", "not sorted", "Tags"]),
        ("ds", lambda V, bodies, sides: (sides, 99), ["ds('plates')", "nowhere", "'ball' (4)"]),
        ("ds", lambda V, bodies, sides: (inside(V), 7), ["ds(7)", "nowhere", "inside the mesh"]),
        ("ds", lambda V, bodies, sides: (None, 3), ["ds(3)", "MeshTags of the facets"]),
        ("ds", lambda V, bodies, sides: (bodies, 1), ["ds('low')", "MeshTags of the facets"]),
        ("ds", lambda V, bodies, sides: (case()[2], 3), ["ds('plate')", "of the same mesh"]),
        ("dx", lambda V, bodies, sides: (bodies, 77), ["dx(77)", "nowhere", "'up' (2)"]),
    ],
)
def test_integrals_that_would_be_lost_are_refused(kind, choose, words):
    """On all ranks, of loads and of other terms; dolfinx integrates what it finds."""
    V, cell_tags, facet_tags = case()
    tags, tag = choose(V, cell_tags, facet_tags)
    solid = dm.Solid(fem.Function(V), SOFT)
    over = ufl.Measure(kind, V.mesh, subdomain_data=tags)(tag)
    v, u = ufl.TestFunction(V), solid.u
    for name, make in (
        ("loads", lambda: dm.ContactProblem(solid, loads=v[0] * over)),
        ("potential", lambda: dm.ContactProblem(solid, potential=u[0] ** 2 * over)),
        ("residual", lambda: dm.WeakForm(solid, residual=u[0] * v[0] * over)),
    ):
        with rejected(f"{name}: ", *words):
            make()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("bal", ["slave is 'bal': no such name; did you mean 'ball'?", "'plate' (3), 'ball' (4)"]),
        ("Q", ["slave is 'Q': no such name. There are 'plate' (3), 'ball' (4), 'plates' (99)"]),
    ],
)
def test_a_mistyped_name_lists_the_names(given, words):
    V, _, facet_tags = case()
    for kind in (dm.Contact, dm.Tie, lambda *a, **k: dm.assemble_mortar(V, *a, **k)):
        with rejected(*words):
            kind(facet_tags, slave=given, master="plate")
    for find in (facet_tags.find, facet_tags.tag):
        with rejected("no such name"):
            find(given)


def test_tags_without_names_say_how_to_name_them():
    with rejected("no names; give the tag", "Tags(tags, {'ball': tag})"):
        dm.Contact(PressedBlocks().facets, slave="ball", master=3)


@pytest.mark.mpi
def test_messages_call_sides_by_their_names():
    V, _, facet_tags = case()
    with pytest.raises(ValueError, match="slave and master are both tag 'ball'"):
        dm.Tie(facet_tags, slave="ball", master=4)
    with pytest.raises(ValueError, match=r"slave='plates' marks no facet.*'plate' \(3\)"):
        dm.assemble_mortar(V, facet_tags, slave="plates", master="plate")
    again = dm.Tags(facet_tags, SIDES | {"plate too": 3})
    assert str(dm.Contact(again, slave="ball", master=3)) == "Contact(slave='ball', master='plate')"


@pytest.mark.mpi
def test_materials_and_eigenstrains_by_name():
    V, cell_tags, _ = case()
    low, up = cell_tags.names.values()
    energies = []
    for laws, strains in (
        ({low: SOFT, up: HARD}, {up: 0.1}),
        ({"up": HARD, "low": SOFT}, {"up": 0.1}),
        ({"low": SOFT, up: HARD}, {"up": 0.1, low: 0.0}),
    ):
        u = fem.Function(V)
        u.interpolate(lambda x: np.stack([x[0] * x[1], x[1]]))
        solid = dm.Solid(u, laws, cell_tags, eigenstrain=strains)
        energies.append(COMM.allreduce(solid.energy()))
    assert energies[0] > 0.1
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-13)


@pytest.mark.parametrize(
    ("laws", "said"),
    [
        ({"low": SOFT, "upp": HARD}, "materials: the key is 'upp': no such name; .*'up'"),
        ({"low": SOFT}, r"no entry for 12 cells of the tags 'up'"),
        ({"low": SOFT, "up": HARD, 77: HARD}, r"no cell has the tag 77; cell_tags has 'low' \("),
        ({(1,): SOFT}, r"the key is \(1,\): give a tag"),
    ],
)
def test_wrong_names_of_bodies(laws, said):
    V, cell_tags, _ = case()
    with pytest.raises(ValueError, match=said):
        dm.Solid(fem.Function(V), laws, cell_tags)


def test_a_body_has_one_law_and_one_eigenstrain():
    V, cell_tags, _ = case()
    low = cell_tags.names["low"]
    with pytest.raises(ValueError, match="materials has 'low' twice"):
        dm.Solid(fem.Function(V), {"low": SOFT, low: HARD, "up": SOFT}, cell_tags)
    with pytest.raises(ValueError, match="eigenstrain has 'low' twice"):
        dm.Solid(fem.Function(V), SOFT, cell_tags, eigenstrain={"low": 0.1, low: 0.2})
    with pytest.raises(ValueError, match="eigenstrain: the key is 'lo': no such name"):
        dm.Solid(fem.Function(V), SOFT, cell_tags, eigenstrain={"lo": 0.1})
