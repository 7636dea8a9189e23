# SPDX-License-Identifier: MIT
"""Laws of users: errors name the mistake; valid laws are computed and written to files."""

import re
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh

COMM = MPI.COMM_WORLD
GUIDE = (Path(__file__).parent.parent / "docs" / "guide" / "materials.md").read_text()


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
        (
            dm.Material,
            "has no elastic_stress; add elastic_stress(strain, p), the stress of a small",
        ),
        (dm.materials.PointwiseLaw, "has no elastic_stress, no stress or energy; add elastic_str"),
    ],
)
def test_what_a_base_class_leaves_open_is_missing(base, said):
    """Not the NotImplementedError of what the base class declares."""
    methods = {name: vars(Isotropic)[name] for name in ("stress", "updated_state")}
    own = methods | {"state": {}} if base is dm.Material else {}
    fields = [("E", float), ("nu", float)]
    law = make_dataclass("Own", fields, bases=(base,), namespace={"linear": False, **own})
    for use in (create_solid, dm.materials.check):
        with pytest.raises(ValueError, match=re.escape(f"Own {said}")):
            use(law(1000.0, 0.3))


def create_solid(*laws):
    """Return a square with the laws in stripes."""
    domain = mesh.create_unit_square(COMM, 6, 6)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    if len(laws) == 1:
        return dm.Solid(u, laws[0])
    cells = domain.topology.index_map(2)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    x = mesh.compute_midpoints(domain, 2, every)[:, 0]
    tags = mesh.meshtags(domain, 2, every, (x * len(laws)).astype(np.int32))
    return dm.Solid(u, dict(enumerate(laws)), tags)


def forgets_alpha(e, s, p):
    return {"plastic_strain": s["plastic_strain"]}


def same(e, s, p):
    return dict(s)


def one_too_many(e, s, p):
    return dict(s) | {"beta": s["alpha"]}


def fails(*arguments):
    raise ZeroDivisionError("a slip of the user's")


MISTAKES = {
    "no state": ({"state": None}, r"Variant has no state; declare its internal variables"),
    "no linear": ({"linear": None}, r"Variant has no linear; declare linear: ClassVar = False"),
    "no elastic stress": ({"elastic_stress": None}, r"Variant has no elastic_stress; add"),
    "no stress": ({"stress": None}, r"Variant has no stress or energy; add energy\(strain"),
    "no update": ({"updated_state": None}, r"Variant has no updated_state; add"),
    "state is a list": ({"state": ["alpha"]}, r"Variant: state is \['alpha'\]: give a dictionary"),
    "state shape": ({"state": {"w": (2,)}}, r"Variant: state: the shape of 'w' is \(2,\)"),
    "state hides": ({"state": {"stress": ()}}, r"Variant: state: a name is 'stress': choose"),
    "state hides gap": ({"state": {"gap": ()}}, r"Variant: state: a name is 'gap': choose"),
    "forgotten": (
        {"updated_state": forgets_alpha},
        r"updated_state returns the state plastic_strain, but",
    ),
    "unknown": (
        {"updated_state": one_too_many},
        r"updated_state returns the state alpha, beta, plastic",
    ),
    "nothing": (
        {"updated_state": lambda e, s, p: None},
        r"updated_state: the state is None: return",
    ),
    "update shape": (
        {"updated_state": lambda e, s, p: {"plastic_strain": s["alpha"], "alpha": s["alpha"]}},
        r"updated_state: plastic_strain has the shape \(\); it must be \(3, 3\)",
    ),
    "stress shape": (
        {"stress": lambda e, s, p: ufl.as_tensor([[e[0, 0], e[0, 1]], [e[1, 0], e[1, 1]]])},
        r"Variant.stress has the shape \(2, 2\); it must be \(3, 3\)",
    ),
    "energy shape": (
        {"stress": None, "energy": lambda e, s, p: e},
        r"Variant.energy has the shape \(3, 3\); it must be \(\)",
    ),
    "elastic shape": (
        {"elastic_stress": lambda e, p: ufl.tr(e)},
        r"Variant.elastic_stress has the shape \(\)",
    ),
    "not UFL": ({"stress": lambda e, s, p: "s"}, r"Variant.stress is a str; it must be UFL"),
    "raises": ({"stress": fails}, r"Variant.stress raised ZeroDivisionError: a slip of the user's"),
    "no static method": (
        {"stress": lambda self, e, s, p: e},
        r"Variant.stress raised TypeError: .*static method, stress\(strain, state, p\)",
    ),
    "output raises": ({"output": fails}, r"Variant.output raised ZeroDivisionError"),
    "output shape": (
        {"output": lambda s, p: {"x": np.zeros(3)}},
        r"Variant.output: x has the shape \(3,\) at 0 integration points",
    ),
    "output hides": ({"output": lambda s, p: {"alpha": s["alpha"]}}, r"returns the name 'alpha'"),
}


@pytest.mark.mpi
@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named_at_construction(mistake):
    changes, message = MISTAKES[mistake]
    with pytest.raises(ValueError, match=message):
        create_solid(variant(**changes))


@pytest.mark.mpi
def test_a_parameter_that_is_no_number_is_named():
    with pytest.raises(ValueError, match=r"Isotropic: the parameter Y is 'soft': give a number"):
        create_solid(Isotropic(1000.0, 0.3, "soft", 1.0))


@pytest.mark.mpi
def test_one_name_in_two_shapes_names_both_laws():
    other = variant(state={"alpha": (3, 3)}, updated_state=lambda e, s, p: {"alpha": s["alpha"]})
    with pytest.raises(ValueError, match=r"'alpha' has the shape \(\) in Isotropic and \(3, 3\) i"):
        create_solid(Isotropic(1000.0, 0.3, 1.0, 1.0), other)


@pytest.mark.mpi
def test_output_is_optional_and_so_is_every_parameter():
    @dataclass(frozen=True)
    class Unit(dm.Material):
        state: ClassVar = {}
        linear: ClassVar = True

        @staticmethod
        def elastic_stress(strain, p):
            return strain

        @staticmethod
        def stress(strain, state, p):
            return strain

    for law in (Unit(), variant(output=None)):
        solid = create_solid(law)
        solid.u.interpolate(lambda x: np.stack([1e-4 * x[0], 0 * x[1]]))
        solid.evaluate()
        assert solid.max("stress_xx") > 0.0
    assert set(create_solid(Unit()).output_fields()) == {"stress", "von_mises"}


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
    solid.u.interpolate(lambda x: np.stack([0.02 * x[0], 0 * x[1]]))
    solid.evaluate()
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

    def stress(strain, state, p):
        return dm.Elastic.elastic_stress(strain, p)

    state = {"plastic_strain": ()}
    return variant(state=state, updated_state=update, stress=stress, output=None)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("laws", "share"),
    [
        ((Isotropic(1000.0, 0.3, 1.0, 100.0),), 0.5),
        ((dm.VonMises(1000.0, 0.3, 1.0, 100.0),), 0.5),
        ((scalar_plasticity(),), 0.5),
        ((Isotropic(1000.0, 0.3, 1.0, 100.0), dm.Elastic(1000.0, 0.3)), 0.5),
        ((dm.Elastic(1000.0, 0.3), Isotropic(1000.0, 0.3, 1.0, 100.0)), 0.0),
        ((dm.VonMises(1e3, 0.3, 1.0, 1e2),) * 2 + (Isotropic(1e3, 0.3, 1.0, 1e2),) * 4, 0.5),
        ((Isotropic(1e3, 0.3, 1.0, 1e2),) * 2 + (dm.VonMises(1e3, 0.3, 1.0, 1e2),) * 4, 0.5),
        ((variant(output=lambda s, p: {"plastic": s["alpha"] + 1.0}, updated_state=same),), 1.0),
    ],
)
def test_the_plastic_area_is_that_of_every_law(laws, share):
    """Laws by their plastic strain, tensor or scalar; one that says itself what is plastic wins."""
    solid = create_solid(*laws)
    solid.u.interpolate(lambda x: np.stack([0.02 * np.minimum(x[0], 0.5), 0 * x[1]]))
    solid.evaluate()
    assert solid.plastic_area() == pytest.approx(share, rel=1e-12)
    assert solid.max("plastic") == (share > 0)
    assert "plastic" in solid.output_fields()


@pytest.mark.mpi
def test_an_internal_variable_may_be_called_plastic():
    """Then it is what the law says it is, here a tensor."""
    state = {"plastic_strain": (3, 3), "plastic": (3, 3)}
    update = {name: ufl.Identity(3) for name in state}
    solid = create_solid(
        variant(
            state=state,
            updated_state=lambda *_: update,
            output=None,
            stress=lambda e, s, p: dm.Elastic.elastic_stress(e, p),
        )
    )
    solid.evaluate()
    assert solid.max("plastic_xx") == 1.0


@pytest.mark.serial
def test_the_law_of_the_guide_runs(capsys):
    """Ten lines, consistent, and its internal variable is written."""
    (code,) = re.findall(r"```python\n(from dataclasses.*?)```", GUIDE, re.DOTALL)
    body = code[code.index("class Stiffening") :].split("\nprint")[0]
    assert len([line for line in body.splitlines() if line.strip()]) <= 13
    names = {"dm": dm}
    exec(compile(code, "materials.md", "exec"), names)
    assert "consistent at" in capsys.readouterr().out
    solid = create_solid(names["Stiffening"](E=1000.0, nu=0.3, c=1e5))
    solid.u.interpolate(lambda x: np.stack([0.01 * x[0], 0 * x[1]]))
    solid.evaluate()
    assert solid.max("peak") == pytest.approx(0.01)
    assert "peak" in dm.ContactProblem(solid).output_fields()
