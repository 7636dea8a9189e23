# SPDX-License-Identifier: MIT
"""Three indenters: shape, mesh of the indented block, and formulas from theory.

Lengths are in micrometres; each tool is pressed in by DEPTH.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh

DEPTH = 1.0
TOP, FOLD = 1, 2  # facet tags: the indented side, and the inclined symmetry plane
Floats = np.ndarray
Mesh = tuple[mesh.Mesh, mesh.MeshTags]


class Tool(ABC):
    """An indenter of revolution in the half section of a block; other tools override methods."""

    kinematics: Mapping[str, str] = MappingProxyType({"kinematics": "axisymmetric"})
    share = 1  # the whole body over the meshed part
    epsilon = 0.75  # of Oliver and Pharr, for paraboloids and, by experience, for pyramids
    recovery = 0.08  # about the distance over which the tool is withdrawn until contact is lost
    power = 1.0  # depths of loading are DEPTH (k / n)^power
    sparse = 1  # the number of steps is divided by this
    zones: tuple[tuple[float, float], ...] = ((4.0, 1.0), (115.0, 1.2))  # mesh: up to, growth
    shape: dm.shapes.Shape

    def block(self, h: float) -> Mesh:
        """Return a mesh of z <= 0, refined at the tip, with its top side tagged."""
        x = graded(h, *self.zones)
        n = len(x) - 1
        domain = mesh.create_rectangle(
            MPI.COMM_WORLD, [[0, 0], [n, n]], [n, n], mesh.CellType.quadrilateral
        )
        r, z = domain.geometry.x[:, 0], domain.geometry.x[:, 1]
        r[:] = x[np.rint(r).astype(int)]
        z[:] = -x[n - np.rint(z).astype(int)]
        return domain, tagged(domain, {TOP: lambda p: np.isclose(p[1], 0.0)})

    def supports(self, V: fem.FunctionSpace) -> list[fem.DirichletBC]:
        """Return u_r = 0 on the axis and u_z = 0 at the bottom."""
        low = lowest(V.mesh, 1)
        return [
            support(V, 0, lambda x: np.isclose(x[0], 0.0)),
            support(V, 1, lambda x: np.isclose(x[1], low)),
        ]

    def potential(self, _u: fem.Function, _facets: mesh.MeshTags, _E: float) -> ufl.Form | None:
        """Return a potential for supports that no component describes, or None."""
        return None

    def touched(self, nodes: Mapping[str, Floats]) -> float:
        """Return the area of contact, up to the radius that `edge` returns."""
        return float(np.pi * edge(nodes) ** 2)

    @abstractmethod
    def area(self, depth: float) -> float:
        """Return the area of the tool's section at a height over its tip."""

    @abstractmethod
    def beta(self, nu: float) -> float:
        """Return the slope of unloading over that of a flat punch of the same area."""

    @abstractmethod
    def elastic(self, depth: float, modulus: float, nu: float) -> float:
        """Return the force on an elastic half-space of a reduced modulus."""


class Cone(Tool):
    """A cone that displaces the volume of Berkovich's pyramid, with a tip radius of 0.05."""

    angle = 70.3
    shape = dm.shapes.Cone((0.0, 0.0), angle, (0.0, 1.0), radius=0.05)

    def area(self, depth: float) -> float:
        """Return pi (h tan a)^2."""
        return float(np.pi * (depth * np.tan(np.radians(self.angle))) ** 2)

    def beta(self, nu: float) -> float:
        """Return the factor of Hay, Bolshakov and Pharr (1999) for angles over 60 degrees."""
        q = (1.0 - 2.0 * nu) / (4.0 * (1.0 - nu)) / np.tan(np.radians(self.angle))
        return float(np.pi * (np.pi / 4 + 0.15483073 * q) / (np.pi / 2 - 0.83119312 * q) ** 2)

    def elastic(self, depth: float, modulus: float, nu: float) -> float:
        """Return Sneddon's 2/pi E_r tan(a) h^2 with that factor."""
        force = 2.0 / np.pi * modulus * np.tan(np.radians(self.angle)) * depth**2
        return float(self.beta(nu) * force)


class Ball(Tool):
    """A ball. Elements grow by 6 % each: small contacts have as many nodes as large ones."""

    radius = 40.0
    recovery = 0.3
    power = 2.0
    zones = ((1.0, 1.0), (13.0, 1.06), (380.0, 1.25))
    shape = dm.shapes.Sphere((0.0, radius), radius)

    def block(self, h: float) -> Mesh:
        """Return a mesh that is half as large as h at the axis."""
        return super().block(0.5 * h)

    def area(self, depth: float) -> float:
        """Return pi (2 R h - h^2)."""
        return float(np.pi * (2.0 * self.radius - depth) * depth)

    def beta(self, nu: float) -> float:
        """Return 1: the impression is nearly as round as the ball."""
        return 1.0

    def elastic(self, depth: float, modulus: float, nu: float) -> float:
        """Return Hertz' 4/3 E_r sqrt(R h^3)."""
        return float(4.0 / 3.0 * modulus * np.sqrt(self.radius * depth**3))

    def cavity(self, area: float, E: float, nu: float, strength: float) -> float:
        """Return the mean pressure of Johnson's cavity (1970) for an area of contact."""
        x = E / strength * np.sqrt(area / np.pi) / self.radius
        return float(2.0 / 3.0 * strength * (2.0 + np.log((x + 4.0 - 8.0 * nu) / (6.0 - 6.0 * nu))))


class Berkovich(Tool):
    """Berkovich's pyramid: a sixth of it, between the middle of a face and an edge.

    The block's section is a rhombus with an angle of 60 degrees, x = s (1, 0) + t (1/2, sqrt(3)/2).
    """

    kinematics: Mapping[str, str] = MappingProxyType({})
    share = 6
    sparse = 4
    zones = ((5.5, 1.0), (60.0, 1.7))
    narrow = ((3.0, 1.0), (60.0, 1.7))  # across the edge, and down
    shape = dm.shapes.berkovich((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), turned=30.0)

    def block(self, h: float) -> Mesh:
        """Return a mesh of the sixth, 3.6 times as coarse as a half section."""
        s, t, z = (graded(3.6 * h, *zones) for zones in (self.narrow, self.zones, self.narrow))
        n = [len(x) - 1 for x in (s, t, z)]
        domain = mesh.create_box(
            MPI.COMM_WORLD, [[0, 0, 0], n], n, cell_type=mesh.CellType.hexahedron
        )
        at = np.rint(domain.geometry.x).astype(int).T
        skew = t[at[1]]
        domain.geometry.x[:] = np.column_stack(
            [s[at[0]] + 0.5 * skew, np.sqrt(0.75) * skew, -z[n[2] - at[2]]]
        )
        sides = {TOP: lambda p: np.isclose(p[2], 0.0), FOLD: lambda p: on_fold(p)}
        return domain, tagged(domain, sides)

    def supports(self, V: fem.FunctionSpace) -> list[fem.DirichletBC]:
        """Return u_y = 0 on y = 0, u_x = 0 on the axis, and u_z = 0 at the bottom."""
        low = lowest(V.mesh, 2)
        return [
            support(V, 0, lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 0.0)),
            support(V, 1, lambda x: np.isclose(x[1], 0.0)),
            support(V, 2, lambda x: np.isclose(x[2], low)),
        ]

    def potential(self, u: fem.Function, facets: mesh.MeshTags, E: float) -> ufl.Form | None:
        """Return stiff springs normal to the inclined symmetry plane.

        No component of the displacement is normal to it. The elastic force is that of a rigid plane
        to 2e-4; with a tenth of this stiffness to 2e-3.
        """
        across = ufl.as_vector((-np.sqrt(0.75), 0.5, 0.0))
        ds = ufl.Measure("ds", u.function_space.mesh, subdomain_data=facets)
        return 0.5 * 1000.0 * E / DEPTH * ufl.dot(u, across) ** 2 * ds(FOLD)

    def touched(self, nodes: Mapping[str, Floats]) -> float:
        """Return the area of contact: a node has a quarter of each cell around it."""
        order, (n, m) = grid(nodes["X"])
        x = nodes["x"][order, :2].T.reshape(2, n, m)
        on = nodes["pressure"][order].reshape(n, m) > 0.0
        a, b = x[:, 1:, 1:] - x[:, :-1, :-1], x[:, :-1, 1:] - x[:, 1:, :-1]  # diagonals
        cells = 0.5 * np.abs(a[0] * b[1] - a[1] * b[0])
        corners = sum(on[i : n - 1 + i, j : m - 1 + j] for i in (0, 1) for j in (0, 1))
        return float(self.share * (0.25 * cells * corners).sum())

    def area(self, depth: float) -> float:
        """Return 3 sqrt(3) (h tan 65.27)^2 = 24.5 h^2."""
        return float(3.0**1.5 * (depth * np.tan(np.radians(65.27))) ** 2)

    def beta(self, nu: float) -> float:
        """Return King's 1.034 for a flat punch of this section; others give 1.023 to 1.062."""
        return 1.034

    def elastic(self, depth: float, modulus: float, nu: float) -> float:
        """Return Larsson's fit of computations (1996)."""
        fit = 2.1891 * (1.0 - 0.21 * nu - 0.01 * nu**2 - 0.41 * nu**3)
        return fit * modulus * depth**2


TOOLS: dict[str, Callable[[], Tool]] = {"cone": Cone, "ball": Ball, "berkovich": Berkovich}


def graded(h: float, *zones: tuple[float, float]) -> Floats:
    """Return positions from 0 on whose distances begin with h and grow in zones (end, factor)."""
    x, step = [0.0], h
    for end, growth in zones:
        while x[-1] + 0.5 * step < end:
            step *= growth
            x.append(x[-1] + step)
    return np.array(x)


def grid(X: Floats) -> tuple[Floats, tuple[int, int]]:
    """Return the order of the rhombus' nodes along s, then t, and how many there are."""
    t = np.round(X[:, 1] / np.sqrt(0.75), 9)
    s = np.round(X[:, 0] - 0.5 * t, 9)
    return np.lexsort([t, s]), (len(np.unique(s)), len(np.unique(t)))


def on_fold(x: Floats) -> Floats:
    """Say which points lie on the plane through an edge of the pyramid, at 60 degrees."""
    return np.isclose(x[1], np.sqrt(3.0) * x[0])


def tagged(domain: mesh.Mesh, sides: dict[int, Callable[[Floats], Floats]]) -> mesh.MeshTags:
    """Return facet tags of sides."""
    d = domain.topology.dim - 1
    found = {tag: mesh.locate_entities_boundary(domain, d, side) for tag, side in sides.items()}
    facets = np.concatenate(list(found.values()))
    tags = np.repeat(list(found), [len(f) for f in found.values()]).astype(np.int32)
    order = np.argsort(facets)
    return mesh.meshtags(domain, d, facets[order], tags[order])


def lowest(domain: mesh.Mesh, axis: int) -> float:
    """Return the lowest coordinate of all ranks."""
    return float(domain.comm.allreduce(domain.geometry.x[:, axis].min(), op=MPI.MIN))


def support(
    V: fem.FunctionSpace, component: int, where: Callable[[Floats], Floats]
) -> fem.DirichletBC:
    """Hold a component."""
    W = V.sub(component)
    dofs = fem.locate_dofs_geometrical((W, W.collapse()[0]), where)[0]
    return fem.dirichletbc(fem.Constant(V.mesh, 0.0), dofs, W)


def edge(nodes: Mapping[str, Floats]) -> float:
    """Return the contact radius: the zero of the gap, extrapolated from the next two nodes.

    It is limited to the interval from the last node in contact to the next node.
    """
    order = np.argsort(nodes["x"][:, 0])
    r, gap = nodes["x"][order, 0], nodes["gap"][order]
    on = np.flatnonzero(nodes["pressure"][order] > 0.0)
    if on.size == 0:
        return 0.0
    last, a, b = on[-1] + np.arange(3)
    slope = (gap[b] - gap[a]) / (r[b] - r[a])
    return float(np.clip(r[a] - gap[a] / max(slope, 1e-300), r[last], r[a]))
