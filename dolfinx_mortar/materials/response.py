# SPDX-License-Identifier: MIT
"""The response of a law to a strain, with checks of the values of its methods.

Plane stress by condensation at each point, with the strain e in the plane and z out of it:

    sigma_zz(e, z) = 0,         psi(e) = psi(e, z),
    d sigma / d e = C - C : zz (x) zz : C / C_zzzz.

At finite strain e is F in the plane, sigma is P and z the stretch out of the plane less 1. For a
linear law z = -sigma_zz(e, 0) / C_zzzz; else Newton's method solves for z at each point.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, LIMIT, ROUND_OFF, Bools, Floats, Ints, flat
from dolfinx_mortar.materials.protocol import Law, grouped
from dolfinx_mortar.materials.tensor import mean_of_shears
from ufl.algorithms import expand_derivatives
from ufl.classes import Label, Variable
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

NORMAL = ufl.as_tensor([[0.0, 0, 0], [0, 0, 0], [0, 0, 1.0]])


def with_normal(strain: Expr, normal: Any) -> Expr:
    """The in-plane part of a strain, or of F, with zz = normal."""
    (a, b), (c, d) = ((strain[i, 0], strain[i, 1]) for i in range(2))
    return ufl.as_tensor([[a, b, 0], [c, d, 0], [0, 0, normal]])


def in_plane(tensor: Expr) -> Expr:
    """The in-plane part."""
    return with_normal(tensor, 0)


def condensed(change: Callable[[Expr], Expr]) -> Callable[[Expr], Expr]:
    """Return d -> C : d - C : zz (C : d)_zz / C_zzzz in the plane, from the function d -> C : d."""

    def in_plane_change(direction: Expr) -> Expr:
        fixed, normal = change(in_plane(direction)), change(NORMAL)
        return in_plane(fixed - fixed[2, 2] / normal[2, 2] * normal)

    return in_plane_change


Equation = Callable[[Ints, Floats], Sequence[Floats]]
"""Points (k,) and z (k,) there -> sigma_zz, C_zzzz, elastic C_zzzz, |sigma|, (k,) each."""


def solve_normal_strain(law: str, equation: Equation, q: int, *, finite: bool = False) -> Floats:
    """Return z (q,) with sigma_zz(z) = 0, NaN where the law is undefined.

    Newton's method with bisection; twice the elastic step where C_zzzz <= 0; at finite strain at
    most half of the way to z = -1.

    Args:
        law: its name.
        equation: see above.
        q: number of points.
        finite: whether z is a stretch less 1.

    Raises:
        ValueError: naming the law, if Newton's method fails at a point.
    """
    z, high, low = np.zeros(q), np.full(q, np.inf), np.full(q, -1.0 if finite else -np.inf)
    rows: Ints = np.arange(q, dtype=np.int32)
    for iteration in range(LIMIT):
        now = z[rows]
        residual, modulus, elastic, stress = equation(rows, now)
        below = residual < 0.0
        with np.errstate(all="ignore"):
            step = -residual / (0.5**iteration * elastic)
            new = now + np.where(modulus > 0.0, -residual / modulus, step)
            if finite:  # a stretch is at most halved
                new = np.maximum(new, (now - 1.0) / 2)
            # half of the digits suffice before the last, quadratic iteration
            allowed = np.maximum(HALF_OF_DIGITS * stress, ROUND_OFF * elastic * finite)
            small = (np.abs(residual) <= allowed) & np.isfinite(stress)
            a = low[rows] = np.where(below, now, low[rows])
            b = high[rows] = np.where(below, high[rows], now)
            middle = (a + b) / 2
            bracketed, outside = np.isfinite(middle), ~small & ~((a < new) & (new < b))
            narrow = outside & bracketed & ((middle == a) | (middle == b))
        new = np.where(outside, np.where(bracketed, middle, now + step), new)
        z[rows] = np.where(residual == 0.0, now, new)
        # a law undefined from the start counts as finished
        done = small | narrow | (np.isnan(stress) & (iteration == 0))
        rows = rows[~done]
        if not rows.size:
            return z
    raise ValueError(
        f"{law}: in plane stress, no strain out of the plane was found that leaves no stress there "
        f"around {len(rows)} points after {LIMIT} iterations; check the law with "
        f"dolfinx_mortar.materials.check(law{'' if finite else ', plane_stress=True'}), or take "
        "smaller steps"
    )


@dataclass(frozen=True)
class Response:
    """Response of a law in UFL to a strain."""

    stress: Expr
    energy: Expr | None  # the incremental potential, if the law has one
    updated: dict[str, Expr]  # internal variables at the end of the step, () or (3, 3)
    change: Callable[[Expr], Expr]  # direction, 3x3 -> d stress / d strain : direction


def respond(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> Response:
    """Stress, energy and new internal variables of a law in UFL; a ValueError if the law fails.

    In plane stress only of a linear law.
    """
    if law.plane_stress:
        strain = in_plane(strain)
        normal = _change(law, strain, state, p, NORMAL)[2, 2]
        strain = with_normal(strain, -_stress(law, strain, state, p)[2, 2] / normal)
    energy = None if law.energy is None else _call(law, "energy", (), strain, state, p)
    stress = _stress(law, strain, state, p)
    updated = _updated_state(law, strain, state, p)

    def change(direction: Expr) -> Expr:
        return _change(law, strain, state, p, direction)

    if not law.plane_stress:
        return Response(stress, energy, updated, change)
    return Response(in_plane(stress), energy, updated, condensed(change))


def _stress(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> Expr:
    if law.stress is not None:
        return _call(law, "stress", (3, 3), strain, state, p)
    # not ufl.variable: its running number would enter the compiled signature
    variable = Variable(strain, Label(-1))
    return ufl.diff(_call(law, "energy", (), variable, state, p), variable)


def _change(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any, direction: Expr) -> Expr:
    """Return d stress / d strain : direction, from the law or by UFL."""
    if law.tangent is not None:
        return _call(law, "tangent", (3, 3), strain, state, p, direction)
    step = Variable(ufl.as_ufl(0.0), Label(-2))
    change = ufl.diff(_stress(law, strain + step * direction, state, p), step)
    return without_variables(expand_derivatives(change))  # removes terms that step = 0 cancels


def without_variables(expression: Expr) -> Expr:
    """Expression without Variables; UFL's `strip_variables` visits shared parts repeatedly."""
    return map_expr_dag(_VariableStripper(), expression)


class _VariableStripper(MultiFunction):
    expr = MultiFunction.reuse_if_untouched

    def variable(self, o: Variable, expression: Expr, label: Label) -> Expr:
        """Return the operand."""
        return expression


def elastic_response(law: Law, strain: Expr, p: Any) -> Expr:
    """C : strain, 3x3; mistakes of laws are ValueErrors."""

    def elastic(e: Expr) -> Expr:
        return _call(law, "elastic_stress", (3, 3), e, p)

    return condensed(elastic)(strain) if law.plane_stress else elastic(strain)


def _updated_state(law: Law, strain: Expr, state: Mapping[str, Expr], p: Any) -> dict[str, Expr]:
    if law.updated_state is None:
        return {}
    new = _guarded(law, "updated_state", strain, state, p)
    where = f"{law.name}.updated_state"
    _check_state(law, where, new)
    return {name: _shaped(f"{where}: {name}", new[name], law.state[name]) for name in law.state}


def _check_state(law: Law, where: str, new: Any) -> None:
    check(f"{where}: the state", new, instance(Mapping, "return a dictionary by name"))
    if set(new) != set(law.state):
        given, declared = (", ".join(sorted(names)) or "nothing" for names in (new, law.state))
        raise ValueError(f"{where} returns the state {given}, but `state` declares {declared}.")


def _call(law: Law, method: str, shape: tuple[int, ...], *arguments: Any) -> Any:
    return _shaped(f"{law.name}.{method}", _guarded(law, method, *arguments), shape)


def _guarded(law: Law, method: str, *arguments: Any) -> Any:
    try:
        return getattr(law, method)(*arguments)
    except Exception as error:
        wanted = _ARGUMENTS.get(method, "(strain, state, p)")
        raise ValueError(
            f"{law.name}.{method} raised {type(error).__name__}: {error} (it is called as a static "
            f"method, {method}{wanted}){_remedy(error)}"
        ) from error


_ARGUMENTS = {"elastic_stress": "(strain, p)", "tangent": "(strain, state, p, direction)"}


def _shaped(what: str, value: Any, shape: tuple[int, ...]) -> Any:
    """A value as UFL, or as an array for a law of arrays; else a ValueError."""
    arrays = len(shape) % 2 == 1  # the first axis is the points
    found: Any
    try:
        found = np.asarray(value, dtype=np.float64) if arrays else ufl.as_ufl(value)
    except Exception as error:
        wanted = "an array" if arrays else "UFL"
        raise ValueError(f"{what} is a {type(value).__name__}; it must be {wanted}.") from error
    given = found.shape if arrays else found.ufl_shape
    free = not arrays and bool(found.ufl_free_indices)
    if given != shape or free:
        where = f" at {shape[0]} points" if arrays else ", with free indices" * free
        raise ValueError(f"{what} has the shape {given}{where}; it must be {shape}.")
    return found


@dataclass(frozen=True)
class PointValues:
    """Response of a law at q points."""

    stress: Floats  # (q, 3, 3), at finite strain P
    tangent: Floats  # (q, 3, 3, 3, 3), for a small strain with the symmetry k <-> l
    state: dict[str, Floats]  # (q,) or (q, 3, 3)
    energy: Floats | None = None  # (q,)

    @property
    def undefined(self) -> Bools:
        """Points (q,) with NaN or infinite values."""
        parts = [self.stress, self.tangent, *self.state.values()]
        parts += [] if self.energy is None else [self.energy]
        found = np.zeros(len(self.stress), dtype=bool)
        for part in parts:
            if not np.isfinite(part.sum()):  # faster than a test of each
                found |= ~np.isfinite(flat(part)).all(axis=1)
        return found


def values_at_points(
    law: Law, strain: Floats, state: Mapping[str, Floats], p: Mapping[str, Floats]
) -> PointValues:
    """Values of a law of arrays at q points; a ValueError for a wrong form, name or shape.

    Strain, or F, (q, 3, 3); committed state (q,) or (q, 3, 3); parameters (q,) by name.
    """
    where, q, finite = f"{law.name}.update", len(strain), law.strain == "finite"
    given = strain, state, grouped(p)
    found = _guarded(law, "update", *given)
    if not isinstance(found, tuple) or len(found) != 3:
        raise ValueError(
            f"{where} returns {type(found).__name__}; it must return stress, tangent, new state"
        )
    stress, tangent, new = found
    _check_state(law, where, new)
    C = _shaped(f"{where}: the tangent", tangent, (q, 3, 3, 3, 3))
    return PointValues(
        _shaped(f"{where}: the stress", stress, (q, 3, 3)),
        C if finite else mean_of_shears(C),
        {n: _shaped(f"{where}: {n}", new[n], (q, *shape)) for n, shape in law.state.items()},
        _call(law, "energy", (q,), *given) if finite and law.energy is not None else None,
    )


def _remedy(error: Exception) -> str:
    """Remedy for an error, or ""; numba caches by module name."""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    return (
        "; if it calls functions of numba with cache=True, they were compiled by a program that "
        f"imports their file as {error.name}: delete the __pycache__ beside it, and import it by "
        "one name everywhere"
    )
