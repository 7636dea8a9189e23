# SPDX-License-Identifier: MIT
"""Laws of users: errors name the mistake; valid laws are computed and written to files."""

from dataclasses import dataclass, make_dataclass
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import mesh
from tests.cases.pressed_blocks import rejected
from tests.cases.solid import create_displacement, create_tags

COMM = MPI.COMM_WORLD


@dataclass(frozen=True)
class Isotropic:
    """Von Mises plasticity with isotropic hardening, by its stress."""

    E: float
    nu: float
    Y: float  # uniaxial yield stress
    H: float  # its growth per plastic strain

    state: ClassVar = {"plastic_strain": (3, 3), "alpha": ()}
    linear: ClassVar = False
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @staticmethod
    def flow(strain, state, p):
        """Return the new plastic strain's growth and that of alpha."""
        mu = p.E / (2 * (1 + p.nu))
        s = 2 * mu * ufl.dev(strain - state["plastic_strain"])
        equivalent = ufl.sqrt(1.5 * ufl.inner(s, s) + (1e-14 * p.Y) ** 2)
        excess = equivalent - p.Y - p.H * state["alpha"]
        growth = ufl.conditional(ufl.gt(excess, 1e-10 * p.Y), excess / (3 * mu + p.H), 0.0)
        return 1.5 * growth / equivalent * s, growth

    @staticmethod
    def stress(strain, state, p):
        increment, _ = Isotropic.flow(strain, state, p)
        return dm.Elastic.elastic_stress(strain - state["plastic_strain"] - increment, p)

    @staticmethod
    def updated_state(strain, state, p):
        increment, growth = Isotropic.flow(strain, state, p)
        return {
            "plastic_strain": state["plastic_strain"] + increment,
            "alpha": state["alpha"] + growth,
        }

    @staticmethod
    def output(state, p):
        return {
            "yield stress": p.Y + p.H * state["alpha"],
            "pair": np.outer(state["alpha"], [1, 2]),
        }


def variant(**changes):
    """Return an Isotropic law with parts replaced, or missing if None."""
    names = ("state", "linear", "elastic_stress", "stress", "updated_state", "output")
    parts = {name: vars(Isotropic)[name] for name in names} | changes
    methods = {n: staticmethod(p) if callable(p) else p for n, p in parts.items() if p is not None}
    fields = [(name, float) for name in ("E", "nu", "Y", "H")]
    law = make_dataclass("Variant", fields, namespace=methods, frozen=True)
    return law(1000.0, 0.3, 1.0, 100.0)


@pytest.mark.parametrize(
    ("base", "said"),
    [
        (dm.Material, "no elastic_stress; add elastic_stress(strain, p), the stress of a small"),
        (dm.materials.PointwiseLaw, "no elastic_stress, no stress or energy; add elastic_str"),
    ],
)
def test_what_a_base_class_leaves_open_is_missing(base, said):
    """Not the NotImplementedError of what the base class declares."""
    own = {name: vars(Isotropic)[name] for name in ("stress", "updated_state")} | {"state": {}}
    own = {"linear": False} | (own if base is dm.Material else {})
    law = make_dataclass("Own", [("E", float), ("nu", float)], bases=(base,), namespace=own)
    for use in (create_solid, dm.materials.check):
        with rejected(f"Own has {said}"):
            use(law(1000.0, 0.3))


def create_solid(*laws):
    """Return a square with the laws in stripes."""
    domain = mesh.create_unit_square(COMM, 6, 6)
    tags = create_tags(domain, lambda x: x[:, 0] * len(laws)) if len(laws) > 1 else None
    return dm.Solid(create_displacement(domain), dict(enumerate(laws)) if tags else laws[0], tags)


def stretch(solid, size, most=1.0):
    solid.u.interpolate(lambda x: np.stack([size * np.minimum(x[0], most), 0 * x[1]]))
    solid.evaluate()


def same(e, s, p):
    return dict(s)


def fails(*arguments):
    raise ZeroDivisionError("a slip of the user's")


def e_of(e, *rest):
    return e


MISTAKES = [
    ({"state": None}, "has no state; declare its internal variables"),
    ({"elastic_stress": None}, "has no elastic_stress; add"),
    ({"stress": None}, "has no stress or energy; add energy(strain"),
    ({"state": ["alpha"]}, ": state is ['alpha']: give a dictionary"),
    ({"state": {"w": (2,)}}, ": state: the shape of 'w' is (2,)"),
    ({"state": {"stress": ()}}, ": state: a name is 'stress': choose"),
    (
        {"isotropic": True, "state": {"b": (3, 3)}},
        "isotropic is True, but state has the tensor 'b'",
    ),
    (
        {"updated_state": lambda e, s, p: {"plastic_strain": s["plastic_strain"]}},
        "updated_state returns the state plastic_strain, but",
    ),
    (
        {"updated_state": lambda e, s, p: dict(s) | {"beta": s["alpha"]}},
        "updated_state returns the state alpha, beta, plastic",
    ),
    ({"updated_state": lambda e, s, p: None}, "updated_state: the state is None: return"),
    (
        {"updated_state": lambda e, s, p: {"plastic_strain": s["alpha"], "alpha": s["alpha"]}},
        "updated_state: plastic_strain has the shape (); it must be (3, 3)",
    ),
    ({"stress": lambda e, s, p: ufl.tr(e)}, ".stress has the shape (); it must be (3, 3)"),
    ({"stress": None, "energy": e_of}, ".energy has the shape (3, 3); it must be ()"),
    ({"stress": lambda e, s, p: "s"}, ".stress is a str; it must be UFL"),
    ({"stress": fails}, ".stress raised ZeroDivisionError: a slip of the user's"),
    ({"stress": lambda self, e, s, p: e}, "static method, stress(strain, state, p)"),
    (
        {"output": lambda s, p: {"x": np.zeros(3)}},
        ".output: x has the shape (3,) at 0 integration points",
    ),
    ({"output": lambda s, p: {"alpha": s["alpha"]}}, "returns the name 'alpha'"),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("changes", "said"), MISTAKES)
def test_mistakes_are_named_at_construction(changes, said):
    with rejected("Variant", said):
        create_solid(variant(**changes))


@pytest.mark.mpi
def test_a_parameter_that_is_no_number_is_named():
    with rejected("Isotropic: the parameter Y is 'soft': give a number"):
        create_solid(Isotropic(1000.0, 0.3, "soft", 1.0))


@pytest.mark.mpi
def test_one_name_in_two_shapes_names_both_laws():
    other = variant(state={"alpha": (3, 3)}, updated_state=lambda e, s, p: {"alpha": s["alpha"]})
    with rejected("'alpha' has the shape () in Isotropic and (3, 3) i"):
        create_solid(Isotropic(1000.0, 0.3, 1.0, 1.0), other)


@pytest.mark.mpi
def test_an_internal_variable_may_be_a_number():
    """Independent of strain and place, it is known at all points nevertheless; also zero."""
    for number in (1.5, 0.0):

        def numbers(e, s, p, number=number):
            return {"plastic_strain": number * ufl.Identity(3), "alpha": number}

        solid = create_solid(variant(updated_state=numbers))
        solid.evaluate()
        assert (solid.fields.values("alpha") == number).all()
        expected = [number, number, number, 0]
        assert (solid.fields.values("plastic_strain") == expected).all()


@pytest.mark.mpi
def test_an_error_of_a_law_on_one_rank_is_raised_on_all():
    """Rank 0 fails while the law is built, or when it is asked for output; nobody waits."""
    last = COMM.size - 1

    def stress(e, s, p):
        return fails() if last == COMM.rank else e

    with pytest.raises(ValueError, match=r"Variant.stress raised ZeroDivisionError"):
        create_solid(variant(stress=stress))

    def output(s, p):
        bad = COMM.rank == last and len(s["alpha"]) > 0
        return {"a": np.full(len(s["alpha"]), np.nan if bad else 1.0)}

    solid = create_solid(variant(output=output))
    for ask in (solid.max, solid.cell_values, solid.fields.integral):
        with pytest.raises(ValueError, match=r"Variant.output: a is NaN in \d+ values"):
            ask("a")
    assert solid.max("alpha") == 0.0


@pytest.mark.mpi
def test_own_fields_are_listed_and_can_be_asked_for():
    """Internal variables and output of all laws, zero in bodies without them."""
    solid = create_solid(Isotropic(1000.0, 0.3, 1.0, 100.0), dm.Elastic(1000.0, 0.3))
    stretch(solid, 0.02)
    alpha = solid.max("alpha")
    assert alpha > 1e-3 and solid.max("yield stress") == pytest.approx(1.0 + 100.0 * alpha)
    assert np.allclose(solid.fields.values("pair")[..., 1], 2 * solid.fields.values("alpha"))
    problem = dm.ContactProblem(solid)
    fields = problem.output_fields()
    assert {"alpha", "yield stress", "pair", "plastic_strain", "stress"} <= set(fields)
    assert fields["pair"].ufl_shape == (2,)
    largest = COMM.allreduce(fields["alpha"].x.array.max(initial=0.0), op=MPI.MAX)
    assert largest == pytest.approx(alpha)
    assert "alpha_norm" not in solid.fields.names
    with pytest.raises(ValueError, match="no field 'alpha_norm'"):
        solid.max("alpha_norm")


def scalar_plasticity():
    """Return a law whose plastic strain is a scalar, not zero where it is stretched."""

    def update(strain, state, p):
        return {"plastic_strain": ufl.conditional(ufl.gt(strain[0, 0], 0.01), strain[0, 0], 0.0)}

    return variant(state={"plastic_strain": ()}, updated_state=update, stress=hooke, output=None)


def hooke(strain, state, p):
    return dm.Elastic.elastic_stress(strain, p)


METAL, OWN = dm.VonMises(1e3, 0.3, 1.0, 1e2), Isotropic(1e3, 0.3, 1.0, 1e2)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("laws", "share"),
    [
        ((scalar_plasticity(),), 0.5),
        ((OWN, dm.Elastic(1000.0, 0.3)), 0.5),
        ((METAL,) * 2 + (OWN,) * 4, 0.5),
        ((variant(output=lambda s, p: {"plastic": s["alpha"] + 1.0}, updated_state=same),), 1.0),
    ],
)
def test_the_plastic_area_is_that_of_every_law(laws, share):
    """Laws by their plastic strain, tensor or scalar; one that says itself what is plastic wins."""
    solid = create_solid(*laws)
    stretch(solid, 0.02, 0.5)
    assert solid.plastic_area() == pytest.approx(share, rel=1e-12)
    assert solid.max("plastic") == (share > 0)
    assert "plastic" in solid.output_fields()
