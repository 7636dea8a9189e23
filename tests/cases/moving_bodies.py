# SPDX-License-Identifier: MIT
"""Bodies in motion: a bar that vibrates, two blocks that meet, and a rod that hits a wall."""

import numpy as np

import dolfinx_mortar as dm
import ufl
from tests.cases.meshes import LOWER, UPPER
from tests.cases.solid import COMM, create_displacement, hold, plane, rectangle, tag_facets
from tests.cases.two_bodies import TwoBodies, held


class Bar:
    """A bar of the length 1, E = rho = 1, clamped at x = 0, without Poisson's ratio."""

    def __init__(self, n=8, **options):
        self.mesh = rectangle([(0.0, 0.0), (1.0, 0.1)], (n, 1))
        self.u = create_displacement(self.mesh)
        self.V = self.u.function_space
        self.u.interpolate(self.mode)
        self.solid = dm.Solid(self.u, dm.Elastic(1.0, 0.0))
        self.inertia = dm.Inertia(self.solid, 1.0, **options)
        self.bcs = [hold(self.V, lambda x: np.isfinite(x[0]), 1), hold(self.V, plane(0), 0)]
        # of linear elements with the consistent mass, of which the mode is exact at the nodes
        k, h = np.pi / 2.0, 1.0 / n
        self.frequency = np.sqrt(6.0 * (1.0 - np.cos(k * h)) / (2.0 + np.cos(k * h))) / h

    @staticmethod
    def mode(x):
        return np.stack([1e-3 * np.sin(0.5 * np.pi * x[0]), np.zeros(x.shape[1])])

    def problem(self, *terms):
        return dm.ContactProblem(self.solid, bcs=self.bcs, terms=[self.inertia, *terms])

    def tip(self):
        x = self.V.tabulate_dof_coordinates()
        end = np.isclose(x[:, 0], 1.0)
        own = self.u.x.array[::2][end]
        size = own[np.argmax(np.abs(own))] if own.size else 0.0
        return max(COMM.allgather(float(size)), key=abs) / 1e-3


class Blocks:
    """Two blocks, the upper one above the lower one, that may meet."""

    def __init__(
        self,
        n_lower=(2, 2),
        n_upper=(3, 3),
        *,
        law=None,
        density=1.0,
        velocity=None,
        gravity=0.0,
        clamped=True,
        guided=False,
        friction=None,
        damping=0.0,
        strain="small",
        geometry="updated",
        **options,
    ):
        sizes = {"cell": "quadrilateral", "n_lower": n_lower, "n_upper": n_upper}
        bodies = TwoBodies(**sizes | options)
        self.mesh, self.cells, self.facets = bodies.mesh, bodies.cells, bodies.facets
        self.u, self.loads, V = bodies.u, None, bodies.V
        self.solid = dm.Solid(self.u, law or dm.Elastic(1000.0, 0.3), strain=strain)
        self.inertia = dm.Inertia(self.solid, density, self.cells, velocity=velocity)
        self.contact = bodies.interface(swap=True, friction=friction)
        self.bcs = [held(V, self.cells, LOWER)] if clamped else []
        if guided:
            self.bcs += [held(V, self.cells, body, 0.0, 0) for body in (LOWER, UPPER)]
        if gravity:
            weight = ufl.Measure("dx", self.mesh, subdomain_data=self.cells)(UPPER)
            self.loads = -density * gravity * ufl.TestFunction(V)[1] * weight
        dampings = [dm.Damping(self.inertia, stiffness=damping)] if damping else []
        given = {"loads": self.loads, "terms": [self.inertia, *dampings], "geometry": geometry}
        self.problem = bodies.problem([self.contact], self.bcs, self.solid, **given)


def meeting(
    corner, cells, shape, *, side=None, angle=0.0, velocity=None, damping=0.0, loads=None, **given
):
    """Return a problem of a free block from the origin, a tool that one side may meet, its inertia.

    Its cells are turned by an angle; other options are those of the solid, or of the tool.
    """
    domain = rectangle([(0.0, 0.0), corner], cells)
    tags = tag_facets(domain, side or plane(1))
    c, s = np.cos(angle), np.sin(angle)
    domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ np.array([[c, s], [-s, c]])
    law, strain = given.pop("law", None), given.pop("strain", "small")
    solid = dm.Solid(create_displacement(domain), law or dm.NeoHooke(1000.0, 0.3), strain=strain)
    inertia = dm.Inertia(solid, 1.0, velocity=velocity)
    tool = dm.Obstacle(tags, slave=1, shape=shape, **given)
    terms = [inertia, *([dm.Damping(inertia, stiffness=damping)] if damping else [])]
    loads = loads and loads * ufl.TestFunction(solid.V)[1] * ufl.dx
    return dm.ContactProblem(solid, [tool], loads=loads, terms=terms), tool, inertia


class Rod(Blocks):
    """A rod on a rigid wall: case VM265 of the verification manual of Ansys.

    Length 10, section 1, E = 3e7, density .73e-3, velocity 202.2, gap .01, in inches, pounds,
    seconds. The wave goes up and down once while it touches, and the wall exerts sqrt(E rho) v A.
    """

    E, density, velocity, length, gap = 3e7, 0.73e-3, 202.2, 10.0, 0.01
    touches, leaves, force = 4.946e-5, 1.4811e-4, 29923.0

    def __init__(self, n=100, **options):
        super().__init__(
            (1, 1),
            (1, n),
            heights=(1.0, self.length),
            gap=self.gap,
            law=dm.Elastic(self.E, 0.0),
            density=self.density,
            velocity={UPPER: (0.0, -self.velocity), LOWER: (0.0, 0.0)},
            guided=True,
            **options,
        )
        self.mass = self.density * self.length
        self.wave = np.sqrt(self.E / self.density)
        self.h = self.length / n
