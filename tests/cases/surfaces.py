# SPDX-License-Identifier: MIT
"""Surfaces of triangles or quadrilaterals without a mesh, and their operators as dense matrices."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay

from dolfinx_mortar.geometry import segments
from dolfinx_mortar.geometry.facets import LINE2, QUAD4, TRI3, Facets
from dolfinx_mortar.mortar import duals

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Side:
    """One side of an interface."""

    x: Floats  # (n, 3) nodes
    facets: Ints  # (m, k), anticlockwise from outside

    @property
    def corners(self) -> Floats:
        """Node coordinates (m, k, 3) of the facets."""
        return self.x[self.facets]

    @property
    def geometry(self) -> Facets:
        """The facets as the package wants them."""
        return Facets({2: LINE2, 3: TRI3, 4: QUAD4}[self.facets.shape[1]], self.corners)

    def reversed(self) -> "Side":
        """Return the side with the opposite normals."""
        return Side(self.x, self.facets[:, ::-1])

    def moved(self, matrix=None, shift=(0.0, 0.0, 0.0)) -> "Side":
        """Return the side turned or sheared, then shifted."""
        matrix = np.eye(3) if matrix is None else matrix
        return Side(self.x @ np.asarray(matrix).T + np.asarray(shift), self.facets)

    def renumbered(self, seed: int) -> "Side":
        """Return the side with facets, nodes and first nodes of facets in another order."""
        rng = np.random.default_rng(seed)
        order = rng.permutation(len(self.x))
        facets = np.argsort(order)[self.facets[rng.permutation(len(self.facets))]]
        start = rng.integers(facets.shape[1], size=len(facets))
        columns = (start[:, None] + np.arange(facets.shape[1])) % facets.shape[1]
        return Side(self.x[order], np.take_along_axis(facets, columns, axis=1).astype(np.int32))


def joined(*sides: Side) -> Side:
    """Return several sides as one."""
    first = np.cumsum([0] + [len(side.x) for side in sides])
    facets = [side.facets + a for side, a in zip(sides, first, strict=False)]
    return Side(np.concatenate([side.x for side in sides]), np.concatenate(facets))


def ring(count: int) -> tuple[Side, Side]:
    """Return small triangles around a disc over the unit square, and a large one behind them."""
    angle, radius = 2 * np.pi * np.arange(count) / count, 0.3
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.column_stack([-out[:, 1], out[:, 0]]) * radius * np.tan(np.pi / count)
    corners = np.stack([radius * out + along, radius * out - along, 1.2 * radius * out], axis=1)
    x = np.column_stack([corners.reshape(-1, 2) + 0.5, np.full(3 * count, 0.1)])
    near = Side(x, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)).moved(
        np.diag([1, -1, 1]), (0, 1, 0)
    )
    far = triangles([[-3.0, -1.0], [4.0, -1.0], [0.5, 5.0]])
    return near, far.reversed().moved(shift=(0, 0, 0.5))


def triangles(points: npt.ArrayLike) -> Side:
    """Return the Delaunay triangulation of points (n, 2) in z = 0, the normal up."""
    points = np.asarray(points, dtype=float)
    facets = Delaunay(points).simplices.astype(np.int32)
    u, v = (points[facets[:, i]] - points[facets[:, 0]] for i in (1, 2))
    wrong = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0
    facets = np.where(wrong[:, None], facets[:, ::-1], facets)
    return Side(np.column_stack([points, np.zeros(len(points))]), facets)


def grid(
    x: npt.ArrayLike, y: npt.ArrayLike, jitter: float = 0.0, seed: int = 0, k: int = 4
) -> Side:
    """Return a grid in z = 0, the normal up; inner nodes are shifted in the plane."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, (len(x) - 2, len(y) - 2, 2))
    for i, h in enumerate((np.diff(x), np.diff(y))):
        room = np.minimum(h[1:], h[:-1])
        shift[..., i] *= jitter * (room[:, None] if i == 0 else room)
    points[1:-1, 1:-1] += shift
    points = np.concatenate([points, np.zeros((len(x), len(y), 1))], axis=2).reshape(-1, 3)
    n = len(y)
    first = (np.arange(len(x) - 1)[:, None] * n + np.arange(n - 1)).ravel()
    facets = first[:, None] + np.array([0, n, n + 1, 1])
    if k == 3:
        facets = np.concatenate([facets[:, [0, 1, 2]], facets[:, [0, 2, 3]]])
    return Side(points, facets.astype(np.int32))


def assemble(
    slave: Side, master: Side, *, pairs: Ints | None = None, normals=None, keep=None
) -> SimpleNamespace:
    """Assemble D (n_s, n_s) and M (n_s, n_m); all slave nodes are kept unless told otherwise.

    With them areas of facets, `covered` (m_s,) and `used` on the slave (m_m,); integrals of N over
    the covered part, `weights` and `master_weights`; and the points with their places x_s and x_m.
    """
    f_s, f_m = slave.geometry, master.geometry
    x_s, x_m = f_s.x, f_m.x
    n_s = np.zeros(x_s.shape) if normals is None else normals[slave.facets]
    if pairs is None:
        pairs = segments.find_candidates(f_s, n_s, f_m, np.zeros(len(x_s)))
    p = segments.create_segments(f_s, n_s, f_m, pairs)
    N_s = f_s.element.shape_functions(p.xi_s)
    N_m = f_m.element.shape_functions(p.xi_m)
    kept = np.ones(len(slave.x), dtype=bool) if keep is None else np.asarray(keep)
    Phi = p.weight[:, None] * duals.create_duals(N_s, p.weight, p.slave, kept[slave.facets]).Phi
    rows, columns = slave.facets[p.slave], master.facets[p.master]
    D, M = np.zeros((len(slave.x),) * 2), np.zeros((len(slave.x), len(master.x)))
    for i in range(Phi.shape[1]):
        for j in range(N_s.shape[1]):
            np.add.at(D, (rows[:, i], rows[:, j]), Phi[:, i] * N_s[:, j])
        for j in range(N_m.shape[1]):
            np.add.at(M, (rows[:, i], columns[:, j]), Phi[:, i] * N_m[:, j])
    weights, master_weights = np.zeros(len(slave.x)), np.zeros(len(master.x))
    np.add.at(weights, rows, p.weight[:, None] * N_s)
    np.add.at(master_weights, columns, p.weight[:, None] * N_m)
    return SimpleNamespace(
        D=D,
        M=M,
        covered=np.bincount(p.slave, p.weight, minlength=len(x_s)),
        used=np.bincount(p.master, p.weight, minlength=len(x_m)),
        weights=weights,
        master_weights=master_weights,
        points=p,
        x_s=np.einsum("qk,qki->qi", N_s, x_s[p.slave]),
        x_m=np.einsum("qk,qki->qi", N_m, x_m[p.master]),
    )
