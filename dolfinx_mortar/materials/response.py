# SPDX-License-Identifier: MIT
"""The response of a law to a strain, with checks of the values that its methods return."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.arguments import check, instance
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.materials import plane_stress
from dolfinx_mortar.materials.plane_stress import (
    NORMAL,
    condensed,
    in_plane,
    with_normal_strain,
    with_normal_stretch,
)
from dolfinx_mortar.materials.protocol import PLASTIC, Law, grouped, ungrouped
from dolfinx_mortar.materials.tensor import mean_of_shears
from ufl.algorithms import expand_derivatives
from ufl.classes import Label, Variable
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction


@dataclass(frozen=True)
class Response:
    """Response of a law in UFL to a strain."""

    stress: Expr  # (3, 3)
    energy: Expr | None  # the incremental potential, if the law has one
    updated: dict[str, Expr]  # internal variables at the end of the step, () or (3, 3)
    change: Callable[[Expr], Expr]  # direction, 3x3 -> d stress / d strain : direction
    # sigma_zz, C_zzzz, the elastic C_zzzz and |sigma| in plane stress, see `plane_stress.solve`
    equation: tuple[Expr, Expr, Expr, Expr] | None = None
    normal_strain: Expr | None = None  # replaces the equation: its root, if in closed form
    start: Expr | None = None  # root of the equation if nothing flows


def respond(
    law: Law, strain: Expr, state: Mapping[str, Expr], p: Any, z: Expr | None = None
) -> Response:
    """Stress, energy and new internal variables of a law in UFL.

    The stress of a law without one is the derivative of its energy. In plane stress the strain out
    of the plane leaves no stress: z, if `law.condensed`; at finite strain F has the stretch 1 + z.

    Raises:
        ValueError: if a method of the law raises, or returns something of the wrong shape or name.
    """
    equation = root = start = None
    finite = law.strain == "finite"
    with_normal = with_normal_stretch if finite else with_normal_strain
    if law.plane_stress and law.normal_strain is not None:
        flat = with_normal_strain(strain, 0.0)
        root = _call(law, "normal_strain", (), flat, state, p)
        strain = with_normal_strain(strain, z)
    elif law.plane_stress:
        equation = _equation(law, with_normal(strain, 0.0 if z is None else z), state, p)
        start = None if finite else _elastic_root(law, strain, state, p)
        strain = with_normal(strain, -equation[0] / equation[1] if z is None else z)
    energy = None if law.energy is None else _call(law, "energy", (), strain, state, p)
    stress = _stress(law, strain, state, p)
    updated = _updated_state(law, strain, state, p)

    def change(direction: Expr) -> Expr:
        return _change(law, strain, state, p, direction)

    if not law.plane_stress:
        return Response(stress, energy, updated, change)
    flat = condensed(change, finite=finite)
    return Response(in_plane(stress), energy, updated, flat, equation, root, start)


def _stress(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
    """Stress of a law, or the derivative of its energy."""
    if law.stress is not None:
        return _call(law, "stress", (3, 3), strain, state, p)
    # not ufl.variable: its running number would enter the signature of the compiled code
    variable = Variable(strain, Label(-1))
    return ufl.diff(_call(law, "energy", (), variable, state, p), variable)


def _change(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
    """Return d stress / d strain : direction, as the law states it or by UFL."""
    if law.tangent is not None:
        return _call(law, "tangent", (3, 3), strain, state, p, direction)
    step = Variable(ufl.as_ufl(0.0), Label(-2))
    change = ufl.diff(_stress(law, strain + step * direction, state, p), step)
    return without_variables(expand_derivatives(change))  # without terms that step = 0 removes


def without_variables(expression: Expr) -> Expr:
    """An expression with the operands of its Variables.

    UFL's `strip_variables` visits repeated parts each time, which takes half of the time to create
    a `Solid` with plastic flow.
    """
    return map_expr_dag(_VariableStripper(), expression)


class _VariableStripper(MultiFunction):
    """Rules of `without_variables`."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Variable, expression: Expr, label: Label) -> Expr:
        """Operand of the Variable."""
        return expression


def _equation(
    law: Law, strain: Expr, state: Mapping[str, Expr], p: Any
) -> tuple[Expr, Expr, Expr, Expr]:
    """Equation of the strain out of the plane, see `Response.equation`."""
    stress = _stress(law, strain, state, p)
    modulus = _change(law, strain, state, p, NORMAL)[2, 2]
    elastic = _call(law, "elastic_stress", (3, 3), NORMAL, p)[2, 2]
    return stress[2, 2], modulus, elastic, ufl.sqrt(ufl.inner(stress, stress))


def _elastic_root(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
    """Elastic strain out of the plane that leaves no stress there."""
    elastic = with_normal_strain(strain, 0.0)
    if law.state.get(PLASTIC) == (3, 3):
        elastic = elastic - state[PLASTIC]
    stress, moduli = (_call(law, "elastic_stress", (3, 3), e, p) for e in (elastic, NORMAL))
    return -stress[2, 2] / moduli[2, 2]


def elastic_response(law: Law, strain: Expr, p: Any) -> Expr:
    """C : strain of a law, 3x3; its mistakes are ValueErrors."""

    def elastic(e: Expr) -> Expr:
        return _call(law, "elastic_stress", (3, 3), e, p)

    return condensed(elastic)(strain) if law.plane_stress else elastic(strain)


def _updated_state(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
    """New internal variables, one for each that is declared."""
    if law.updated_state is None:
        return {}
    new = _guarded(law, "updated_state", strain, state, p)
    where = f"{law.name}.updated_state"
    _check_state(law, where, new)
    return {name: _shaped(f"{where}: {name}", new[name], law.state[name]) for name in law.state}


def _check_state(law: Law, where: str, new: Any) -> None:
    """Raise a ValueError unless a law returns its declared internal variables."""
    check(f"{where}: the state", new, instance(Mapping, "return a dictionary by name"))
    if set(new) != set(law.state):
        given, declared = (", ".join(sorted(names)) or "nothing" for names in (new, law.state))
        raise ValueError(f"{where} returns the state {given}, but `state` declares {declared}.")


def _call(law: Law, method: str, shape: tuple[int, ...], *arguments: Any) -> Any:
    """Return what a method of a law gives, as UFL, or an array, of the right shape."""
    return _shaped(f"{law.name}.{method}", _guarded(law, method, *arguments), shape)


def _guarded(law: Law, method: str, *arguments: Any) -> Any:
    """Call a method of a law; its errors name it."""
    try:
        return getattr(law, method)(*arguments)
    except Exception as error:
        wanted = _ARGUMENTS.get(method, "(strain, state, p)")
        where = f"it is called as a static method, {method}{wanted}, with UFL"
        if isinstance(arguments[0], np.ndarray):
            where = f"at {len(arguments[0])} points"
        raise ValueError(
            f"{law.name}.{method} raised {type(error).__name__}: {error} ({where}){_remedy(error)}"
        ) from error


_ARGUMENTS = {"elastic_stress": "(strain, p)", "tangent": "(strain, state, p, direction)"}


def _shaped(what: str, value: Any, shape: tuple[int, ...]) -> Any:
    """Return a value as UFL, or, of a law of arrays, as an array; a ValueError if it is neither."""
    arrays = len(shape) % 2 == 1  # points are the first axis
    found: Any
    try:
        found = np.asarray(value, dtype=np.float64) if arrays else ufl.as_ufl(value)
    except Exception as error:
        wanted = "an array" if arrays else "UFL"
        raise ValueError(f"{what} is a {type(value).__name__}; it must be {wanted}.") from error
    given = found.shape if arrays else found.ufl_shape
    if given != shape or (not arrays and found.ufl_free_indices):
        where = f" at {shape[0]} points" if arrays else ""
        where += ", with free indices" if not arrays and found.ufl_free_indices else ""
        raise ValueError(f"{what} has the shape {given}{where}; it must be {shape}.")
    return found


@dataclass(frozen=True)
class PointValues:
    """Response of a law at q points."""

    stress: Floats  # (q, 3, 3), at finite strain P
    tangent: Floats  # (q, 3, 3, 3, 3), for a small strain with the symmetry k <-> l
    state: dict[str, Floats]  # (q,) or (q, 3, 3)
    normal: Floats | None = None  # (q,) z of plane stress, see `plane_stress`
    energy: Floats | None = None  # (q,) of a law of F that has one

    @property
    def undefined(self) -> Bools:
        """Points (q,) with NaN or infinite values."""
        parts = [self.stress, self.tangent, *self.state.values()]
        parts += [] if self.energy is None else [self.energy]
        found = np.zeros(len(self.stress), dtype=bool)
        for part in parts:
            if not np.isfinite(part.sum()):  # much faster than each
                found |= ~np.isfinite(part.reshape(len(part), -1)).all(axis=1)
        return found


def values_at_points(
    law: Law, strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
) -> PointValues:
    """Values of a law of arrays at q points.

    For a symmetric strain (q, 3, 3), or F, committed internal variables (q,) or (q, 3, 3),
    parameters (q,).

    Raises:
        ValueError: if it raises, or returns something of another form, name or shape.
    """
    z, finite = None, law.strain == "finite"
    if law.plane_stress:
        z = _normal_at_points(law, strain, state, p)
        strain = _flat(strain, 1.0 + z if finite else z)
    found = _updated(law, strain, state, p)
    if finite and law.energy is not None:
        psi = _call(law, "energy", (len(strain),), strain, state, p)
        found = dataclasses.replace(found, energy=psi)
    return found if z is None else _condensed(found, z)


def _flat(strain: Floats, normal: Floats) -> Floats:
    """The part in the plane of tensors (q, 3, 3), with zz entries (q,)."""
    whole = np.zeros_like(strain)
    whole[:, :2, :2], whole[:, 2, 2] = strain[:, :2, :2], normal
    return whole


def _normal_at_points(
    law: Law, strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
) -> Floats:
    """Strain, or stretch less 1, (q,) out of the plane that leaves no stress."""
    finite, parameters = law.strain == "finite", ungrouped(p)

    def equation(points: Ints, z: Floats) -> Floats:
        some = _flat(strain[points], 1.0 + z[:, 0] if finite else z[:, 0])
        here = ({n: v[points] for n, v in values.items()} for values in (state, parameters))
        found = _updated(law, some, next(here), grouped(next(here)))
        C, norm = found.tangent, np.linalg.norm(found.stress, axis=(1, 2))
        stiffest = np.abs(C).max(axis=(1, 2, 3, 4), initial=0.0)
        parts = [found.stress[:, 2, 2], C[:, 2, 2, 2, 2], stiffest, norm]
        return np.stack(parts, axis=1)[:, None]

    return plane_stress.solve(law.name, equation, (len(strain), 1), finite=finite)[:, 0]


def _condensed(found: PointValues, z: Floats) -> PointValues:
    """Values with stress and tangent of plane stress."""
    stress, C = found.stress.copy(), found.tangent
    stress[:, 2], stress[:, :, 2] = 0.0, 0.0
    with np.errstate(all="ignore"):
        modulus = C[:, 2, 2, 2, 2][:, None, None, None, None]
        tangent = C - np.einsum("qij,qkl->qijkl", C[..., 2, 2], C[:, 2, 2]) / modulus
    for axis in range(1, 5):
        np.moveaxis(tangent, axis, 1)[:, 2] = 0.0
    return dataclasses.replace(found, stress=stress, tangent=tangent, normal=z)


def _updated(
    law: Law, strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
) -> PointValues:
    """Call a law of arrays at q points, see `values_at_points`."""
    where, q = f"{law.name}.update", len(strain)
    found = _guarded(law, "update", strain, state, p)
    if not isinstance(found, tuple) or len(found) != 3:
        raise ValueError(
            f"{where} returns {type(found).__name__}; it must return stress, tangent, new state"
        )
    stress, tangent, new = found
    _check_state(law, where, new)
    C = _shaped(f"{where}: the tangent", tangent, (q, 3, 3, 3, 3))
    return PointValues(
        _shaped(f"{where}: the stress", stress, (q, 3, 3)),
        mean_of_shears(C) if law.strain == "small" else C,
        {n: _shaped(f"{where}: {n}", new[n], (q, *shape)) for n, shape in law.state.items()},
    )


def _remedy(error: Exception) -> str:
    """Remedy for an error of a user's function, "" if unknown; numba caches by module name."""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    return (
        "; if it calls functions of numba with cache=True, they were compiled by a program that "
        f"imports their file as {error.name}: delete the __pycache__ beside it, and import it by "
        "one name everywhere"
    )
