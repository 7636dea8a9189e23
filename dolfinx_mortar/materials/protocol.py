# SPDX-License-Identifier: MIT
"""What a material law is: numbers, and UFL expressions of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar, Protocol

import numpy as np

from dolfinx_mortar.html import table
from dolfinx_mortar.materials.parameters import Range
from ufl.core.expr import Expr


class Material(Protocol):
    """A frozen dataclass whose fields are the parameters, with the law as static methods.

    A law knows no mesh. It gets the strain (3x3 UFL), the committed state and the parameters `p`
    (attributes named like the fields) as UFL symbols, so that the compiled code is the same for all
    values of the parameters, be they numbers or what may change (see `Parameter`). Then either of

    * `energy(strain, state, p)`, the incremental potential psi of the step; the stress is
      d psi / d strain and the tangent its derivative, both taken by UFL, or
    * `stress(strain, state, p)`, for a law without a potential (no line search on the energy).

    A law that has both gives its stress in closed form, and UFL differentiates only that. The
    tangent must be symmetric. `dolfinx_mortar.materials.check` tries a law out without a mesh.

    Where UFL should not differentiate the stress (an inner iteration), a law states its derivative:
    `tangent(strain, state, p, direction)`, d stress / d strain : direction. A material whose
    parameters decide which methods hold has a property `law`, the class that has them.

    A law may inherit from this class, which has no memory and no output, or just look like it.

    Attributes:
        state: internal variables, name -> shape; () or (3, 3) (symmetric).
        linear: True if the stress is a linear function of the strain and nothing else.
        splits: True if psi(strain) = psi(dev strain) + K/2 tr(strain)^2 with the constant K that
            `elastic_stress` has, so that the second part may be integrated otherwise. Optional.
        ranges: of the parameters, name -> (lower end, upper end, is the lower end allowed);
            those without a range may be any number. Judged wherever the law holds, and whenever a
            parameter has changed.

    What involves several parameters is a static method `conditions(p)`, rule in words -> whether or
    where it holds, of numbers or arrays. `parameters.check_fields`, called in ``__post_init__``,
    judges numbers as soon as a law is made.
    """

    state: ClassVar[Mapping[str, tuple[int, ...]]]
    linear: ClassVar[bool]
    ranges: ClassVar[Mapping[str, Range]] = {}

    @staticmethod
    def elastic_stress(strain: Expr, p: Any) -> Expr:
        """Return C : strain, the stress of an elastic increment (defines the energy norm)."""
        raise NotImplementedError

    @staticmethod
    def updated_state(strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
        """Return the internal variables at the end of the step, one per name in `state`."""
        return {}

    @staticmethod
    def output(state: Mapping[str, np.ndarray], p: SimpleNamespace) -> dict[str, np.ndarray]:
        """Return further fields (q,) or (q, components) at q integration points, from NumPy.

        q may be 0: the names and shapes are then all that counts. Optional.
        """
        return {}

    def _repr_html_(self) -> str:
        """Return the parameters for a notebook."""
        given: Any = self
        fields = dataclasses.fields(given) if dataclasses.is_dataclass(given) else ()
        return table(type(self).__name__, [(f.name, getattr(self, f.name)) for f in fields])


def is_pointwise(law: Any) -> bool:
    """Tell whether a law is a function of numbers, see `PointwiseLaw`."""
    return bool(getattr(law, "pointwise", False))


def law_of(material: Any) -> Any:
    """Return the class whose static methods are the law of a material."""
    return getattr(material, "law", type(material))


_REMEDIES = {
    "state": "declare its internal variables, state: ClassVar = {} if it has none",
    "linear": "declare linear: ClassVar = False, or True if the stress is linear in the strain",
    "elastic_stress": "add elastic_stress(strain, p), for example "
    "staticmethod(dolfinx_mortar.Elastic.elastic_stress)",
    "energy": "add energy(strain, state, p), the potential of the step, or stress(strain, state, "
    "p)",
    "update": "add update(strain, state, p), see dolfinx_mortar.materials.PointwiseLaw",
    "updated_state": "add updated_state(strain, state, p) for the internal variables of `state`",
}
# Fields that are written beside those of the laws; a law must not hide them.
RESERVED = (
    *("stress", "von_mises"),
    *("displacement", "pressure", "gap", "facing", "status"),
    *("traction", "slip"),
)


def check_declaration(name: str, law: Any) -> None:
    """Raise ValueError unless a law declares all that a law must.

    Args:
        name: how the user's argument is called.
        law: what was given as a material.
    """
    if not dataclasses.is_dataclass(law) or isinstance(law, type):
        raise ValueError(f"{name} = {law!r} is not a material such as Elastic(E, nu).")
    kind = law_of(law)
    missing = [part for part in ("state", "linear") if getattr(kind, part, None) is None]
    methods = ["elastic_stress"]
    methods += ["updated_state"] if getattr(kind, "state", None) else []
    missing += [part for part in methods if not callable(getattr(kind, part, None))]
    given = ("update",) if is_pointwise(kind) else ("stress", "energy")
    if not any(callable(getattr(kind, method, None)) for method in given):
        missing.append(given[-1])
    if missing:
        what = ["stress or energy" if part == "energy" else part for part in missing]
        remedies = "; ".join(_REMEDIES[part] for part in missing)
        raise ValueError(
            f"{name} = {law!r} is not a material: {kind.__name__} has no {', no '.join(what)}; "
            f"{remedies}."
        )
    _check_state(kind)
    names = [field.name for field in dataclasses.fields(law)]
    for name in getattr(kind, "ranges", {}):
        if name not in names:
            raise ValueError(
                f"{kind.__name__}: ranges has {name!r}, which is no parameter; there are "
                f"{', '.join(names) or 'none'}."
            )
    for field in dataclasses.fields(law):
        value = getattr(law, field.name)
        if not isinstance(value, Real) and not (isinstance(value, Expr) and value.ufl_shape == ()):
            raise ValueError(
                f"{kind.__name__}: the parameter {field.name} = {value!r} is no number, and no "
                "scalar Constant, Function or UFL expression; a field that is no parameter is "
                "declared as ClassVar."
            )


def _check_state(kind: type) -> None:
    """Raise ValueError unless the declared internal variables have names and shapes that work."""
    state: Any = kind.state  # type: ignore[attr-defined]
    if not isinstance(state, Mapping):
        raise ValueError(f"{kind.__name__}: state is {state!r}; give a dictionary, name -> shape.")
    for name, shape in state.items():
        if not isinstance(name, str) or name in RESERVED:
            raise ValueError(
                f"{kind.__name__}: state has the name {name!r}; choose a text other than "
                f"{', '.join(RESERVED)}."
            )
        if shape not in ((), (3, 3)):
            raise ValueError(
                f"{kind.__name__}: state {name!r} has the shape {shape!r}; it must be () for a "
                "scalar or (3, 3) for a symmetric tensor."
            )
