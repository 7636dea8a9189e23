# SPDX-License-Identifier: MIT
"""The exact tangent of an interface far from balance, beside differences of what Newton uses."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from unittest.mock import patch

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.geometry import area
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar import common_normals, curvature_correction, integrals


def wavy(X, phase):
    """Return vectors (n, d) at points, the same on all ranks."""
    a, b = (np.sin(X @ k[: X.shape[1]] + phase + i) for i, k in enumerate(([9, 7, 5], [5, 9, 8])))
    return np.stack([a, b, a * b], axis=1)[:, : X.shape[1]]


def rotations(old, new):
    """Return the rotations (n, d, d) without spin from unit vectors to others."""
    both, cosine = old + new, (old * new).sum(axis=1)[:, None, None]
    R = np.eye(old.shape[1]) - both[:, :, None] * both[:, None] / (1.0 + cosine)
    return R + 2.0 * new[:, :, None] * old[:, None]


@contextmanager
def held() -> Iterator[None]:
    """Hold what the tangent leaves out on purpose as it is at the first call."""
    first, sides = {}, cycle(("slave", "master"))
    mean, of_side = common_normals._mean, common_normals._of_side

    def once(module, name):
        f = getattr(module, name)

        def found(surface, *rest):
            if (name, id(surface)) not in first:
                first[name, id(surface)] = f(surface, *rest)
            return first[name, id(surface)]

        return patch.object(module, name, found)

    def turned_mean(*given):
        if np.iscomplexobj(given[0]):  # a complex step
            return mean(*given)
        at = first.setdefault("mean", given)
        R = [rotations(*vectors) for vectors in zip(at[:2], given[:2], strict=True)]
        return mean(*given[:2], *(r @ S @ r.swapaxes(1, 2) for r, S in zip(R, at[2:], strict=True)))

    def turned_side(averaged, *rest):
        old, a = first.setdefault(next(sides), (averaged.copy(), of_side(averaged, *rest)))
        return (rotations(old, averaged) @ a[:, :, None])[:, :, 0]

    with (
        once(integrals, "_reaches"),
        once(curvature_correction, "thickness_stretches"),
        patch.object(common_normals, "_mean", turned_mean),
        patch.object(common_normals, "_of_side", turned_side),
    ):
        yield


@contextmanager
def accurate() -> Iterator[None]:
    """Integrate in space with many points: derivatives are those of integrals, by fewer points."""
    with (
        patch.object(area, "least_degree", lambda slave, master: 16),
        patch.object(area, "degree_of_moments", lambda slave, master, smooth: 16),
    ):
        yield


class Differences:
    """Forces, weighted gaps and slips of an interface as functions of u, at given tractions."""

    def __init__(
        self,
        V,
        interface,
        noise=0.03,
        *,
        fixed=None,
        weight=None,
        slid=0.0,
        loaded=np.inf,
    ):
        """Move the surfaces in waves; partners are those of other waves."""
        self.V, self.d, self.comm, self.loaded = V, V.dofmap.index_map_bs, V.mesh.comm, loaded
        self.X = X = V.tabulate_dof_coordinates()[:, : self.d]
        free = np.ones(X.shape, dtype=bool) if fixed is None else ~fixed(X)
        interface.take(self, V)
        interface.check(V, weight is not None, "small")
        self.system, self.u = InterfaceSystem(V, [interface], ~free, weight), fem.Function(V)
        self.start, self.du = noise * wavy(X, 0.0) * free, wavy(X, 2.0) * free
        self.before = self.start - 0.3 * noise * wavy(X, 4.0) * free
        self.before[X[:, -1] > 0.005, 0] -= slid
        self.u.x.array[:] = self.before.ravel()
        x = self._vector(X + self.before)
        self.system.enter(self.system.at(self.u))
        (self.partners,) = (link.partners(x, frozen=False) for link in self.system.links)

    def _vector(self, values):
        size = self.d * self.V.dofmap.index_map.size_local
        vector = PETSc.Vec().createMPI((size, None), bsize=self.d, comm=self.V.mesh.comm)
        vector.array[:] = values.ravel()[:size]
        return vector

    def _at(self, u):
        self.u.x.array[:] = u.ravel()
        self.system.follow(self.u)
        (self.link,) = self.system.unilateral
        return self.link, self.link.coupling

    def _tangents(self, coupling):
        """Return tangents that turn without spin, but stay normal to prescribed axes."""
        held = (self.old.slot >= 0).any(axis=1) & self.old.kept[:, 0]
        R = rotations(self.old.normals, coupling.normals)
        free = self.old.rows[:, 1:] @ R.swapaxes(1, 2)
        return np.where(held[:, None, None], coupling.rows[:, 1:], free)

    def _values(self, u):
        link, coupling = self._at(u)
        t = self._tangents(coupling)
        traction = self.normal[link.nodes, None] * coupling.normals
        traction += np.einsum("nk,nki->ni", self.along, t)
        forces = np.add(*link.transpose(coupling.weight[:, :1] * traction))
        gaps = coupling.weight[:, 0] * link.gaps(self._vector(self.X + u))
        if self.partners is None:
            return forces, gaps[self.on]
        motion = self.partners.motion(link, self._vector(u - self.before))
        known = self.partners.known[:, None]
        slips = np.where(known, (t @ motion[:, :, None])[:, :, 0], 0.0)
        return forces, gaps[self.on], slips[self.slides]

    def derivatives(self):
        """Return those of forces, gaps, slips and their rows along du as the tangent has them."""
        link, self.old = self._at(self.start)
        own, du = self.X[: self.V.dofmap.index_map.size_local], self._vector(self.du)
        x, across = own[link.nodes, 0], self.old.directions[:, 1:]
        self.on = self.old.kept[:, 0] & (x < self.loaded + 0.3)
        self.slides = across & self.on[:, None]
        self.normal = (0.75 + 0.25 * wavy(own, 1.0)[:, 0]) * (own[:, 0] < self.loaded)
        self.along = wavy(own, 3.0)[link.nodes, 1:] * across * (x < self.loaded)[:, None]
        tangential, slips = None, (du, ())
        if self.partners is not None:
            tangential = np.zeros(own.shape)
            given = np.einsum("nk,nki->ni", self.along, self.old.rows[:, 1:])
            given += self.normal[link.nodes, None] * self.old.normals  # which has no part in it
            tangential[link.nodes] = given
            slips = self._vector(self.start - self.before), [self.partners]
        found = self.system.linearise_geometry(self.u, self.normal, tangential, slips)
        forces = (found.forces[0] * du).array_r.reshape(-1, self.d)
        closing = found.closing(du).reshape(-1, self.d)[link.nodes]
        results = forces, -(closing[:, 0] * self.old.weight[:, 0])[self.on]
        if self.partners is None:
            return results
        return *results, closing[:, 1:][self.slides]

    def errors(self, hold=held, h=1e-5):
        """Return those of the derivatives, over the largest entries."""
        with hold():
            found = self.derivatives()
            self.seen = self._features()
            ends = [self._values(self.start + way * h * self.du) for way in (2, 1, -1, -2)]
        errors = []
        for one, (far, near, back, further) in zip(found, zip(*ends, strict=True), strict=True):
            expected = (8.0 * (near - back) - (far - further)) / (12.0 * h)
            both = (np.nan_to_num(np.abs(v), nan=np.inf) for v in (one - expected, expected))
            most = [v.max(initial=0.0) for v in both]
            error, size = (self.comm.allreduce(v, op=MPI.MAX) for v in most)
            errors.append(error / (size or 1.0))
        return errors

    def _features(self):
        """Return what the case contains; collective."""
        link = self.link
        found = {
            "partly": not self.on.all(),
            "held": ((self.old.slot >= 0).any(axis=1) & self.on).any(),
            "smooth": link.pattern.smooth is not None,
            "lost": self.partners is not None and self.on[~self.partners.known].any(),
        }
        if (operators := self.old.operators) is not None:
            found["step"] = operators.segments.reach is not None
        if (spreads := link.sides.spreads) is not None:
            S = spreads.at(self.u)[np.searchsorted(spreads.nodes, link.nodes)]
            found["edges"] = (common_normals._edged(S, np.sin(np.radians(20)) ** 2) & self.on).any()
        return {name for name, here in found.items() if self.comm.allreduce(bool(here), op=MPI.LOR)}
