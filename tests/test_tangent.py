# SPDX-License-Identifier: MIT
"""The exact tangent is the derivative of forces, gaps and slips as Newton's method uses them."""

from contextlib import nullcontext

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.mortar import integrals
from tests.cases import meshes, meshes_3d
from tests.cases.differences import Differences, accurate
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.triangles import ball
from tests.tool_case import AXIS, TOP, Block

COMM = MPI.COMM_WORLD


def bodies(cell, degree, swap=False, part="sides", surface="facets", friction=0.3, **options):
    """Return the sides of two bodies in contact, the lower one as slave."""
    names = "noise", "fixed", "weight", "slid", "loaded"
    own = {k: options.pop(k) for k in names if k in options}
    create, given = meshes.two_blocks, BLOCKS
    if "hedron" in cell:
        create, given = meshes_3d.two_boxes, BOXES
    domain, cells, tags = create(COMM, **{"cell": cell, **given, **options})
    slave, master = (TOP_OF_LOWER, BOTTOM_OF_UPPER)[:: -1 if swap else 1]
    which, values = tags.indices, tags.values
    if part == "skins":
        tags = meshes.skins(domain, cells, tags)
    elif part == "middles":
        x = mesh.compute_midpoints(domain, tags.dim, which)[:, : tags.dim]
        inner = (np.abs(x - 0.5) < 0.3).all(axis=1)
        tags = mesh.meshtags(domain, tags.dim, which[inner], values[inner])
    elif part == "itself":
        tags = mesh.meshtags(domain, tags.dim, which, np.where(values == master, slave, values))
        master = slave
    contact = dm.Contact(tags, slave=slave, master=master, friction=friction, surface=surface)
    V = fem.functionspace(domain, ("Lagrange", degree, (domain.geometry.dim,)))
    return Differences(V, contact, **own)


def body(cell, degree, shape, surface=None, side=False, bow=0.0, **options):
    """Return the upper side of a body, beside which some nodes are held, on a tool."""
    if cell == "triangle":
        case = Block(n=4 if degree == 1 else 3, size=1.0, fine=0.7, degree=degree)
        V, tags = case.V, case.facets
        case.mesh.geometry.x[:, 1] -= bow * case.mesh.geometry.x[:, 0] ** 2
        values = np.where(side & (tags.values == AXIS), TOP, tags.values)
        tags = mesh.meshtags(case.mesh, 1, tags.indices, values)
    else:
        ends, kind = [[-1.0, -1.0, -1.0], [1.0, 1.0, 0.0]], getattr(mesh.CellType, cell)
        domain = mesh.create_box(COMM, ends, [3, 2, 1], kind)
        top = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
        tags = mesh.meshtags(domain, 2, np.sort(top), np.full(len(top), TOP, np.int32))
        x = domain.geometry.x
        x[:, 0] += 0.1 * x[:, 1] + 0.05 * x[:, 0] ** 2
        x[:, 2] -= 0.05 * x[:, 0] * x[:, 1]
        V = fem.functionspace(domain, ("Lagrange", degree, (3,)))
    tool = dm.Obstacle(tags, slave=TOP, shape=shape, friction=0.3, surface=surface)
    if "weight" not in options:
        tool.rotation.value[...] = 0.2
    return Differences(V, tool, fixed=at_an_end, **options)


def at_an_end(X):
    """Hold all at a large x, and on rollers what is at the least of another coordinate."""
    held = np.repeat(X[:, :1] > 0.8, X.shape[1], axis=1)
    roller = 0 if X.shape[1] == 2 else 1
    held[:, roller] |= X[:, roller] < (1e-9 if roller == 0 else -0.99)
    return held


def on_rollers(X):
    return (np.abs(X) < 1e-9) & (np.arange(X.shape[1]) < X.shape[1] - 1)


def bent(x):
    rise = (x[:, 0] - 1.3) ** 2 + (x[:, 0] * x[:, 1] / 2 if x.shape[1] > 2 else 0.0)
    return moved(x, -np.where(x[:, -1] > 0.005, 0.22, 0.2) * rise)


def arched(x):
    return moved(x, -np.where(x[:, -1] > 0.005, 0.3, 0.25) * (x[:, :-1] ** 2).sum(axis=1))


def inclined(x):
    return moved(x, (x[:, :-1] - 0.5) @ np.tan(np.radians([30, -20]))[: x.shape[1] - 1])


def overhanging(x):
    way = np.array([-0.4, 0.05] if x.shape[1] == 2 else [-0.8, 0.0, 0.05])
    return x + np.outer(beyond(x), way)


def raised(x):
    return moved(x, (0.6 if x.shape[1] == 2 else 1.0) * beyond(x, 0.8))


def sunk(x):
    return moved(x, -0.8 * beyond(x))


def beyond(x, in_space=0.5):
    return (x[:, -1] > 0.005) & (x[:, 0] > (1.3 if x.shape[1] == 2 else in_space))


def moved(x, rise):
    return np.column_stack([x[:, :-1], x[:, -1] + rise])


def around(x):
    return 2 * np.pi * x[..., 0]


def disc_without_distance():
    c, unit = np.array([[0.3], [3.8]]), np.eye(2)[:, :, None]
    return dm.shapes.SignedDistance(
        lambda x: (((x - c) ** 2).sum(axis=0) - 16.0) / 8.0,
        c.ravel(),
        gradient=lambda x: (x - c) / 4.0,
        hessian=lambda x: np.repeat(unit / 4.0, x.shape[1], axis=2),
    )


UNDER, UNIT, PARTLY = (-0.5, 1.6, -0.5, 1.5), (0.0, 1.0, 0.0, 1.0), (0.2, 1.3, -0.1, 0.7)
BLOCKS = {"n_lower": (7, 1), "n_upper": (4, 1), "x_lower": (0.5, 1.5), "x_upper": (1.0, 2.0)}
BOXES = {"n_lower": (3, 3, 1), "n_upper": (2, 3, 1), "upper": PARTLY, "jitter": 0.2}
OVER = {"upper": UNDER}
SMOOTH = {"surface": "smooth", "transform": bent, "gap": 0.01}
HIDING = {"transform": overhanging, "gap": 0.01, "noise": 0.01}
STEP = HIDING | {"transform": raised}
BEHIND = HIDING | {"transform": sunk}
ALIKE = {"n_lower": (4, 1), "n_upper": (3, 1), "x_lower": (0.0, 1.0), "x_upper": (0.0, 1.1)}
SKINS = {"part": "skins", "noise": 1e-3}
BESIDE = {"n_lower": (6, 4), "n_upper": (5, 4), "x_lower": (0.0, 1.0), "x_upper": (0.63, 1.17)}
FLANKS = SKINS | {"upper": (0.43, 1.37, -0.1, 1.12)}
CORNER = SKINS | {"upper": (0.43, 1.37, 0.38, 1.41)}
LITTLE = {"upper": (0.97, 1.87, 0.38, 1.41), "gap": 0.004}
BEYOND = BESIDE | {"x_upper": (0.965, 1.505), "gap": 0.005}
ROLLERS = {"fixed": on_rollers, "transform": inclined}
MIRRORS = {"fixed": on_rollers, "transform": arched, "gap": 0.01}
PLANAR = {"shape": dm.shapes.Cylinder([0.3, 0.8], 1.0)}
RING = {"shape": dm.shapes.Torus([0.0, 0.5], 0.7, 0.6), "weight": around}
SOLID = {"shape": dm.shapes.Torus([0.1, 0.0, 0.7], 0.5, 0.8, [0.1, 0.2, 1.0])}
LEVELS = {"shape": disc_without_distance(), "side": True}
CURVED = {"shape": dm.shapes.Triangles(ball(1, 2.0, (0.1, 0.2, 2.0)), crease=45.0)}
ROWS = [  # cell, degree, what it has to contain, options
    ("triangle", 1, "partly", {}),
    ("triangle", 2, "partly", {}),
    ("triangle", 1, "partly", {"fixed": lambda X: X[:, :1] > [1.2, 1.2]}),  # facets without nodes
    ("triangle", 2, "partly smooth", SMOOTH),
    ("triangle", 2, "partly smooth", SMOOTH | {"order": 2}),
    ("triangle", 2, "partly smooth", SMOOTH | {"weight": around, "swap": True}),
    ("triangle", 1, "partly", HIDING),
    ("triangle", 2, "step", STEP),
    ("triangle", 1, "partly", BEHIND),
    ("triangle", 1, "lost", {"slid": -0.2, "gap": 0.01}),
    ("triangle", 1, "held", ROLLERS | ALIKE | {"x_upper": (-0.4, 1.1), "n_upper": (2, 1)}),
    ("triangle", 2, "held", MIRRORS | ALIKE | {"order": 2}),
    ("triangle", 2, "edges", SKINS | BESIDE | {"swap": True}),
    ("triangle", 1, "", SKINS | BEYOND),
    ("tetrahedron", 1, "partly", {}),
    ("tetrahedron", 1, "partly", {"friction": None, "swap": True}),
    ("tetrahedron", 1, "partly smooth", SMOOTH),
    ("tetrahedron", 1, "partly", {"loaded": 0.2}),
    ("tetrahedron", 1, "partly", BEHIND),
    ("tetrahedron", 2, "partly", {"noise": 0.01, "swap": True}),  # 256 pairs around a node
    ("tetrahedron", 2, "", OVER | {"noise": 0.01, "order": 2}),
    ("tetrahedron", 2, "edges", FLANKS),
    ("hexahedron", 1, "edges", SKINS | {"upper": (0.23, 0.77, 0.21, 0.75), "swap": True}),
    ("hexahedron", 1, "edges", CORNER | {"swap": True}),
    ("hexahedron", 1, "", SKINS | LITTLE | {"swap": True}),
    ("hexahedron", 1, "partly", {}),
    ("hexahedron", 1, "held", MIRRORS | {"upper": UNIT, "swap": True}),
    ("hexahedron", 2, "partly smooth", SMOOTH | {"noise": 0.01}),
    ("hexahedron", 2, "smooth", SMOOTH | OVER | {"noise": 0.01, "order": 2}),
    *((cell, 1, "partly", {"part": "itself"}) for cell in ("triangle", "tetrahedron")),
    *(("triangle", 1 + (tool is RING), "held partly", tool) for tool in (PLANAR, RING)),
    *(
        ("triangle", 1 + (tool is PLANAR), "held partly", tool | {"surface": "smooth", "bow": 0.2})
        for tool in (PLANAR, RING)
    ),
    ("triangle", 1, "held partly", LEVELS),
    ("tetrahedron", 2, "held partly", SOLID),
    ("hexahedron", 1, "held partly", CURVED),
    ("hexahedron", 1, "held partly", SOLID | {"surface": "smooth"}),
]


def created(cell, degree, options):
    return (body if "shape" in options else bodies)(cell, degree, **options)


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree", "contains", "options"), ROWS)
def test_derivatives_are_those_of_forces_gaps_and_slips(cell, degree, contains, options):
    """Along a direction, to 1e-9 of the largest entry, with what `held` says as it is."""
    with accurate():
        case = created(cell, degree, options)
        assert max(case.errors()) < 1e-9
    assert set(contains.split()) <= case.seen


@pytest.mark.parametrize(
    ("cell", "options"),
    [("triangle", SKINS | BESIDE), ("hexahedron", CORNER | {"swap": True})],
)
def test_what_is_held_is_bounded_at_edges(cell, options):
    """Measured: of forces .003 to .2 of the largest entry, of gaps 3e-6, of slips 7e-4."""
    with accurate():
        forces, gaps, slips = created(cell, 1, options).errors(nullcontext)
    assert 1e-3 < forces < 0.3 and gaps < 1e-5 and slips < 1e-3


@pytest.mark.parametrize(
    ("cell", "degree", "n"),
    [("triangle", 1, (7, 1)), ("triangle", 2, (7, 1)), ("hexahedron", 1, (5, 5, 1))],
)
def test_nothing_is_held_in_the_middle_of_faces(cell, degree, n):
    """Where normals do not spread: in no number that Newton's method uses."""
    whole = {"x_lower": (0.0, 1.0), "x_upper": (0.0, 1.0)} if len(n) == 2 else {"upper": UNIT}
    sizes = {"n_lower": n, "n_upper": (*(k - 1 for k in n[:-1]), 1)}
    with accurate():
        case = bodies(cell, degree, part="middles", **whole, **sizes)
        assert max(case.errors(nullcontext)) < 1e-7


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
def test_sides_that_end_together_do_not_cut_each_other(cell):
    """Whichever of them ends beyond the other one by the residual of a solution."""
    sides = (
        {"x_lower": (0.0, 1.0), "x_upper": (0.0, 1.0)} if cell == "triangle" else {"upper": UNIT}
    )
    found = []
    for longer in (1e-10, -1e-10):
        case = bodies(cell, 1, noise=0.0, **sides)
        slave = case.system.sides[0].slave.nodes
        case.start[slave, :-1] += longer * np.sign(case.X[slave, :-1] - 0.5)
        case.du[slave] *= 2.0
        found.append(case.derivatives())
    for one, other in zip(*found, strict=True):
        assert np.abs(one - other).max() < 1e-6 * np.abs(one).max()


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_derivatives_where_weights_fall_with_the_gap(cell, monkeypatch):
    """From a gap of -1 on, so at all points; in space a bend of weights is integrated slowly."""
    with accurate():
        assert max(created("tetrahedron", 1, STEP).errors()) < 4e-3
        reach = lambda slave, *_: np.tile([-1.0, 0.3], (len(slave.facets), 1))  # noqa: E731
        monkeypatch.setattr(integrals, "_reaches", reach)
        assert max(created(cell, 1, {}).errors()) < 1e-9


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_where_edges_nearly_coincide(cell):
    """Corners of segments move a thousand times as fast as nodes, errors of quadrature do not."""
    alike = {"n_lower": (2, 2, 1), "n_upper": (2, 2, 1), "upper": UNIT, "jitter": 0.0}
    case = bodies(cell, 1, noise=2e-3, **SMOOTH, **alike)
    assert max(case.errors(h=1e-7)) < 1e-3
