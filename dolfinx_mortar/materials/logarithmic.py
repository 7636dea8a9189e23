# SPDX-License-Identifier: MIT
"""Laws at points, and small-strain laws at finite strain: with a logarithmic strain.

Derivation: theory.md, Small-strain laws at finite strain; P is the dual stress. **Multiplicative
form**, for isotropic laws (`Law.isotropic`), with C_p = F_p^T F_p and 1/2 ln C_p as the plastic
strain of the state:

    E = 1/2 ln(C_p^-1/2 F^T F C_p^-1/2),         psi = psi(E; plastic strain 0, scalars),
    C_p^-1 = C_pn^-1/2 exp(-2 dep) C_pn^-1/2,    dep the plastic strain that the law gives.

**Additive form**, for all others: the law of small strain at E = 1/2 ln(F^T F), exact where the
principal directions do not rotate.

Sources: J. C. Simo, Comput. Methods Appl. Mech. Engrg. 99 (1992) 61-112; C. Miehe, N. Apel, M.
Lambrecht, Comput. Methods Appl. Mech. Engrg. 191 (2002) 5383-5425.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import ufl
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.common.kernels import Kernel, compile_kernel, constants, tabulate
from dolfinx_mortar.materials import logarithms
from dolfinx_mortar.materials.protocol import PLASTIC, Law, grouped
from dolfinx_mortar.materials.response import (
    NORMAL,
    PointValues,
    elastic_response,
    respond,
    solve_normal_strain,
    values_at_points,
)
from dolfinx_mortar.materials.tensor import (
    GRADIENT,
    INDEX,
    from_components,
    from_entries,
    mean_of_shears,
    stored,
    tensor_of,
    to_components,
    upper_triangle,
    von_mises,
)
from ufl.core.expr import Expr

CHUNK = 512  # points per chunk, for the cache


class Start(NamedTuple):
    """Data of q points at the start of a step."""

    numbers: Floats  # (q, n): space for the strain, internal variables, parameters
    roots: Floats  # C_pn^-1/2 - I (q, 3, 3), empty if zero


class CompiledLaw:
    """A law, in UFL or of arrays, as a function of strains at points, of H = F - I if one of F.

    Attributes:
        components: row and column of the k stored entries of strain and stress, zz last in 2D.
    """

    _state: Kernel | None = None  # new internal variables
    _elastic: Kernel | None = None  # C_zzzz in plane stress
    _last: tuple[Floats, PointValues] | None = None  # arguments and values of a law of arrays

    def __init__(
        self,
        law: Law,
        parameters: Sequence[str],
        *,
        dimension: int = 3,
        jit: Callable[[Expr], Kernel] = compile_kernel,
        whole: bool = False,
    ) -> None:
        """Compile a law in UFL; a ValueError if it raises or returns a wrong part.

        Args:
            parameters: their names.
            dimension: 2 if strains are in the plane but for zz.
            jit: compiler of an expression.
            whole: store all entries of strain, stress and tangent, which may be unsymmetric.
        """
        self.law, self._names = replace(law, plane_stress=False), parameters
        self._flat, self._whole, self._finite = law.plane_stress, whole, law.strain == "finite"
        self.has_energy = law.energy is not None and (law.update is None or self._finite)
        self._pairs = INDEX[: 4 if dimension == 2 else 6]
        self._set_entries(dimension)
        if law.update is None:
            self._compile(jit)

    def _set_entries(self, dimension: int) -> None:
        """Set the entries of stress, argument and state, and ij, km of the moduli L_ijkm."""
        normal_last = tuple(sorted(self._pairs, key=lambda pair: pair == (2, 2)))
        self._symmetric = not (self._finite or self._whole)
        self.components = normal_last if self._symmetric else GRADIENT[dimension]
        self._arguments, self._width, self._remembers = self.components, len(self._pairs), False
        self._ways = [(self.components[a], self.components[b]) for a, b in self._places]

    @property
    def _places(self) -> list[tuple[int, int]]:
        """Row and column of the stored entries of the tangent, by the numbers of components."""
        k = len(self.components)
        return [*np.ndindex(k, k)] if self._whole else upper_triangle(k)

    def _compile(self, jit: Callable[[Expr], Kernel]) -> None:
        sizes = [len(self._pairs) if shape else 1 for shape in self._memory.values()]
        law, symmetric, k = self.law, self._symmetric, len(self._arguments)
        rest = iter(list(constants((1 + self._whole) * k + sum(sizes) + len(self._names))))
        strain = from_entries(self._arguments, [next(rest) for _ in range(k)], symmetric)
        state = {PLASTIC: 0 * strain} if self._remembers else {}
        for name, shape in self._memory.items():
            tensor = [next(rest) for _ in self._pairs] if shape else []
            state[name] = from_components(ufl.as_vector(tensor)) if shape else next(rest)
        p = grouped({name: next(rest) for name in self._names})
        response = respond(law, strain, state, p)
        answers = [response.stress[ij] for ij in self._arguments]
        if self._whole:  # of one direction: compiled in a fraction of the time
            change = response.change(from_entries(self._arguments, rest, False))
            answers += [change[ij] for ij in self._arguments]
        else:
            changes = {}
            for i, m in {km: None for _, km in self._ways}:
                share = 0.5 if symmetric and i != m else 1.0  # entries im and mi add up to one
                changes[i, m] = response.change(from_entries([(i, m)], [share], symmetric))
            answers += [changes[km][ij] for ij, km in self._ways]
        answers += [] if response.energy is None else [response.energy]
        new = []
        for name, shape in law.state.items():
            value = response.updated[name]
            new += list(to_components(value, self._width)) if shape else [value]
        self._moduli = jit(ufl.as_vector(answers))
        self._state = jit(ufl.as_vector(new)) if new else None
        if self._flat:
            self._elastic = jit(ufl.as_vector([elastic_response(law, NORMAL, p)[2, 2]]))

    @property
    def _memory(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the internal variables that the law gets."""
        state = self.law.state.items()
        return {name: shape for name, shape in state if not (self._remembers and name == PLASTIC)}

    def start(self, q: int, state: Mapping[str, Floats], parameters: Mapping[str, Floats]) -> Start:
        """Prepare a step of q points; state (q,) or (q, 3, 3), parameters (q,)."""
        columns: list[Floats] = [np.zeros((q, len(self._arguments)))]
        roots = logarithms.roots(state[PLASTIC]) if self._remembers else np.empty((0, 3, 3))
        for name, shape in self._memory.items():
            columns.append(stored(state[name], len(self._pairs)) if shape else state[name][:, None])
        columns += [parameters[name][:, None] for name in self._names]
        return Start(np.ascontiguousarray(np.hstack(columns)), roots)

    def evaluate(self, start: Start, strain: Floats) -> tuple[Floats, Floats, Floats]:
        """`response`; in plane stress condensed, with the strain out of the plane set in place."""
        if not self._flat:
            return self.response(start, strain)
        self.find_normal(start, strain)
        stress, tangent, psi = self.response(start, strain)
        a, b = np.array(self._places).T
        last = b == b[-1], a == b[-1]
        right = tangent[:, last[0]]
        below = tangent[:, last[1]] if self._whole else right
        tangent -= right[:, a] * below[:, b] / right[:, -1:]
        tangent[:, last[0] | last[1]], stress[:, -1] = 0.0, 0.0
        return stress, tangent, psi

    def find_normal(self, start: Start, strain: Floats) -> None:
        """Set zz for stress_zz = 0, NaN if the law is undefined; a ValueError without a root."""

        def equation(points: Ints, z: Floats) -> Sequence[Floats]:
            trial = strain[points]
            trial[:, 2, 2] = z
            some = Start(*(part[points] if len(part) else part for part in start))
            stress, moduli, _ = self.response(some, trial)
            elastic = moduli if self._elastic is None else tabulate(self._elastic, some.numbers)
            stiffest = np.abs(elastic).max(axis=1, initial=0.0)
            return stress[:, -1], moduli[:, -1], stiffest, np.linalg.norm(stress, axis=1)

        found = solve_normal_strain(self.law.name, equation, len(strain), finite=self._finite)
        strain[:, 2, 2] = found

    def response(self, start: Start, strain: Floats) -> tuple[Floats, Floats, Floats]:
        """Stress, tangent and potential at q points.

        Args:
            start: of `start`.
            strain: small strain, or displacement gradient H, (q, 3, 3).

        Returns:
            The k `components` of the stress, or P = d psi / dF (q, k); its derivative, the upper
            triangle row by row (q, k (k + 1) / 2), all (q, k^2) if `whole`; psi (q,), zero without
            a potential.
        """
        k = len(self.components)
        ((_, numbers, _),) = self._prepared(start, strain)
        found = self._answers(numbers)
        psi = found[:, -1] if self.has_energy else np.zeros(len(found))
        return found[:, :k], found[:, k : k + len(self._ways)], psi

    def _prepared(self, start: Start, strain: Floats) -> Iterator[tuple[slice, Floats, Any]]:
        """Chunks of points, with the arguments of the law."""
        rows, columns = np.array(self._arguments).T
        start.numbers[:, : len(rows)] = (strain + np.eye(3) * self._finite)[:, rows, columns]
        yield slice(None), start.numbers, None

    def _answers(self, numbers: Floats) -> Floats:
        """Stress, tangent and psi (if any) of the law; NaN where a law of arrays is undefined."""
        if self.law.update is None and self._whole:
            q, k = len(numbers), len(self._arguments)
            turns = [
                tabulate(self._moduli, np.hstack([numbers, np.tile(D, (q, 1))])) for D in np.eye(k)
            ]
            C = np.stack([found[:, k : 2 * k] for found in turns], axis=2)
            return np.hstack([turns[0][:, :k], C.reshape(q, -1), turns[0][:, 2 * k :]])
        if self.law.update is None:
            return tabulate(self._moduli, numbers)
        found = self._values(numbers)
        T, L = found.stress, found.tangent
        mirrored = L if self._whole else L.transpose(0, 3, 4, 1, 2)
        columns = [T[:, *ij] for ij in self._arguments]
        columns += [(L[:, *ij, *km] + mirrored[:, *ij, *km]) / 2 for ij, km in self._ways]
        columns += [] if found.energy is None else [found.energy]
        answers = np.stack(columns, axis=1)
        answers[found.undefined] = np.nan
        return answers

    def _updated(self, numbers: Floats) -> Floats:
        """Columns of the new internal variables."""
        if self._state is not None:
            return tabulate(self._state, numbers)
        found = self._values(numbers).state.values()
        return np.hstack([stored(v, self._width) if v.ndim == 3 else v[:, None] for v in found])

    def _values(self, numbers: Floats) -> PointValues:
        """Values of a law of arrays."""
        if self._last is not None and np.array_equal(self._last[0], numbers):
            return self._last[1]
        strain, rest = np.split(numbers, [len(self._arguments)], axis=1)
        state: dict[str, Floats] = {}
        if self._remembers:
            state[PLASTIC] = np.zeros((len(numbers), 3, 3))
        for name, shape in self._memory.items():
            part, rest = np.split(rest, [len(self._pairs) if shape else 1], axis=1)
            state[name] = tensor_of(part) if shape else part[:, 0]
        p: dict[str, Floats] = dict(zip(self._names, rest.T, strict=True))
        found = values_at_points(self.law, tensor_of(strain, self._arguments), state, p)
        self._last = numbers.copy(), found
        return found

    def values(
        self, strain: Floats, state: Mapping[str, Floats], p: Mapping[str, Floats]
    ) -> PointValues:
        """Values at a strain, or F, (q, 3, 3), see `response.values_at_points`."""
        change = np.ascontiguousarray(strain - np.eye(3) * self._finite)
        start = self.start(len(strain), state, p)
        found, A, psi = self.evaluate(start, change)
        stress, tangent = as_tensors(found, A, self.components, self._places)
        return PointValues(
            stress,
            tangent if self._finite else mean_of_shears(tangent),
            self.update(start, change, state),
            psi if self.has_energy else None,
        )

    def update(
        self, start: Start, strain: Floats, state: Mapping[str, Floats]
    ) -> dict[str, Floats]:
        """New internal variables, (q,) or (q, 3, 3), of those at the start."""
        new = {name: np.array(values) for name, values in state.items()}
        for some, numbers, parts in self._prepared(start, strain) if new else ():
            columns = self._updated(numbers)
            for name, shape in self.law.state.items():
                part, columns = np.split(columns, [self._width if shape else 1], axis=1)
                if name == PLASTIC and self._remembers:
                    old, g = state[name][some], start.roots[some]
                    new[name][some] = logarithms.flow(old, part, g, parts[2])
                else:
                    new[name][some] = tensor_of(part) if shape else part[:, 0]
        return new


class LogarithmicLaw(CompiledLaw):
    """A small-strain law, in UFL or of arrays, as a function of H = F - I at points.

    Attributes:
        multiplicative: the form; else additive.
    """

    def _set_entries(self, dimension: int) -> None:
        law, pairs = self.law, self._pairs
        self._symmetric = self._finite = True
        self.multiplicative, self.components = law.isotropic, GRADIENT[dimension]
        self._remembers = self.multiplicative and PLASTIC in law.state  # by the roots
        self._arguments = INDEX[:3] if law.isotropic else pairs  # of a law in its eigenvectors
        self._width = len(self._arguments)
        # each computed once
        ways = (sorted(way, key=INDEX.index) for way in product(self._arguments, repeat=2))
        self._ways = [(ij, km) for ij, km in ways]
        if law.isotropic:
            self._ways += [(pair, pair) for pair in pairs[3:]]
        self._vectors, self._tensors = np.empty((2, CHUNK, 3)), np.empty((3, CHUNK, 3, 3))

    def response(self, start: Start, strain: Floats) -> tuple[Floats, Floats, Floats]:
        """P, dP/dF and psi, see `CompiledLaw`; where det F <= 0, psi = inf, others NaN."""
        q, k = len(strain), len(self.components)
        P, A, psi = np.empty((q, k)), np.empty((q, k * (k + 1) // 2)), np.zeros(q)
        for some, numbers, parts in self._prepared(start, strain):
            found = self._answers(numbers)
            how = self._pairs, self.multiplicative, found
            logarithms.respond(*how, *parts, P[some], A[some])
            if self.has_energy:
                psi[some] = np.where(np.isnan(parts[0][:, 0]), np.inf, found[:, -1])
        return P, A, psi

    def _prepared(self, start: Start, strain: Floats) -> Iterator[tuple[slice, Floats, Any]]:
        """Chunks of points, with the arguments of the law and `logarithms.decompose`."""
        for first in range(0, len(strain), CHUNK):
            some = slice(first, min(first + CHUNK, len(strain)))
            parts = [part[: some.stop - first] for part in (*self._vectors, *self._tensors)]
            logarithms.decompose(strain[some], start.roots[some], *parts)
            _, logs, N, _, _ = parts
            numbers = start.numbers[some]
            if self.multiplicative:
                numbers[:, :3] = logs
            else:
                logarithms.compose_stored(self._pairs, N, logs, numbers)
            yield some, numbers, parts

    def stress_lost(self, start: Start, H: Floats) -> Floats:
        """Return 1 - |dev tau| / |dev T| (q,), zero where T is."""
        P = tensor_of(self.response(start, H)[0], self.components)
        tau, kept = von_mises(stored(P @ np.swapaxes(H + np.eye(3), 1, 2))), np.ones(len(H))
        for some, numbers, _ in self._prepared(start, H):
            T = von_mises(self._answers(numbers)[:, : len(self._pairs)])
            np.divide(tau[some], T, out=kept[some], where=T > 0.0)
        return 1 - kept


def as_tensors(
    P: Floats, A: Floats, components: Sequence[tuple[int, int]], places: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """P (q, 3, 3) and dP/dF (q, 3, 3, 3, 3) of components, and of places of the moduli."""
    q, k, at = len(P), len(components), np.array(components) @ [3, 1]
    number, (a, b), tangent = np.empty((k, k), dtype=int), np.array(places).T, np.zeros((q, 9, 9))
    number[b, a] = np.arange(len(a))
    number[a, b] = np.arange(len(a))
    tangent[:, at[:, None], at] = A[:, number]
    return tensor_of(P, components), tangent.reshape(q, 3, 3, 3, 3)
