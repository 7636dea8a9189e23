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

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import ufl
from dolfinx_mortar.common.arrays import Floats, Ints
from dolfinx_mortar.common.kernels import Kernel, compile_kernel, constants, tabulate
from dolfinx_mortar.materials import logarithms
from dolfinx_mortar.materials.protocol import PLASTIC, Law, grouped
from dolfinx_mortar.materials.response import (
    PointValues,
    normal_equation,
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
    upper_triangle,
    von_mises,
)
from ufl.core.expr import Expr

CHUNK = 512  # points per chunk, for the cache


class Start(NamedTuple):
    """Data of q points at the start of a step."""

    numbers: Floats  # (q, n): space for the strain, internal variables, parameters
    roots: Floats  # C_pn^-1/2 - I (q, 3, 3), empty if zero


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
        self.law, self.multiplicative, self._names = law, law.isotropic, parameters
        self.has_energy = law.energy is not None and law.update is None
        self.components = GRADIENT[dimension]
        self._pairs = pairs = INDEX[: 4 if dimension == 2 else 6]
        self._remembers = self.multiplicative and PLASTIC in law.state  # by the roots
        self._strains = INDEX[:3] if law.isotropic else pairs  # of a law in its eigenvectors
        # ij, km of L_ijkm, each computed once
        self._ways = [
            tuple(sorted(way, key=INDEX.index)) for way in product(self._strains, repeat=2)
        ]
        if law.isotropic:
            self._ways += [(pair, pair) for pair in pairs[3:]]
        self._vectors, self._tensors = np.empty((2, CHUNK, 3)), np.empty((3, CHUNK, 3, 3))
        if law.update is None:
            self._compile(jit)

    def _compile(self, jit: Callable[[Expr], Kernel]) -> None:
        sizes = [len(self._pairs) if shape else 1 for shape in self._memory.values()]
        numbers = constants(len(self._strains) + sum(sizes) + len(self._names))
        law, columns = self.law, list(numbers)
        strain, state, p = self._arguments(columns, lambda c: from_components(ufl.as_vector(c)))
        response = respond(law, strain, state, grouped(p))
        changes = {pair: response.change(_unit(*pair)) for pair in self._pairs}
        answers = [response.stress[pair] for pair in self._strains]
        answers += [changes[km][ij] for ij, km in self._ways]
        answers += [] if response.energy is None else [response.energy]
        new = []
        for name, shape in law.state.items():
            value = response.updated[name]
            new += list(to_components(value, len(self._strains))) if shape else [value]
        self._moduli = jit(ufl.as_vector(answers))
        self._state = jit(ufl.as_vector(new)) if new else None

    @property
    def _memory(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the internal variables that the law gets."""
        state = self.law.state.items()
        return {name: shape for name, shape in state if not (self._remembers and name == PLASTIC)}

    def _arguments(self, columns: Sequence[Any], tensor: Callable[[list[Any]], Any]) -> Any:
        """Strain, state and parameters of the law of columns of numbers."""
        rest = iter(columns)
        strain = tensor([next(rest) for _ in self._strains])
        state = {PLASTIC: 0 * strain} if self._remembers else {}
        for name, shape in self._memory.items():
            state[name] = tensor([next(rest) for _ in self._pairs]) if shape else next(rest)
        return strain, state, dict(zip(self._names, rest, strict=True))

    def start(self, q: int, state: Mapping[str, Floats], parameters: Mapping[str, Floats]) -> Start:
        """Prepare a step of q points; state (q,) or (q, 3, 3), parameters (q,)."""
        columns: list[Floats] = [np.zeros((q, len(self._strains)))]
        roots = np.empty((q if self._remembers else 0, 3, 3))
        if self._remembers:
            logarithms.roots(state[PLASTIC], roots)
        for name, shape in self._memory.items():
            columns.append(stored(state[name], len(self._pairs)) if shape else state[name][:, None])
        columns += [parameters[name][:, None] for name in self._names]
        return Start(np.ascontiguousarray(np.hstack(columns)), roots)

    def response(self, start: Start, H: Floats) -> tuple[Floats, Floats, Floats]:
        """Stress, tangent and potential at q points; where det F <= 0, psi = inf, others NaN.

        Args:
            start: of `start`.
            H: displacement gradient (q, 3, 3).

        Returns:
            P = d psi / dF, the k `components` (q, k); dP / dF, its upper triangle row by row (q, k
            (k + 1) / 2); psi (q,), per volume at X, zero without a potential.
        """
        q, k = len(H), len(self.components)
        P, A, psi = np.empty((q, k)), np.empty((q, k * (k + 1) // 2)), np.zeros(q)
        for some, numbers, parts in self._decomposed(start, H):
            found = self._answers(numbers)
            how = self._pairs, self.multiplicative, found
            logarithms.respond(*how, *parts, P[some], A[some])
            if self.has_energy:
                psi[some] = np.where(np.isnan(parts[0][:, 0]), np.inf, found[:, -1])
        return P, A, psi

    def _decomposed(self, start: Start, H: Floats) -> Iterator[tuple[slice, Floats, list[Floats]]]:
        """Chunks of points, with the arguments of the law and `logarithms.decompose`."""
        for first in range(0, len(H), CHUNK):
            some = slice(first, min(first + CHUNK, len(H)))
            parts = [part[: some.stop - first] for part in (*self._vectors, *self._tensors)]
            logarithms.decompose(H[some], start.roots[some], *parts)
            _, logs, N, _, _ = parts
            numbers = start.numbers[some]
            if self.multiplicative:
                numbers[:, :3] = logs
            else:
                logarithms.compose_stored(self._pairs, N, logs, numbers)
            yield some, numbers, parts

    def _answers(self, numbers: Floats) -> Floats:
        """T, L and psi (if any), see `logarithms`."""
        if self.law.update is None:
            return tabulate(self._moduli, numbers)
        found = self._values(numbers)
        T, L = found.stress, found.tangent
        columns = [T[:, i, j] for i, j in self._strains]
        columns += [(L[:, *ij, *km] + L[:, *km, *ij]) / 2 for ij, km in self._ways]
        return np.stack(columns, axis=1)

    def _values(self, numbers: Floats) -> PointValues:
        """Values of a law of arrays."""
        arguments = self._arguments(list(numbers.T), lambda c: tensor_of(np.stack(c, axis=1)))
        return values_at_points(self.law, *arguments)

    def find_normal(self, start: Start, H: Floats) -> None:
        """Set H_zz for P_zz = 0, NaN if the law is undefined; a ValueError without a root."""

        def equation(points: Ints, z: Floats) -> Floats:
            trial = H[points]
            trial[:, 2, 2] = z[:, 0]
            some = Start(*(part[points] if len(part) else part for part in start))
            P, A, _ = self.response(some, trial)
            return normal_equation(P, A)

        H[:, 2, 2] = solve_normal_strain(self.law.name, equation, (len(H), 1), finite=True)[:, 0]

    def condense(self, P: Floats, A: Floats) -> None:
        """Convert stress and tangent to plane stress, in place."""
        a, b = np.array(upper_triangle(len(self.components))).T
        normal = A[:, b == b[-1]]
        A -= normal[:, a] * normal[:, b] / normal[:, -1:]
        A[:, b == b[-1]], P[:, -1] = 0.0, 0.0

    def update(self, start: Start, H: Floats, state: Mapping[str, Floats]) -> dict[str, Floats]:
        """New internal variables, (q,) or (q, 3, 3), of those at the start."""
        new = {name: np.array(values) for name, values in state.items()}
        width = len(self._strains)
        for some, numbers, (_, _, N, _, _) in self._decomposed(start, H) if new else ():
            if self.law.update is None:
                assert self._state is not None
                columns = tabulate(self._state, numbers)
            else:
                found = self._values(numbers).state
                columns = np.hstack(
                    [stored(v, width) if v.ndim == 3 else v[:, None] for v in found.values()]
                )
            for name, shape in self.law.state.items():
                part, columns = np.split(columns, [width if shape else 1], axis=1)
                if name == PLASTIC and self._remembers:
                    part, old = np.ascontiguousarray(part), state[name][some]
                    logarithms.flow(old, part, start.roots[some], N, new[name][some])
                else:
                    new[name][some] = tensor_of(part) if shape else part[:, 0]
        return new

    def values(
        self, F: Floats, state: Mapping[str, Floats], p: Mapping[str, Floats]
    ) -> PointValues:
        """Values at F (q, 3, 3), see `response.values_at_points`."""
        H = np.ascontiguousarray(F - np.eye(3))
        start = self.start(len(F), state, p)
        P, A, psi = self.response(start, H)
        energy = psi if self.has_energy else None
        new = self.update(start, H, state)
        return PointValues(*as_tensors(P, A, self.components), new, energy=energy)

    def stress_lost(self, start: Start, H: Floats) -> Floats:
        """Return 1 - |dev tau| / |dev T| (q,), zero where T is."""
        P, _ = as_tensors(*self.response(start, H)[:2], self.components)
        tau, kept = von_mises(stored(P @ np.swapaxes(H + np.eye(3), 1, 2))), np.ones(len(H))
        for some, numbers, _ in self._decomposed(start, H):
            T = von_mises(self._answers(numbers)[:, : len(self._pairs)])
            np.divide(tau[some], T, out=kept[some], where=T > 0.0)
        return 1 - kept


def as_tensors(
    P: Floats, A: Floats, components: Sequence[tuple[int, int]]
) -> tuple[Floats, Floats]:
    """P (q, 3, 3) and dP/dF (q, 3, 3, 3, 3) of components and the upper triangle."""
    stress, tangent = np.zeros((len(P), 3, 3)), np.zeros((len(P), 3, 3, 3, 3))
    for n, entry in enumerate(components):
        stress[:, *entry] = P[:, n]
    for t, (a, b) in enumerate(upper_triangle(len(components))):
        first, second = components[a], components[b]
        tangent[:, *first, *second] = tangent[:, *second, *first] = A[:, t]
    return stress, tangent


def _unit(i: int, j: int) -> Expr:
    """Symmetric tensor whose entries ij and ji add up to one."""
    entries = [[0.0] * 3 for _ in range(3)]
    entries[i][j] += 0.5
    entries[j][i] += 0.5
    return ufl.as_tensor(entries)
