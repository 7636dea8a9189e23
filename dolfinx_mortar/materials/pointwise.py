# SPDX-License-Identifier: MIT
"""Laws that are functions of numbers: NumPy, numba, JAX or anything else that works on arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

import ufl
from dolfinx_mortar.arrays import Bools, Floats
from dolfinx_mortar.materials.compiled import (
    Point,
    compile_vectors,
    constants,
    entries,
    number,
)
from dolfinx_mortar.materials.protocol import Material
from dolfinx_mortar.materials.response import elastic_response
from dolfinx_mortar.materials.tensor import INDEX, from_components


class PointwiseLaw(Material):
    """A law without a closed form: stress, tangent and new state at all points, from arrays.

    A frozen dataclass of parameters like any `Material`, whose `update` replaces energy, stress and
    updated_state. It may stand beside laws in UFL in one solid. There is no energy, so Newton's
    method takes whole steps. `dolfinx_mortar.materials.check` compares its tangent with differences
    of its stress. With JAX, whose derivatives make the tangent (Hooke's law; jax in 64 bits):

        def stress(strain, E, nu):
            G, L = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
            return L * jnp.trace(strain) * jnp.eye(3) + G * (strain + strain.T)

        stresses = jax.jit(jax.vmap(stress))
        tangents = jax.jit(jax.vmap(jax.jacfwd(stress)))

        @dataclass(frozen=True)
        class Hooke(dm.materials.PointwiseLaw):
            E: float
            nu: float
            elastic_stress = staticmethod(dm.Elastic.elastic_stress)

            @staticmethod
            def update(strain, state, p):
                return stresses(strain, p.E, p.nu), tangents(strain, p.E, p.nu), {}

    Attributes:
        pointwise: what tells such a law from one in UFL.
    """

    state: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    linear: ClassVar[bool] = False
    pointwise: ClassVar[bool] = True

    @staticmethod
    def update(
        strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
    ) -> tuple[Any, Any, Mapping[str, Any]]:
        """Return stress, tangent and new internal variables at q points.

        Args:
            strain: (q, 3, 3), symmetric; q may be 0.
            state: committed internal variables, (q,) or (q, 3, 3), not to be changed.
            p: parameters by name, (q,) each.

        Returns:
            Stress (q, 3, 3), tangent d stress_ij / d strain_kl (q, 3, 3, 3, 3) with the symmetry
            ij <-> kl, and the internal variables at the end of the step by name. What does not flow
            should keep its state exactly.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class PointValues:
    """What a pointwise law gives at q points."""

    stress: Floats  # (q, 3, 3)
    tangent: Floats  # (q, 3, 3, 3, 3)
    state: dict[str, Floats]  # (q,) or (q, 3, 3)

    @property
    def undefined(self) -> Bools:
        """At which points (q,) something is NaN or infinite."""
        parts = [self.stress, self.tangent, *self.state.values()]
        found = np.zeros(len(self.stress), dtype=bool)
        for part in parts:
            if not np.isfinite(part.sum()):  # much quicker than to look at each
                found |= ~np.isfinite(part.reshape(len(part), -1)).all(axis=1)
        return found


def values_at_points(
    law: Any, strain: Floats, state: Mapping[str, Floats], p: SimpleNamespace
) -> PointValues:
    """Call a pointwise law at q points, (q, 3, 3) strains.

    Raises:
        ValueError: if it raises, or returns something of another form, name or shape.
    """
    where, q = f"{law.__name__}.update", len(strain)
    try:
        found = law.update(strain, state, p)
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise ValueError(f"{where} raised {what} (at {q} points)") from error
    if not isinstance(found, tuple) or len(found) != 3 or not isinstance(found[2], Mapping):
        raise ValueError(
            f"{where} returns {type(found).__name__}; it must return stress, tangent, new state "
            "(a dictionary by name)."
        )
    stress, tangent, new = found
    if set(new) != set(law.state):
        given, declared = (", ".join(sorted(names)) or "nothing" for names in (new, law.state))
        raise ValueError(f"{where} returns the state {given}, but `state` declares {declared}.")
    return PointValues(
        _shaped(f"{where}: the stress", stress, (q, 3, 3)),
        _shaped(f"{where}: the tangent", tangent, (q, 3, 3, 3, 3)),
        {n: _shaped(f"{where}: {n}", new[n], (q, *shape)) for n, shape in law.state.items()},
    )


def _shaped(what: str, value: Any, shape: tuple[int, ...]) -> Floats:
    """Return an array of the shape, or raise a ValueError."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except Exception as error:
        raise ValueError(f"{what} is a {type(value).__name__}; it must be an array.") from error
    if array.shape != shape:
        raise ValueError(
            f"{what} has the shape {array.shape} at {shape[0]} points; it must be {shape}."
        )
    return array


class PointwiseNumbers:
    """A pointwise law at one point, as `CompiledLaw` is for one in UFL.

    Attributes:
        shapes: stored shape of the internal variables by name, () or (6,).
        has_energy: never.
    """

    has_energy = False

    def __init__(self, law: Any, kind: Any) -> None:
        """Compile the elastic stress; the rest are numbers anyway."""
        self.shapes = {name: (6,) if shape else () for name, shape in kind.state.items()}
        self._law = kind
        names = [field.name for field in dataclasses.fields(law)]
        self._p = {name: number(law, name) for name in names}
        numbers = constants(6 + len(names))
        strain = from_components(ufl.as_vector([numbers[i] for i in range(6)]))
        p = SimpleNamespace(**{name: numbers[6 + i] for i, name in enumerate(names)})
        elastic = elastic_response(kind, strain, p)
        (self._elastic,) = compile_vectors([ufl.as_vector(entries(elastic))])

    def __call__(self, strain: Floats, direction: Floats, state: Mapping[str, Floats]) -> Point:
        """Evaluate the law, see `CompiledLaw`."""
        p = SimpleNamespace(**{name: np.array([value]) for name, value in self._p.items()})
        committed = {
            name: tensor_of(np.atleast_2d(state[name])) if shape else np.atleast_1d(state[name])
            for name, shape in self.shapes.items()
        }
        found = values_at_points(self._law, tensor_of(strain[None]), committed, p)
        change = np.einsum("ijkl,kl->ij", found.tangent[0], tensor_of(direction[None])[0])
        new = {name: stored(v)[0] if v.ndim == 3 else v[0] for name, v in found.state.items()}
        elastic = self._elastic(np.array([*strain, *self._p.values()])).reshape(3, 3)
        return Point(found.stress[0], elastic, change, np.nan, new)


def tensor_of(components: Floats) -> Floats:
    """Return symmetric tensors (q, 3, 3) of stored components (q, 4 or 6).

    >>> tensor_of(np.array([[1.0, 2.0, 3.0, 4.0]]))[0].tolist()
    [[1.0, 4.0, 0.0], [4.0, 2.0, 0.0], [0.0, 0.0, 3.0]]
    """
    tensors = np.zeros((len(components), 3, 3))
    for k, (i, j) in enumerate(INDEX[: components.shape[1]]):
        tensors[:, i, j] = tensors[:, j, i] = components[:, k]
    return tensors


def stored(tensors: Floats, size: int = 6) -> Floats:
    """Return the first `size` (4 or 6) stored components (q, size) of tensors (q, 3, 3)."""
    rows, columns = zip(*INDEX[:size], strict=True)
    return np.asarray((tensors[:, rows, columns] + tensors[:, columns, rows]) / 2)
