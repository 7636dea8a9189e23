# SPDX-License-Identifier: MIT
"""A kind of interface that a user writes: nodes against a rigid plane, without a master side."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.geometry.facets import tributary_weights
from dolfinx_mortar.interfaces.coupling import Coupling, normal_frames
from dolfinx_mortar.interfaces.interface import Interface, full_coverage
from dolfinx_mortar.mortar.surface import facets_at, sum_at_nodes
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks, rejected

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
E = 1000.0
BAR = dm.Elastic(E, 0.0)


class Plane(Interface):
    """Slave nodes stay on the side n.(x - p) >= 0 of a rigid plane."""

    unilateral = True

    def __init__(self, facet_tags, *, slave, point, normal):
        super().__init__(facet_tags, slave=slave)
        self.point, self.normal = np.array(point), np.array(normal) / np.linalg.norm(normal)

    def given(self):
        return super().given() | {"point": self.point, "normal": self.normal}

    def __repr__(self):
        """Name what tells it from others."""
        said = f"point={self.point.tolist()}, normal={self.normal.tolist()}"
        return f"{super().__repr__()[:-1]}, {said})"

    def couple(self, sides, pairing, pattern, banned, u):
        slave, nodes = sides.slave, sides.nodes
        d = len(self.normal)
        areas = tributary_weights(facets_at(slave, slave.X))
        areas = sum_at_nodes(slave, areas[:, :, None])[: slave.owned, 0]
        fixed = sides.fixed[nodes]
        kept = ~banned[nodes] & (np.linalg.norm(self.normal * ~fixed, axis=1) > 0.1)
        normals = np.where(kept[:, None], -self.normal, 0.0)  # outward, of the body
        R, slot, directions = normal_frames(normals, kept, fixed)
        return Coupling(
            blocks=np.zeros((0, d, d)),
            P=np.zeros((0, 1)),
            R=R,
            slot=slot,
            directions=directions,
            kept=kept[:, None],
            weight=(areas * kept)[:, None],
            normals=normals,
            heights=kept * (self.normal @ self.point),  # gap n.(x - p) = -n_j.x - h_j
            coverage=full_coverage(sides),
        )


class Pressed(PressedBlocks):
    """Two tied blocks, turned by an angle, between a plane and a moved top."""

    def __init__(self, angle=0.0, law=BAR, **options):
        super().__init__(angle=angle, jitter=0.2, **options)
        c, s = np.cos(angle), np.sin(angle)
        self.turned = np.array([[c, -s], [s, c]])
        x0 = self.V.tabulate_dof_coordinates()[:, :2] @ self.turned  # before they were turned
        lowest = COMM.allreduce(x0[:, 1].min(initial=np.inf), op=MPI.MIN)
        self.plane = Plane(
            self.facets, slave=BOTTOM, point=self.turned @ [0.0, lowest], normal=self.turned[:, 1]
        )
        self.law = law

    def problem(self, interfaces=None, *, held=False, **options):
        interfaces = [self.plane, self.tie()] if interfaces is None else interfaces
        bcs = [self.bc(TOP, self.top)]
        if held:  # all nodes on the plane
            bcs.append(self.roller(BOTTOM, 0))
        return super().problem(interfaces, bcs=bcs, law=self.law, **options)

    def press(self, depth, along=0.0):
        self.top.value = self.turned @ [along, -depth]


@pytest.mark.parametrize(
    ("angle", "geometry", "held"), [(0.4, "reference", False), (0.4, "updated", True)]
)
def test_uniform_pressure(angle, geometry, held):
    """A bar of two blocks of height 1, no Poisson's ratio: p = E depth / 2 everywhere."""
    case, depth = Pressed(angle), 0.02
    problem = case.problem(geometry=geometry, held=held)
    case.press(depth)
    report = dm.newton(problem)
    p = E * depth / 2.0
    assert problem.contacts == [case.plane]
    for interface in problem.interfaces:
        on = interface.active.x.array > 0.0
        assert interface.pressure.x.array[on] == pytest.approx(p, rel=1e-9)
    force = case.plane.force @ case.turned
    assert force == pytest.approx([0.0, p], abs=1e-10)
    assert case.plane.master_force == pytest.approx(-case.plane.force, abs=1e-12)
    for support in (TOP, None):
        found = dm.reaction(problem, support, facet_tags=case.facets).force
        assert found == pytest.approx(-case.plane.force, abs=1e-9)
    certificate = report.certificate
    assert max(certificate.gap, certificate.sign, certificate.complementarity) < 1e-12
    assert certificate.force_balance < 1e-10 and certificate.linear_field_error < 1e-12
    audit = str(problem.audit())
    assert repr(case.plane) in audit and "0 master facets" in audit


class Lifted(Plane):
    """A plane that a force along its normal lifts: what `driven` promises, it is itself."""

    names, load, holds = ("lift",), 0.0, False

    def driven(self):
        return self

    def loads(self):
        return np.array([self.load])

    def motions(self, x, X, moved):
        return np.broadcast_to(self.normal, (1, *x.shape))

    def move(self, amounts):
        self.point = self.point + amounts[0] * self.normal

    def state(self, ended):
        return {"point": self.point}

    def restore(self, state):
        self.point = state["point"]


@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_a_force_may_drive_it(geometry):
    """It moves by 2 F / E, as two bars of height and width 1 shorten, and carries F."""
    case, force = Pressed(0.4), 10.0
    plane = Lifted(case.facets, slave=BOTTOM, point=case.plane.point, normal=case.plane.normal)
    problem = case.problem([plane, case.tie()], geometry=geometry)
    case.press(0.0)
    plane.load = force
    dm.newton(problem)
    way = (plane.point - case.plane.point) @ plane.normal
    assert way == pytest.approx(2.0 * force / E, rel=1e-7)
    assert plane.force @ plane.normal == pytest.approx(force, rel=1e-9)
    plane.load = -force
    with rejected("nothing resists", "'lift' = -10", error=dm.NewtonNotConverged):
        dm.newton(problem)


SPOILT = [  # method, what it returns instead or raises, words of the message
    ("couple", lambda c: replace(c, heights=c.heights + np.nan), ("heights", "NaN")),
    ("couple", lambda c: replace(c, heights=np.zeros(99)), ("heights", "(99,)", "must be")),
    ("couple", lambda c: replace(c, R=0.0 * c.R), ("R without inverse", "independent columns")),
    ("couple", lambda c: None, ("returns a NoneType", "Coupling")),
    ("constraints", lambda c: replace(c, dofs=c.dofs + 10**6), ("no unknowns", "each once")),
    ("constraints", lambda c: replace(c, weight=-c.weight), ("a weight that is not positive",)),
    ("pair", KeyError("no partners"), ("no partners",)),
    ("check", KeyError("no space"), ("no space",)),
    ("state", lambda z: None, ("returns a NoneType: return a dict",)),
]


def spoilt(method, how, on):
    """Return a kind of plane with a method that goes wrong on one rank alone."""

    def wrong(self, *arguments, **options):
        found = getattr(Plane, method)(self, *arguments, **options)
        if COMM.rank != on:
            return found
        if isinstance(how, Exception):
            raise how
        return how(found)

    return type("Spoilt", (Plane,), {method: wrong})


@pytest.mark.parametrize(("method", "how", "words"), SPOILT)
def test_what_goes_wrong_on_one_rank_is_an_error_on_all(method, how, words, folder):
    path, case = folder / "state.h5", Pressed()
    nodes = fem.locate_dofs_topological(case.V, 1, case.facets.find(BOTTOM))
    owns = (nodes < case.V.dofmap.index_map.size_local).any()
    last = COMM.allreduce(COMM.rank if owns else -1, op=MPI.MAX)
    own = {"slave": BOTTOM, "point": case.plane.point, "normal": case.plane.normal}
    plane = spoilt(method, how, last)(case.facets, **own)
    who = () if method == "check" else (f"Spoilt(slave={BOTTOM}", f"{method}()")
    raised = isinstance(how, Exception)
    with rejected(*who, *words, error=(KeyError, RuntimeError) if raised else ValueError):
        problem = case.problem(interfaces=[plane, case.tie()])
        case.press(0.01)
        dm.newton(problem)
        problem.save(path)
