# SPDX-License-Identifier: MIT
"""Small-strain laws at finite strain: functions of a logarithmic strain, with its dual stress as P.

Derivation: theory.md, Small-strain laws at finite strain. **Multiplicative form**, for isotropic
laws (`Law.isotropic`), with C_p = F_p^T F_p and 1/2 ln C_p as the plastic strain of the state:

    E = 1/2 ln(C_p^-1/2 F^T F C_p^-1/2),         psi = psi(E; plastic strain 0, scalars),
    C_p^-1 = C_pn^-1/2 exp(-2 dep) C_pn^-1/2,    dep the plastic strain that the law gives.

**Additive form**, for all others: the law of small strain at E = 1/2 ln(F^T F), exact where the
principal directions do not rotate.

Sources: J. C. Simo, Comput. Methods Appl. Mech. Engrg. 99 (1992) 61-112; C. Miehe, N. Apel, M.
Lambrecht, Comput. Methods Appl. Mech. Engrg. 191 (2002) 5383-5425.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

import ufl
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.kernels import Kernel, compile_kernel, constants, tabulate
from dolfinx_mortar.materials import logarithms
from dolfinx_mortar.materials.protocol import PLASTIC, Law, grouped, ungrouped
from dolfinx_mortar.materials.response import (
    PointValues,
    Response,
    respond,
    solve_normal_strain,
    values_at_points,
)
from dolfinx_mortar.materials.tensor import (
    GRADIENT,
    INDEX,
    from_components,
    stored,
    tensor_of,
    to_components,
)
from ufl.core.expr import Expr

CHUNK = 512  # points per chunk, for the cache
NORMAL = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # ab of L_aabb


@dataclass(frozen=True)
class Start:
    """Data of q points at the start of a step."""

    state: Mapping[str, Floats]  # committed, (q,) or (q, 3, 3)
    parameters: Mapping[str, Floats]
    roots: Floats | None  # C_pn^-1/2 - I (q, 3, 3), if not zero
    numbers: Floats  # (q, n) arguments of a law in UFL, with space for the strain

    def at(self, points: Ints) -> "Start":
        """Data of some points."""
        state, parameters = (
            {name: values[points] for name, values in of.items()}
            for of in (self.state, self.parameters)
        )
        roots = None if self.roots is None else self.roots[points]
        numbers = self.numbers[points] if len(self.numbers) else self.numbers
        return Start(state, parameters, roots, numbers)


class LogarithmicLaw:
    """A small-strain law as a function of H = F - I at points.

    Attributes:
        multiplicative: the form; else additive.
        components: row and column of k nonzero entries of P.
    """

    def __init__(
        self,
        law: Law,
        parameters: Sequence[str],
        *,
        dimension: int = 3,
        jit: Callable[[Expr], Kernel] = compile_kernel,
    ) -> None:
        """Compile a law in UFL; a ValueError if it raises or returns a wrong part.

        Args:
            parameters: their names.
            dimension: 2 if H is in the plane but for H_zz.
            jit: compiler of an expression.
        """
        self.law, self.multiplicative = law, law.isotropic
        self.has_energy = law.energy is not None and law.update is None
        self.components = GRADIENT[dimension]
        self._pairs = INDEX[: 4 if dimension == 2 else 6]
        kind = _InUFL if law.update is None else _OfArrays
        self._inner: _InUFL | _OfArrays = kind(law, list(parameters), len(self._pairs), jit)
        self._vectors = np.empty((2, CHUNK, 3))
        self._tensors = np.empty((3, CHUNK, 3, 3))

    def start(self, q: int, state: Mapping[str, Floats], parameters: Mapping[str, Floats]) -> Start:
        """Prepare a step of q points; state (q,) or (q, 3, 3), parameters (q,)."""
        roots = None
        if self.multiplicative and PLASTIC in self.law.state:
            roots = np.empty_like(state[PLASTIC])
            logarithms.roots(state[PLASTIC], roots)
        numbers = self._inner.numbers(q, state, parameters)
        return Start(state, parameters if self.law.update else {}, roots, numbers)

    def respond(self, start: Start, H: Floats, P: Floats, A: Floats, psi: Floats) -> None:
        """Fill stress, tangent and potential at q points; where det F <= 0, psi = inf, others NaN.

        Args:
            start: of `start`.
            H: displacement gradient (q, 3, 3).
            P: d psi / dF, the k `components` (q, k).
            A: dP / dF, its upper triangle row by row (q, k (k + 1) / 2).
            psi: (q,), per volume at X; unchanged without a potential.
        """
        for some in _chunks(len(H)):
            parts = self._decompose(start, H[some], some)
            x, logs, N = parts[:3]
            found = self._inner.moduli(start, some, logs, N)
            logarithms.respond(self._pairs, self.multiplicative, found, *parts, P[some], A[some])
            if self.has_energy:
                psi[some] = np.where(np.isnan(x[:, 0]), np.inf, found[:, -1])

    def find_normal(self, start: Start, H: Floats) -> None:
        """Set H_zz for P_zz = 0, NaN if the law is undefined; a ValueError without a root."""
        k = len(self.components)
        c = self.components.index((2, 2))
        last = _upper(k).index((c, c))

        def equation(points: Ints, z: Floats) -> Floats:
            trial = H[points]
            trial[:, 2, 2] = z[:, 0]
            q = len(points)
            P, A, psi = np.empty((q, k)), np.empty((q, k * (k + 1) // 2)), np.empty(q)
            self.respond(start.at(points), trial, P, A, psi)
            stiffest, norm = np.abs(A).max(axis=1, initial=0.0), np.linalg.norm(P, axis=1)
            return np.stack([P[:, c], A[:, last], stiffest, norm], axis=1)[:, None]

        H[:, 2, 2] = solve_normal_strain(self.law.name, equation, (len(H), 1), finite=True)[:, 0]

    def condense(self, P: Floats, A: Floats) -> None:
        """Convert stress and tangent to plane stress, in place."""
        k, c = len(self.components), self.components.index((2, 2))
        number = {pair: t for t, pair in enumerate(_upper(k))}
        with_normal = [A[:, number[min(a, c), max(a, c)]].copy() for a in range(k)]
        for (a, b), t in number.items():
            A[:, t] -= with_normal[a] * with_normal[b] / with_normal[c]
            if c in (a, b):
                A[:, t] = 0.0
        P[:, c] = 0.0

    def update(self, start: Start, H: Floats) -> dict[str, Floats]:
        """New internal variables, (q,) or (q, 3, 3)."""
        new = {name: np.array(values) for name, values in start.state.items()}
        for some in _chunks(len(H)) if new else ():
            _, logs, N, _, _ = self._decompose(start, H[some], some)
            for name, values in self._inner.update(start, some, logs, N).items():
                if name == PLASTIC and start.roots is not None:
                    old, roots = start.state[name][some], start.roots[some]
                    logarithms.flow(old, values, roots, N, new[name][some])
                else:
                    new[name][some] = values
        return new

    def values(self, F: Floats, state: Mapping[str, Floats], p: SimpleNamespace) -> PointValues:
        """Values at F (q, 3, 3), see `response.values_at_points`."""
        q, k = len(F), len(self.components)
        H = np.ascontiguousarray(F - np.eye(3))
        P, A, psi = np.empty((q, k)), np.empty((q, k * (k + 1) // 2)), np.empty(q)
        start = self.start(q, state, ungrouped(p))
        self.respond(start, H, P, A, psi)
        stress, tangent = as_tensors(P, A, self.components)
        energy = psi if self.has_energy else None
        return PointValues(stress, tangent, self.update(start, H), energy=energy)

    def stress_lost(self, start: Start, H: Floats) -> Floats:
        """Return 1 - |dev tau| / |dev T| (q,), 0 in the multiplicative form, T the law's stress."""
        share = np.zeros(len(H))
        for some in () if self.multiplicative else _chunks(len(H)):
            x, logs, N, _, _ = self._decompose(start, H[some], some)
            found = self._inner.moduli(start, some, logs, N)
            logarithms.lost(self._pairs, found, x, logs, N, share[some])
        return share

    def _decompose(self, start: Start, H: Floats, some: slice) -> list[Floats]:
        parts = [part[: len(H)] for part in (*self._vectors, *self._tensors)]
        roots = _NONE if start.roots is None else start.roots[some]
        logarithms.decompose(H, roots, start.roots is None, *parts)
        return parts


def as_tensors(
    P: Floats, A: Floats, components: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """P (q, 3, 3) and dP/dF (q, 3, 3, 3, 3) of components and the upper triangle."""
    stress, tangent = np.zeros((len(P), 3, 3)), np.zeros((len(P), 3, 3, 3, 3))
    for n, entry in enumerate(components):
        stress[:, *entry] = P[:, n]
    for t, (a, b) in enumerate(_upper(len(components))):
        first, second = components[a], components[b]
        tangent[:, *first, *second] = tangent[:, *second, *first] = A[:, t]
    return stress, tangent


_NONE = np.zeros((1, 3, 3))


def _upper(k: int) -> list[tuple[int, int]]:
    return [(a, b) for a in range(k) for b in range(a, k)]


def _chunks(q: int) -> list[slice]:
    return [slice(i, min(i + CHUNK, q)) for i in range(0, q, CHUNK)]


def _answers(
    law: Law, size: int
) -> tuple[Sequence[tuple[int, int]], list[tuple[int, int, int, int]]]:
    pairs = INDEX[:size]
    if not law.isotropic:
        return pairs, [(*pairs[a], *pairs[b]) for a, b in _upper(size)]
    ways = [(i, i, j, j) for i, j in NORMAL] + [(i, j, i, j) for i, j in pairs[3:]]
    return INDEX[:3], ways


class _InUFL:
    """A law in UFL, compiled."""

    def __init__(
        self, law: Law, parameters: list[str], size: int, jit: Callable[[Expr], Kernel]
    ) -> None:
        self._law, self._names, self._size = law, parameters, size
        self._width = 3 if law.isotropic else size
        self._memory = {
            name: shape
            for name, shape in law.state.items()
            if not (law.isotropic and name == PLASTIC)
        }
        response = self._response()
        index, ways = _answers(law, size)
        changes = {pair: response.change(_unit(*pair)) for pair in INDEX[:size]}
        answers = [response.stress[pair] for pair in index]
        answers += [changes[k, m][i, j] for i, j, k, m in ways]
        if response.energy is not None:
            answers.append(response.energy)
        new = []
        for name, shape in law.state.items():
            value = response.updated[name]
            new += list(to_components(value, self._width)) if shape else [value]
        self._moduli = jit(ufl.as_vector(answers))
        self._state = jit(ufl.as_vector(new)) if new else None

    def numbers(
        self, q: int, state: Mapping[str, Floats], parameters: Mapping[str, Floats]
    ) -> Floats:
        """Arguments (q, n): strain, internal variables, parameters."""
        columns: list[Floats] = [np.zeros((q, self._width))]
        for name, shape in self._memory.items():
            columns.append(stored(state[name], self._size) if shape else state[name][:, None])
        columns += [parameters[name][:, None] for name in self._names]
        return np.ascontiguousarray(np.hstack(columns))

    def moduli(self, start: Start, some: slice, logs: Floats, N: Floats) -> Floats:
        """T, L and (if any) psi, see `logarithms`."""
        return tabulate(self._moduli, self._at(start, some, logs, N))

    def update(self, start: Start, some: slice, logs: Floats, N: Floats) -> dict[str, Floats]:
        assert self._state is not None
        found, first = tabulate(self._state, self._at(start, some, logs, N)), 0
        new = {}
        for name, shape in self._law.state.items():
            width = self._width if shape else 1
            part, first = found[:, first : first + width], first + width
            whole = name in self._memory
            new[name] = part[:, 0] if not shape else tensor_of(part) if whole else part.copy()
        return new

    def _at(self, start: Start, some: slice, logs: Floats, N: Floats) -> Floats:
        numbers = start.numbers[some]
        if self._law.isotropic:
            numbers[:, :3] = logs
        else:
            logarithms.compose_stored(N, logs, self._size, numbers)
        return numbers

    def _response(self) -> Response:
        sizes = [self._size if shape else 1 for shape in self._memory.values()]
        count = self._width + sum(sizes) + len(self._names)
        numbers = constants(count)
        rest = (numbers[i] for i in range(count))
        e = [next(rest) for _ in range(self._width)]
        state = {}
        for (name, shape), size in zip(self._memory.items(), sizes, strict=True):
            parts = [next(rest) for _ in range(size)]
            state[name] = from_components(ufl.as_vector(parts)) if shape else parts[0]
        p = grouped({name: next(rest) for name in self._names})
        if not self._law.isotropic:
            return respond(self._law, from_components(ufl.as_vector(e)), state, p)
        if PLASTIC in self._law.state:
            state[PLASTIC] = ufl.as_tensor([[0] * 3] * 3)
        strain = ufl.as_tensor([[e[i] if i == j else 0 for j in range(3)] for i in range(3)])
        return respond(self._law, strain, state, p)


class _OfArrays:
    """A law of arrays, with the methods of `_InUFL`."""

    def __init__(self, law: Law, parameters: list[str], size: int, jit: Any) -> None:
        self._law, self._size = law, size

    def numbers(
        self, q: int, state: Mapping[str, Floats], parameters: Mapping[str, Floats]
    ) -> Floats:
        return np.empty((0, 0))

    def moduli(self, start: Start, some: slice, logs: Floats, N: Floats) -> Floats:
        """T and L, see `logarithms`."""
        found = self._values(start, some, logs, N)
        T, L = found.stress, found.tangent
        index, ways = _answers(self._law, self._size)
        columns = [T[:, i, j] for i, j in index]
        columns += [(L[:, i, j, k, m] + L[:, k, m, i, j]) / 2 for i, j, k, m in ways]
        return np.stack(columns, axis=1)

    def update(self, start: Start, some: slice, logs: Floats, N: Floats) -> dict[str, Floats]:
        new = self._values(start, some, logs, N).state
        if self._law.isotropic and PLASTIC in new:
            new[PLASTIC] = np.ascontiguousarray(new[PLASTIC][:, range(3), range(3)])
        return new

    def _values(self, start: Start, some: slice, logs: Floats, N: Floats) -> PointValues:
        state = {name: values[some] for name, values in start.state.items()}
        p = grouped({name: values[some] for name, values in start.parameters.items()})
        strain = np.zeros((len(logs), 3, 3))
        if self._law.isotropic:
            strain[:, range(3), range(3)] = logs
            if PLASTIC in state:
                state[PLASTIC] = np.zeros_like(state[PLASTIC])
        else:
            strain[:] = np.einsum("qia,qa,qja->qij", N, logs, N)
        return values_at_points(self._law, strain, state, p)


def _unit(i: int, j: int) -> Expr:
    """Symmetric tensor whose entries ij and ji add up to one."""
    entries = [[0.0] * 3 for _ in range(3)]
    entries[i][j] += 0.5
    entries[j][i] += 0.5
    return ufl.as_tensor(entries)
