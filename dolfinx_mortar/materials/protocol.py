# SPDX-License-Identifier: MIT
"""The protocol of material laws."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from dolfinx_mortar.common.arguments import Rule, check, instance, number, one_of
from dolfinx_mortar.common.arrays import Bools, Floats
from ufl.core.expr import Expr

Parameter: TypeAlias = float | Expr
"""A number, a dolfinx Constant or Function, or a scalar UFL expression of such and of position.

Constants and Functions may change between steps; nothing is compiled anew.
"""
Range = tuple[float, float, bool]
"""Lower end, upper end (never allowed), and whether the lower end is allowed."""
POSITIVE: Range = (0.0, math.inf, False)
NOT_NEGATIVE: Range = (0.0, math.inf, True)
FINITE: Range = (-math.inf, math.inf, False)


def named_parameters(material: Any) -> dict[str, Any]:
    """Parameters by name; those of a tuple as ``name[0]``, ``name[1]`` ..

    >>> from dolfinx_mortar.materials import Ogden
    >>> named_parameters(Ogden(mu=(0.6, -0.1), alpha=(1.3, -2.0), K=1e3))["mu[1]"]
    -0.1
    """
    found: dict[str, Any] = {}
    for field in dataclasses.fields(material):
        value = getattr(material, field.name)
        if isinstance(value, tuple):
            found |= {f"{field.name}[{i}]": entry for i, entry in enumerate(value)}
        else:
            found[field.name] = value
    return found


def grouped(values: Mapping[str, Any]) -> SimpleNamespace:
    """Parameters of `named_parameters` as attributes, with tuples again."""
    groups: dict[str, Any] = {}
    for name, value in values.items():
        stem, _, number = name.partition("[")
        groups[stem] = (*groups.get(stem, ()), value) if number else value
    return SimpleNamespace(**groups)


def check_fields(law: Any) -> None:
    """Raise ValueError for numbers out of range."""
    kind = type(law)
    given = {name: (getattr(law, name), *limits) for name, limits in kind.ranges.items()}
    check_parameters(kind.__name__, **given)
    values = named_parameters(law)
    if all(isinstance(value, Real) for value in values.values()):
        for rule in wrong_values(kind.__name__, {}, getattr(kind, "conditions", None), values):
            numbers = ", ".join(f"{name} = {value!r}" for name, value in values.items())
            raise ValueError(f"{kind.__name__}: {rule} does not hold for {numbers}.")


def check_parameters(law: str, **ranges: tuple[Parameter, float, float, bool]) -> None:
    """Raise ValueError unless parameter=(value, *`Range`) is a finite number in it, or UFL."""
    for name, (value, lower, upper, closed) in ranges.items():
        if not isinstance(value, Expr):
            above, least = (-np.inf, lower) if closed else (lower, -np.inf)
            check(f"{law}: {name}", value, number(above=above, least=least, below=upper))


def wrong_values(
    law: str,
    ranges: Mapping[str, Range],
    rules: Callable[..., Any] | None,
    values: Mapping[str, Any],
) -> dict[str, Bools]:
    """Violated rules, in words, with masks (n,), or () for numbers."""
    found: dict[str, Any] = {}
    for name, (lower, upper, closed) in ranges.items():
        given = values[name]
        inside = (given >= lower if closed else given > lower) & (given < upper)
        rule = f"{name} in {'[' if closed else '('}{lower}, {upper})"
        found[rule] = ~(np.isfinite(given) & inside)
    unsound = np.zeros(np.shape(next(iter(values.values()), 0.0)), dtype=bool)
    sound = ~np.any([unsound, *found.values()], axis=0)
    try:
        with np.errstate(all="ignore"):
            held = {} if rules is None else dict(rules(grouped(values)))
        found |= {rule: sound & ~np.asarray(holds, bool) for rule, holds in held.items()}
    except Exception as error:
        raise ValueError(
            f"{law}.conditions raised {type(error).__name__}: {error}; it must return "
            "rule -> whether or where it holds, of numbers or arrays (n,)."
        ) from error
    return {rule: wrong for rule, wrong in found.items() if wrong.any()}


PLASTIC = "plastic_strain"
"""Name of the internal variable from which `Law.isotropic` laws subtract the strain."""


class Material(Protocol):
    """A frozen dataclass of parameters, with the law as static methods.

    The law gets the strain (3x3 UFL), the committed state and the parameters `p` (attributes named
    like the fields) as UFL symbols, see `Parameter`. It has either of

    * `energy(strain, state, p)`, the incremental potential psi of the step; UFL derives stress and
      tangent, or
    * `stress(strain, state, p)`, for a law without a potential (no line search on the energy).

    The tangent must be symmetric. `dolfinx_mortar.materials.check` tests a law without a mesh.

    `tangent(strain, state, p, direction)`, d stress / d strain : direction, is optional, instead of
    UFL's; it is inherited only together with energy and stress.

    Inheriting from this class is optional.

    **Finite strain.** A law with ``strain = "finite"``, for ``Solid(.., strain="finite")``, gets
    the deformation gradient F (3x3, det F > 0) in place of the strain: `energy(F, state, p)` is psi
    per volume at X, objective, psi(Q F) = psi(F) for rotations Q; `stress` is the first
    Piola-Kirchhoff stress P = d psi / dF, `tangent` dP/dF : direction. Only `elastic_stress` takes
    a small strain, at F = I. A part of psi that depends on J = det F alone may be
    `volumetric(J, p)`, in UFL, for ``volumetric="reduced"``. All other laws are transformed to F.

    Attributes:
        strain: "small" or "finite", the first argument of the law.
        state: internal variables, name -> shape, () or (3, 3) (symmetric); may be a property.
        linear: True if the stress is a linear function of the strain and nothing else.
        splits: True if psi(strain) = psi(dev strain) + K/2 tr(strain)^2 with the constant K of
            `elastic_stress`, for reduced integration of the volumetric part. Optional.
        isotropic: True if stress and energy depend on the strain less the internal variable
            ``plastic_strain`` only, without directions (no axes, no back stress). At finite strain
            such a law takes the multiplicative form, see `logarithmic`. May be a property.
            Optional.
        ranges: of the parameters, name -> (lower end, upper end, is the lower end allowed); others
            may be any number. Checked in every cell, and after changes.

    Rules for several parameters are a static method `conditions(p)`, rule in words -> whether or
    where it is satisfied; `check_fields`, in ``__post_init__``, checks numbers.
    """

    state: ClassVar[Mapping[str, tuple[int, ...]]]
    linear: ClassVar[bool]
    ranges: ClassVar[Mapping[str, Range]] = {}
    strain: ClassVar[str] = "small"

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain of a small strain, for energy norm and estimates."""
        raise NotImplementedError

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Internal variables at the end of the step."""
        return {}

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Further fields (q,) or (q, components) at q >= 0 points, from NumPy; optional."""
        return {}


class CheckedLaw(Material):
    """A law of this package: its numbers are checked when it is made."""

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_fields(self)


class PointwiseLaw(Material):
    """A law without a closed form: stress, tangent and new state at all points, from arrays.

    A `Material` with `update` in place of energy, stress and updated_state. Without an energy
    Newton's method takes whole steps. See the demo ``own_law`` for NumPy and JAX.

    With ``strain = "finite"`` the first argument is F (q, 3, 3), the stress P and the tangent
    dP_ij/dF_kl; such a law may have `energy(F, state, p)`, psi (q,), for the line search.
    """

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = False

    @staticmethod
    def update(
        strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
    ) -> tuple[Any, Any, Mapping[str, Any]]:
        """Return stress, tangent and new internal variables at q points.

        Args:
            strain: (q, 3, 3), symmetric; q may be 0.
            state: committed, (q,) or (q, 3, 3), read-only.
            p: parameters by name, (q,) each.

        Returns:
            Stress (q, 3, 3), tangent d stress_ij / d strain_kl (q, 3, 3, 3, 3) with the symmetry ij
            <-> kl (the mean of kl and lk is used), and the internal variables at the end of the
            step by name, exactly unchanged where nothing flows.
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Law:
    """The parts of a law, None if missing."""

    name: str
    strain: str  # "small" or "finite"
    plane_stress: bool  # whether sigma_zz = 0
    state: Mapping[str, tuple[int, ...]]
    linear: bool
    splits: bool
    isotropic: bool
    ranges: Mapping[str, Range]
    elastic_stress: Callable[..., Any]
    energy: Callable[..., Any] | None
    stress: Callable[..., Any] | None
    tangent: Callable[..., Any] | None
    updated_state: Callable[..., Any] | None
    update: Callable[..., Any] | None
    output: Callable[..., Any] | None
    conditions: Callable[..., Any] | None
    volumetric: Callable[..., Any] | None  # part U(J) of the energy of a law of F

    @property
    def at_points(self) -> bool:
        """Whether it is evaluated at points, before forms are assembled."""
        return self.update is not None or (self.plane_stress and not self.linear)


_REMEDIES = {
    "state": "declare its internal variables, state: ClassVar = {} if it has none",
    "linear": "declare linear: ClassVar = False, or True if the stress is linear in the strain",
    "elastic_stress": "add elastic_stress(strain, p), the stress of a small elastic strain, for "
    "example staticmethod(dolfinx_mortar.Elastic.elastic_stress), of parameters E and nu",
    "stress or energy": "add energy(strain, state, p), the potential of the step, or "
    "stress(strain, state, p), or update(strain, state, p) of arrays",
    "updated_state": "add updated_state(strain, state, p) for the internal variables of `state`",
}
# Names of fields that no law may use.
RESERVED = (
    *("stress", "von_mises", "J", "stored_energy", "dissipated_energy"),
    *("displacement", "pressure", "gap", "facing", "status"),
    *("traction", "slip"),
)


def create_law(name: str, material: Any, *, plane_stress: bool = False) -> Law:
    """Parts of a law; a ValueError, with `name`, for a missing or wrong part."""
    if not dataclasses.is_dataclass(material) or isinstance(material, type):
        raise ValueError(f"{name} = {material!r} is not a material such as Elastic(E, nu).")
    kind = type(material)
    names = ("elastic_stress", "energy", "updated_state", "update", "output", "conditions")
    parts: dict[str, Any] = {part: _method(kind, part) for part in (*names, "volumetric")}
    parts |= {part: _fitting(material, part) for part in ("stress", "tangent")}
    state, linear = (getattr(material, part, None) for part in ("state", "linear"))
    given, arrays = {name for name, part in parts.items() if part}, parts["update"] is not None
    needed = {
        "state": state is not None,
        "linear": linear is not None,
        "elastic_stress": "elastic_stress" in given,
        "updated_state": arrays or not state or "updated_state" in given,
        "stress or energy": arrays or not given.isdisjoint({"stress", "energy"}),
    }
    missing = [part for part, there in needed.items() if not there]
    if missing:
        remedies = "; ".join(_REMEDIES[part] for part in missing)
        raise ValueError(
            f"{name} = {material!r} is not a material: {kind.__name__} has no "
            f"{', no '.join(missing)}; {remedies}."
        )
    strain = getattr(kind, "strain", "small")
    check(f"{kind.__name__}: strain", strain, one_of("small", "finite"))
    law = Law(
        name=kind.__name__,
        strain=strain,
        plane_stress=plane_stress,
        state=_checked_state(kind.__name__, state),
        linear=bool(linear),
        splits=bool(getattr(kind, "splits", False)),
        isotropic=bool(getattr(material, "isotropic", False)),
        ranges=getattr(kind, "ranges", {}),
        **parts,
    )
    tensors = [variable for variable, shape in law.state.items() if shape and variable != PLASTIC]
    if law.isotropic and tensors:
        raise ValueError(
            f"{law.name}: isotropic is True, but state has the tensor {tensors[0]!r}; the state of "
            f"an isotropic law may have scalars and {PLASTIC!r} only: leave isotropic out."
        )
    _check_parameters(law, material)
    return law


def _check_parameters(law: Law, material: Any) -> None:
    given = named_parameters(material)
    for name in law.ranges:
        check(f"{law.name}: ranges: a name", name, one_of(*given))
    remedy = (
        "give a number, a scalar Constant, Function or UFL expression, or a tuple of these; "
        "declare a field that is no parameter as ClassVar"
    )
    for name, value in given.items():
        scalar = isinstance(value, Real) or (isinstance(value, Expr) and value.ufl_shape == ())
        if not scalar:
            raise ValueError(f"{law.name}: the parameter {name} is {value!r}: {remedy}")


def _method(kind: type, name: str) -> Callable[..., Any] | None:
    found = getattr(kind, name, None)
    given = found not in (Material.elastic_stress, PointwiseLaw.update)
    return found if callable(found) and given else None


def _fitting(material: Any, part: str) -> Callable[..., Any] | None:
    places = [
        next((i for i, kind in enumerate(type(material).__mro__) if name in vars(kind)), math.inf)
        for name in (part, "energy", "stress")
    ]
    found = getattr(material, part, None)
    return found if callable(found) and places[0] <= min(places[1:]) else None


def _checked_state(law: str, state: Any) -> Mapping[str, tuple[int, ...]]:
    """Declared internal variables, checked."""
    check(f"{law}: state", state, instance(Mapping, "give a dictionary, name -> shape"))
    free = Rule[str](
        f"choose a text other than {', '.join(RESERVED)}",
        lambda name: name if isinstance(name, str) and name not in RESERVED else None,
    )
    shapes = Rule[tuple[int, ...]](
        "give () for a scalar or (3, 3) for a symmetric tensor",
        lambda shape: shape if shape in ((), (3, 3)) else None,
    )
    for name, shape in state.items():
        check(f"{law}: state: a name", name, free)
        check(f"{law}: state: the shape of {name!r}", shape, shapes)
    return dict(state)
