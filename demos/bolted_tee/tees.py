# SPDX-License-Identifier: MIT
"""The mesh of the demo: a quarter of two T-stubs, flange on flange, and half of their bolt.

Structured blocks of hexahedra. Axes: x across the web, y along it, z along the bolt. The middle
planes of the webs, x = 0, and of the bolt, y = 0, are planes of symmetry. The flanges meet at
z = 0, where the bolt is cut.
"""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx
import dolfinx_mortar as dm

Array = npt.NDArray[np.float64]

# mm, about those of an IPE 300 with bolts M12
FLANGE, WEB, FILLET = 10.7, 7.1, 15.0  # thicknesses and the radius between them
HALF, WIDTH, HEIGHT = 75.0, 40.0, 60.0  # half flange, length of the stub, height of the web
GAUGE, HOLE = 45.0, 13.0  # web's middle to bolt, diameter of the hole
SHANK, HEAD, THICK = 10.36, 18.0, 7.5  # diameters (the shank has the stress area 84.3 mm2), height
AROUND = (16.0, 14.0)  # half width of the part of a flange, upper and lower, around the hole

UPPER, LOWER, BOLT, NUT = "upper tee", "lower tee", "bolt", "nut"
BODIES = {UPPER: 1, LOWER: 2, BOLT: 3, NUT: 4}
SIDES = {
    name: tag
    for tag, name in enumerate(
        (
            *("upper flange", "lower flange", "seat", "lower seat", "head", "nut's face", "cut"),
            *("nut's cut", "pulled", "held", "web", "front"),
        ),
        start=1,
    )
}


def blend(one: Array, other: Array, shares: Array) -> Array:
    """Return the grid (m, k, 2) of k points between curves (m, 2)."""
    return one[:, None] + shares[None, :, None] * (other - one)[:, None]


def rectangle(x: Array, y: Array) -> Array:
    """Return the grid of two sets of lines."""
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)


def three_sides(width: float, height: float, along: int, across: int) -> Array:
    """Return points on the right, upper and left side of a rectangle over 0."""
    up, left = np.linspace(0, height, along + 1), np.linspace(width, -width, across + 1)
    right = [(width, y) for y in up]
    return np.array(right + [(x, height) for x in left[1:-1]] + [(-width, y) for y in up[::-1]])


def arc(radius: float, first: float, last: float, n: int) -> Array:
    """Return n + 1 points of a circle between two angles in degrees."""
    angle = np.radians(np.linspace(first, last, n + 1))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def half_circle(radius: float, corners: tuple[float, float], along: int, across: int) -> Array:
    """Return points of a half circle that go with `three_sides`."""
    a, b = corners
    parts = [(0, a, along), (a, b, across), (b, 180, along)]
    angles = np.concatenate([np.linspace(*p[:2], p[2] + 1)[k > 0 :] for k, p in enumerate(parts)])
    angles = np.radians(angles)
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def extrude(sheets: list[Array], lines: Array, order: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return points and hexahedra of sheets (m, k, 2) in "xy" or "xz", moved along lines."""
    points, cells, first = [], [], 0
    for sheet in sheets:
        m, k = sheet.shape[:2]
        index = np.arange(m * k * len(lines)).reshape(m, k, len(lines)) + first
        flat = np.broadcast_to(sheet[:, :, None], (m, k, len(lines), 2))
        moved = np.broadcast_to(lines, (m, k, len(lines)))
        columns = [flat[..., 0], flat[..., 1], moved]
        if order == "xz":
            columns = [columns[0], columns[2], columns[1]]
        x = np.stack(columns, axis=-1)
        edges = np.array([x[1, 0, 0], x[0, 1, 0], x[0, 0, 1]]) - x[0, 0, 0]
        x = x if np.linalg.det(edges) > 0.0 else x[::-1]
        points.append(x.reshape(-1, 3))
        corners = [
            index[i : m - 1 + i, j : k - 1 + j, n : len(lines) - 1 + n].ravel()
            for n in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ]
        cells.append(np.stack(corners, axis=1))
        first += m * k * len(lines)
    return np.concatenate(points), np.concatenate(cells)


def tee(n: int, around: float) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a quarter of the upper tee with n layers in its flange."""
    ny, nz, half_web, toe = n + 1, n, max(n - 1, 1), n
    y, z = np.linspace(0.0, WIDTH / 2, ny + 1), np.linspace(0.0, FLANGE, nz + 1)
    inside, outside = GAUGE - around, GAUGE + around
    edge = WEB / 2 + FILLET
    corner = np.degrees(np.arctan2(WIDTH / 2, around))
    kind = (corner, 180 - corner), ny, 2 * n
    hole, seat = (half_circle(r, *kind) for r in (HOLE / 2, HEAD / 2 + 1.0))
    border = three_sides(around, WIDTH / 2, *kind[1:])
    centre = np.array([GAUGE, 0.0])
    plan = [
        rectangle(np.linspace(edge, inside, n + 1), y),
        rectangle(np.linspace(outside, HALF, n + 1), y),
        centre + blend(hole, seat, np.linspace(0, 1, max(n - 1, 1) + 1)),
        centre + blend(seat, border, np.linspace(0, 1, n + 1)),
    ]
    middle = np.array([edge, FLANGE + FILLET])  # of the fillet
    fillet = middle + arc(FILLET, 270, 180, 2 * toe)
    low, high = fillet[: toe + 1][::-1], fillet[toe:]
    start = np.array([0.0, 1.1 * FLANGE])
    across = start + np.linspace(0, 1, half_web + 1)[:, None] * (fillet[toe] - start)
    upper_line = np.concatenate([across, low[1:]])
    x = np.concatenate([np.linspace(0, 1, half_web + 1) * low[0, 0], low[1:, 0]])
    below = np.column_stack([x, np.zeros_like(x)])
    axis = np.column_stack([np.zeros(toe + 1), np.linspace(start[1], high[-1, 1], toe + 1)])
    profile = [
        blend(below, upper_line, np.linspace(0, 1, nz + 1)),
        blend(axis, high, np.linspace(0, 1, half_web + 1)).transpose(1, 0, 2),
        rectangle(
            np.linspace(0, WEB / 2, half_web + 1), np.linspace(high[-1, 1], HEIGHT, 2 * n + 1)
        ),
    ]
    profile[0][-1, :, 1] = z  # where it meets the plan
    parts = extrude(plan, z, "xy"), extrude(profile, y, "xz")
    return merge(parts)


def bolt(n: int, finer: int) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the upper half of half a bolt, with its head."""
    k, core = max(n - 1, 1) + finer, 0.55 * SHANK / 2
    square = three_sides(core, core, k, 2 * k)
    kind = (45.0, 135.0), k, 2 * k
    shank, head = (half_circle(d / 2, *kind) for d in (SHANK, HEAD))
    centre = np.array([GAUGE, 0.0])
    inner = [
        centre + rectangle(np.linspace(-core, core, 2 * k + 1), np.linspace(0, core, k + 1)),
        centre + blend(square, shank, np.linspace(0, 1, k + 1)),
    ]
    ring = centre + blend(shank, head, np.linspace(0, 1, k + 1))
    z = np.linspace(0.0, FLANGE, n + 1)
    top = FLANGE + np.linspace(0.0, THICK, max(n - 1, 1) + 1)
    return merge((extrude(inner, z, "xy"), extrude([*inner, ring], top, "xy")))


def merge(parts) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return parts of one body with one node where several lie at a place."""
    shift = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([points for points, _ in parts])
    cells = np.concatenate([cells + s for (_, cells), s in zip(parts, shift, strict=False)])
    _, first, number = np.unique(
        np.round(points, 6), axis=0, return_index=True, return_inverse=True
    )
    return points[first], number.ravel()[cells]


def create(comm: MPI.Comm, n: int) -> tuple[dolfinx.mesh.Mesh, dm.Tags, dm.Tags]:
    """Return mesh, cell tags and facet tags with names; n layers in the upper flange.

    The meshes of lower tee and nut differ from those of upper tee and bolt, so that no sides match.
    """
    down = np.array([1.0, 1.0, -1.0])
    bodies = [*(tee(n, half) for half in AROUND), bolt(n, 0), bolt(n, 1)]
    bodies = [(x * down, c) if k % 2 else (x, c) for k, (x, c) in enumerate(bodies)]
    shift = np.cumsum([0, *(len(x) for x, _ in bodies)])
    points = np.concatenate([x for x, _ in bodies])
    cells = np.concatenate([c + s for (_, c), s in zip(bodies, shift, strict=False)])
    body = np.repeat(np.arange(1, 5), [len(c) for _, c in bodies]).astype(np.int32)
    own = slice(None) if comm.rank == 0 else slice(0, 0)
    element = basix.ufl.element("Lagrange", "hexahedron", 1, shape=(3,))
    mesh = dolfinx.mesh.create_mesh(comm, cells[own], x=points[own], e=element)
    of_cell = body[mesh.topology.original_cell_index]
    count = mesh.topology.index_map(3).size_local
    cell_tags = dolfinx.mesh.meshtags(mesh, 3, np.arange(count, dtype=np.int32), of_cell[:count])
    return mesh, dm.Tags(cell_tags, BODIES), dm.Tags(find_sides(mesh, of_cell), SIDES)


def find_sides(mesh: dolfinx.mesh.Mesh, of_cell: npt.NDArray[np.int32]) -> dolfinx.mesh.MeshTags:
    """Tag the exterior facets by their body and their middle."""
    mesh.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(2, 3)
    body = of_cell[to_cell.array[to_cell.offsets[facets]]]
    x, y, z = dolfinx.mesh.compute_midpoints(mesh, 2, facets).T

    def on(v: Array, a: float) -> npt.NDArray[np.bool_]:
        return np.abs(v - a) < 1e-6

    outside = x > WEB / 2 + FILLET
    marks = {
        "upper flange": (body == 1) & on(z, 0.0),
        "lower flange": (body == 2) & on(z, 0.0),
        "seat": (body == 1) & on(z, FLANGE) & outside,
        "lower seat": (body == 2) & on(z, -FLANGE) & outside,
        "head": (body == 3) & on(z, FLANGE),
        "nut's face": (body == 4) & on(z, -FLANGE),
        "cut": (body == 3) & on(z, 0.0),
        "nut's cut": (body == 4) & on(z, 0.0),
        "pulled": on(z, HEIGHT),
        "held": on(z, -HEIGHT),
        "web": on(x, 0.0),
        "front": on(y, 0.0),
    }
    values = np.zeros(len(facets), dtype=np.int32)
    for name, chosen in marks.items():
        values[chosen] = SIDES[name]
    kept = values > 0
    order = np.argsort(facets[kept])
    return dolfinx.mesh.meshtags(mesh, 2, facets[kept][order], values[kept][order])
