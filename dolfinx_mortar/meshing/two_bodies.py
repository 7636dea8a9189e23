# SPDX-License-Identifier: MIT
"""A disc or a ball on a block: disconnected bodies in one mesh, made on rank 0 and distributed."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import basix
import basix.ufl
import ufl
from dolfinx import mesh as dmesh
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import POSITIVE, array, check, number, one_of
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.common.tags import Tags

Arrays = tuple[Floats, Longs]  # nodes (n, d), cells (m, k)

GMSH_OPTIONS = {
    "General.Terminal": 0.0,
    "Mesh.Algorithm": 6.0,  # frontal Delaunay
    "Mesh.Algorithm3D": 10.0,  # HXT
    "Mesh.MeshSizeExtendFromBoundary": 0.0,
    "Mesh.MeshSizeFromCurvature": 0.0,
    "Mesh.MeshSizeFromPoints": 0.0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0.0,
    "Mesh.RecombinationAlgorithm": 3.0,  # blossom, full-quad
    "Mesh.RecombineAll": 0.0,
    "Mesh.SwitchElementTags": 0.0,
}


class TaggedMesh(NamedTuple):
    """A mesh with names of its bodies and their sides."""

    mesh: dmesh.Mesh  # all bodies
    cell_tags: Tags  # bodies
    facet_tags: Tags  # sides and supports


def hertz(
    comm: MPI.Intracomm,
    *,
    kind: str = "paper",
    h: float | tuple[float, float] = 0.05,
    radius: float = 8.0,
    block: tuple[float, float] = (30.0, 10.0),
    gap: float = 0.0,
    cell: str = "triangle",
    half: bool = False,
    limit: float = 10.0,
    core: float = 2.5,
) -> TaggedMesh:
    """Mesh a half disc above a block, non-matching where they touch (collective).

    The block is [-w/2, w/2] x [-t, 0] with (w, t) = ``block``, the disc has its lowest point at (0,
    ``gap``) and its flat face on top; both are symmetric in x. Bodies: "block", "disc". Sides:
    "bottom", "top", "flat", "arc", and "axis", x = 0 in the half.

    Args:
        kind: "paper": about 1200 cells in the disc and 2720 in the block (as triangles); "graded":
            size ``h`` within ``core`` of the first contact point and h (1 + r - core), at most
            ``limit`` h, at distance r mm.
        h: element size of the graded mesh [mm]; a pair for (block, disc).
        radius: of the disc [mm].
        block: width and thickness [mm].
        gap: initial gap [mm], negative for an overlap.
        cell: "triangle" or "quadrilateral".
        half: leave out x < 0; the rest is also the section of a ball on a round plate.
        limit: largest size over h.
        core: distance at which sizes begin to grow [mm].

    Raises:
        ValueError: on all ranks, for an argument out of range or other ones on other ranks.
        RuntimeError: on all ranks, if gmsh is missing or fails.
    """
    given = dict(locals())
    with raised_together(comm):
        check("kind", kind, one_of("paper", "graded"))
        check("cell", cell, one_of("triangle", "quadrilateral"))
        sizes = check_sizes(h, radius, block, gap, "width, thickness")
        if kind == "graded" and max(sizes) > radius / 2:
            raise ValueError(f"h is {h!r}: give at most half of the radius, {radius / 2:g}")
        check("limit", limit, number("the largest size over h,", above=1.0))
        check("core", core, POSITIVE)
    check_same_on_all_ranks(**given)

    def draw_block(gmsh: Any) -> None:
        """Draw [0, w/2] x [-t, 0]."""
        geo, w, t = gmsh.model.geo, 0.5 * block[0], block[1]
        p = [geo.addPoint(x, y, 0.0) for x, y in ((0, 0), (0, -t), (w, -t), (w, 0))]
        lines = [geo.addLine(p[i], p[(i + 1) % 4]) for i in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        if kind == "paper":
            # 34 x 20 rectangles, in the whole block 2720 triangles
            for line, nodes in zip(lines, (21, 35, 21, 35), strict=True):
                geo.mesh.setTransfiniteCurve(line, nodes)
            geo.mesh.setTransfiniteSurface(surface)

    def draw_disc(gmsh: Any) -> None:
        """Draw the quarter disc x >= 0."""
        geo = gmsh.model.geo
        p = [geo.addPoint(x, y + gap, 0.0) for x, y in ((0, 0), (radius, radius), (0, radius))]
        arc = geo.addCircleArc(p[0], p[2], p[1])
        lines = [arc, geo.addLine(p[1], p[2]), geo.addLine(p[2], p[0])]
        geo.addPlaneSurface([geo.addCurveLoop(lines)])

    if kind == "paper":  # about 1200 triangles in the disc
        sizes = 2 * (0.45 / 8.0 * radius,)

    def mesh_half(draw: Callable[[Any], None], y: float, size: float) -> Arrays:
        largest = limit * size if kind == "graded" else size
        ends = core, core + limit - 1.0
        x, cells = mesh_by_gmsh(draw, cell, (0.0, y, 0.0), (size, largest), ends)
        return (on_axis(x[:, :2]), cells) if half else mirrored(x[:, :2], cells)

    def create() -> tuple[Arrays, Arrays]:
        return mesh_half(draw_block, 0.0, sizes[0]), mesh_half(draw_disc, gap, sizes[1])

    sides = sides_of_contact(block[1], radius, gap, "arc", ("axis",))
    return two_bodies(comm, create, cell, "hertz", ("block", "disc"), sides)


def sphere(
    comm: MPI.Intracomm,
    *,
    cell: str = "hexahedron",
    h: float | tuple[float, float] = 0.125,
    radius: float = 8.0,
    block: tuple[float, float, float] = (30.0, 30.0, 10.0),
    gap: float = 0.0,
    core: float | None = None,
    half: bool = False,
) -> TaggedMesh:
    """Mesh a quarter of a half ball above a block, non-matching where they touch (collective).

    As `hertz`, with the quarter x, y >= 0 of the block [-w/2, w/2] x [-l/2, l/2] x [-t, 0], (w, l,
    t) = ``block``. Bodies: "block", "ball". Sides: "bottom", "top", "flat", "sphere", "symmetry_x"
    on x = 0 and "symmetry_y" on y = 0.

    Args:
        cell: "hexahedron" or "tetrahedron" (which needs gmsh).
        h: element size at the first contact point [mm]; a pair for (block, ball). The ball has one
            hexahedron more along the edge of the core, so that meshes do not match.
        radius: of the ball [mm].
        block: width, length and thickness [mm].
        gap: as in `hertz`.
        core: distance from the contact point with size ``h`` [mm], by default an eighth of the
            radius; beyond, sizes grow in proportion to the distance.
        half: mesh the half y >= 0 instead, without "symmetry_x".
    """
    given = dict(locals())
    with raised_together(comm):
        check("cell", cell, one_of("hexahedron", "tetrahedron"))
        sizes = check_sizes(h, radius, block, gap, "width, length, thickness")
        largest = 0.5 * min(radius, block[0] / 2, block[1] / 2, block[2])
        what = "a number, at most half of what the radius and the block leave,"
        wanted = number(what, above=0.0, most=largest)
        inner = check("core", radius / 8 if core is None else core, wanted)
        what = "at most the core, by default an eighth of the radius,"
        check("h", max(sizes), number(what, most=inner))
    check_same_on_all_ranks(**given)
    corner = np.array([block[0] / 2, block[1] / 2, block[2]])

    def draw_block(gmsh: Any) -> None:
        gmsh.model.occ.addBox(0, 0, -corner[2], *corner)

    def draw_ball(gmsh: Any) -> None:
        occ = gmsh.model.occ
        part = [(3, occ.addSphere(0, 0, 0, radius, -1, 0.0, np.pi / 2, np.pi / 2))]
        # moves the pole of the parametrisation away from the contact
        occ.rotate(part, 0, 0, 0, 0, 1, 0, np.pi / 2)
        occ.translate(part, 0, 0, radius + gap)

    def create() -> tuple[Arrays, Arrays]:
        if cell == "hexahedron":
            n = int(np.ceil(inner / sizes[0] - 1e-9))
            x, cells = graded_octant(inner, n, float(np.cbrt(corner.prod())), lambda p: p * corner)
            lower = x * [1.0, 1.0, -1.0] + 0.0, cells
            upper = _ball_of_hexahedra(radius, gap, inner, sizes[1])
        else:
            lower, upper = (
                mesh_by_gmsh(draw, cell, (0.0, 0.0, z), (h, far / inner * h), (inner, far))
                for draw, z, h, far in (
                    (draw_block, 0.0, sizes[0], float(np.linalg.norm(corner))),
                    (draw_ball, gap, sizes[1], 2.0 * radius),
                )
            )
        return (mirrored(*lower), mirrored(*upper)) if half else (lower, upper)

    sides = sides_of_contact(block[2], radius, gap, "sphere", ("symmetry_x", "symmetry_y"))
    return two_bodies(comm, create, cell, "sphere", ("block", "ball"), sides)


def _ball_of_hexahedra(radius: float, gap: float, core: float, h: float) -> Arrays:
    """Mesh a half ball of twice the radius, inverted (a conformal map) around (0, 0, 2R)."""
    n = int(np.ceil(core / h - 1e-9)) + 1

    def outer(p: Floats) -> Floats:
        # equal angles; on a far face the largest coordinate is 1
        angles = np.tan(0.25 * np.pi * p)
        return 2.0 * radius * angles / np.linalg.norm(angles, axis=1, keepdims=True)

    x, cells = graded_octant(core, n, 2.0 * radius, outer)
    arm = x * [1.0, 1.0, -1.0] - [0.0, 0.0, 2.0 * radius]
    x = (2.0 * radius) ** 2 * arm / (arm**2).sum(axis=1, keepdims=True) + [0, 0, 2.0 * radius + gap]
    return x, cells


def graded_octant(edge: float, n: int, radius: float, outer: Callable[[Floats], Floats]) -> Arrays:
    """Mesh an octant x, y, z >= 0 by hexahedra, its outer boundary star-shaped about the origin.

    The cube at the origin, of an edge, has n^3 equal cells; each shell around it repeats the 3 n^2
    facets of its outer faces, larger in proportion to the distance. The radius, a typical distance
    of the outer boundary, gives the number of shells; `outer` maps points (p, 3) on the far faces
    of the unit cube to that boundary.

    >>> x, cells = graded_octant(1.0, 2, 2.0, lambda p: 2.0 * p)
    >>> x.shape, cells.shape
    ((46, 3), (20, 8))
    """
    lattice = np.indices([n + 1] * 3).reshape(3, -1).T
    far = np.flatnonzero(lattice.max(axis=1) == n)
    shells = max(1, round(n * np.log(radius / edge)))
    radii = edge * (radius / edge) ** (np.arange(1, shells + 1) / shells)
    s = ((radii - edge) / (radius - edge))[:, None, None]
    inner, boundary = edge * lattice[far] / n, outer(lattice[far] / n)
    x = np.concatenate([edge * lattice / n, ((1.0 - s) * inner + s * boundary).reshape(-1, 3)])
    nodes = np.arange(len(lattice)).reshape([n + 1] * 3)
    ends = slice(0, n), slice(1, n + 1)
    cube = [nodes[i, j, k].ravel() for i in ends for j in ends for k in ends]
    faces = [np.take(nodes, n, axis=axis) for axis in range(3)]
    quads = np.concatenate(
        [np.stack([face[i, j].ravel() for i in ends for j in ends], axis=1) for face in faces]
    )
    levels = np.vstack([far, len(lattice) + np.arange(len(far) * shells).reshape(shells, -1)])
    levels = levels[:, np.searchsorted(far, quads)]  # (levels, quads, 4)
    parts = [np.hstack([low, high]) for low, high in pairwise(levels)]
    return x, np.concatenate([np.stack(cube, axis=1), *parts])


@contextmanager
def gmsh_model() -> Iterator[Any]:
    """Yield gmsh with an empty model and our options; then restore its state."""
    try:
        import gmsh
    except ImportError as error:
        remedy = "pip install 'dolfinx_mortar[demo]' (or python3-gmsh)"
        raise RuntimeError(f"gmsh is not installed; {remedy}.") from error
    started = not gmsh.isInitialized()
    if started:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    before = {name: gmsh.option.getNumber(name) for name in GMSH_OPTIONS}
    model = gmsh.model.getCurrent()
    gmsh.model.add("dolfinx_mortar body")
    try:
        for name, value in GMSH_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        yield gmsh
    finally:
        gmsh.model.remove()
        for name, value in before.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.setCurrent(model)
        if started:
            gmsh.finalize()


def mesh_by_gmsh(
    draw: Callable[[Any], Any],
    cell: str,
    place: tuple[float, float, float],
    sizes: tuple[float, float],
    ends: tuple[float, float],
) -> Arrays:
    """Nodes (n, 3) and cells (m, k) of what ``draw(gmsh)`` draws.

    Sizes grow linearly between two distances from a point of the drawing.
    """
    with gmsh_model() as gmsh:
        mesh = gmsh.model.mesh
        if cell == "quadrilateral":
            gmsh.option.setNumber("Mesh.Algorithm", 8)  # frontal Delaunay for quads
            gmsh.option.setNumber("Mesh.RecombineAll", 1)
        draw(gmsh)
        gmsh.model.geo.synchronize()
        gmsh.model.occ.synchronize()
        box = [x + side * 0.1 * sizes[0] for side in (-1.0, 1.0) for x in place]
        ((_, origin),) = gmsh.model.getEntitiesInBoundingBox(*box, 0)
        distance, size = mesh.field.add("Distance"), mesh.field.add("Threshold")
        mesh.field.setNumbers(distance, "PointsList", [origin])
        names = ("InField", "SizeMin", "SizeMax", "DistMin", "DistMax")
        for name, value in zip(names, (distance, *sizes, *ends), strict=True):
            mesh.field.setNumber(size, name, value)
        mesh.field.setAsBackgroundMesh(size)
        mesh.generate(gmsh.model.getDimension())
        tags, x, _ = mesh.getNodes()  # numbered from 1 on, in another order
        _, (numbers,), (nodes,) = mesh.getElements(gmsh.model.getDimension())
    cells = nodes.reshape(len(numbers), -1).astype(np.int64) - 1
    if cell == "quadrilateral":
        cells = cells[:, [0, 1, 3, 2]]  # gmsh goes around, dolfinx numbers by tensor products
    return x.reshape(-1, 3)[np.argsort(tags)], cells


def on_axis(x: Floats) -> Floats:
    """Nodes (n, d), with x = 0 exactly where it is round-off."""
    found = x.copy()
    found[np.abs(x[:, 0]) < HALF_OF_DIGITS * np.ptp(x[:, 0]), 0] = 0.0
    return found


def mirrored(x: Floats, cells: Longs) -> Arrays:
    """Add the mirror image in x = 0, sharing nodes there.

    >>> nodes, cells = mirrored(np.eye(4, 3), np.array([[0, 1, 2, 3]]))
    >>> nodes[:, 0].tolist(), cells.tolist()
    ([1.0, 0.0, 0.0, 0.0, -1.0], [[0, 1, 2, 3], [1, 4, 2, 3]])
    """
    x, d, k = on_axis(x), x.shape[1], cells.shape[1]
    off = x[:, 0] != 0.0
    image = np.where(off, len(x) - 1 + np.cumsum(off), np.arange(len(x)))
    # reflection inverts cells; another order of nodes restores the orientation
    turn = [1, 0, 2, 3][:k] if k <= d + 1 else np.arange(k) ^ 1
    nodes = np.concatenate([x, x[off] * [-1.0, 1.0, 1.0][:d]])
    return nodes, np.concatenate([cells, image[cells][:, turn]])


def distribute(
    comm: MPI.Intracomm, create: Callable[[], tuple[Arrays, Arrays]], cell: str, degree: int = 1
) -> tuple[dmesh.Mesh, int]:
    """Mesh of the two bodies that ``create`` returns on rank 0; collective.

    Also the number of input cells of the first body, which come first. RuntimeError without gmsh.
    """
    d = len(basix.topology(basix.CellType[cell])) - 1
    element = basix.ufl.element("Lagrange", cell, degree, shape=(d,))
    nothing = np.empty((0, d)), np.empty((0, element.dim // d), dtype=np.int64)
    bodies: tuple[Arrays, Arrays] = nothing, nothing
    with raised_together(comm):
        if comm.rank == 0:
            try:
                bodies = create()
            except Exception as error:  # gmsh raises bare Exception
                raise RuntimeError(f"gmsh failed: {error}") from error
    (x, cells), (more, others) = bodies
    every = np.ascontiguousarray(np.concatenate([cells, others + len(x)]))
    nodes, domain = np.concatenate([x, more]), ufl.Mesh(element)
    return dmesh.create_mesh(comm, cells=every, x=nodes, e=domain), comm.bcast(len(cells))


def two_bodies(
    comm: MPI.Intracomm,
    create: Callable[[], tuple[Arrays, Arrays]],
    cell: str,
    name: str,
    bodies: tuple[str, str],
    sides: Callable[[Bools, Floats], Mapping[str, Bools]],
) -> TaggedMesh:
    """Mesh of the two bodies that ``create`` returns on rank 0, with names; collective.

    Tags are 1, 2, 3 .. in the order of the names. ``sides`` gets masks (m,) of exterior facets of
    the first body and their nodes (m, k, 3), and returns masks of the sides, of which the last one
    counts.
    """
    mesh, first = distribute(comm, create, cell)
    mesh.name, d = name, mesh.topology.dim
    body = np.where(mesh.topology.original_cell_index < first, 1, 2).astype(np.int32)
    mesh.topology.create_connectivity(d - 1, d)
    facets = dmesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(d - 1, d)
    x: Any = np.empty((0, d, 3))
    if len(facets):  # else dolfinx would divide by 0
        x = mesh.geometry.x[dmesh.entities_to_geometry(mesh, d - 1, facets)]
    marks = sides(body[to_cell.array[to_cell.offsets[facets]]] == 1, x)
    side = np.zeros(len(facets), dtype=np.int32)
    for tag, mark in enumerate(marks.values(), start=1):
        side[mark] = tag
    tags = [
        dmesh.meshtags(mesh, d, np.arange(len(body), dtype=np.int32), body),
        dmesh.meshtags(mesh, d - 1, facets[side > 0], side[side > 0]),
    ]
    tags[0].name, tags[1].name = "bodies", "boundary"
    names = ({name: tag for tag, name in enumerate(n, start=1)} for n in (bodies, marks))
    return TaggedMesh(mesh, *map(Tags, tags, names))


def all_at(values: Floats, position: float, tolerance: float | Floats) -> Bools:
    """Mask (m,) of facets on which values (m, k) at all nodes are a number.

    >>> all_at(np.array([[0.0, 1.0], [1.0, 1.0]]), 1.0, 1e-9).tolist()
    [False, True]
    """
    return np.asarray((np.abs(values - position) < tolerance).all(axis=1))


def sides_of_contact(
    thickness: float, radius: float, gap: float, arc: str, planes: tuple[str, ...]
) -> Callable[[Bools, Floats], dict[str, Bools]]:
    """Sides of a block with its top at height 0 and of a round body above it, for `two_bodies`.

    `arc`: the side of the round body; `planes`: sides x = 0, y = 0 ..
    """

    def sides(of_block: Bools, x: Floats) -> dict[str, Bools]:
        # on the scale of each body
        tolerance = HALF_OF_DIGITS * np.where(of_block, thickness, radius)[:, None]
        height = x[:, :, len(planes)]
        flat = ~of_block & all_at(height, radius + gap, tolerance)
        return {
            "bottom": of_block & all_at(height, -thickness, tolerance),
            "flat": flat,
            "top": of_block & all_at(height, 0.0, tolerance),
            arc: ~of_block & ~flat,
            **{name: all_at(x[:, :, k], 0.0, tolerance) for k, name in enumerate(planes)},
        }

    return sides


def check_sizes(h: Any, radius: Any, block: Any, gap: Any, sides: str) -> tuple[float, ...]:
    """Element sizes of a block and of a round body on it, checked.

    `sides` names those of the block, separated by commas, the thickness last.
    """
    wanted = "give a positive size, or two, of the block and of the round body"
    sizes = check("h", h, array((), (2,), remedy=wanted, holds=_positive))
    check("radius", radius, POSITIVE)
    wanted = f"give positive numbers: {sides}"
    count = sides.count(",") + 1
    *_, thickness = check("block", block, array((count,), remedy=wanted, holds=_positive))
    what = "0 for bodies that touch in a point, or a gap at which none reaches through the other,"
    check("gap", gap, number(what, above=-min(radius, float(thickness))))
    return tuple(map(float, np.broadcast_to(sizes, 2)))


def _positive(sizes: Floats) -> bool:
    return bool((sizes > 0.0).all())
