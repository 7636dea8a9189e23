# SPDX-License-Identifier: MIT
"""Plane, axisymmetric or spatial problems as one frozen record."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import ufl
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arguments import Rule, check
from dolfinx_mortar.common.arrays import ROUND_OFF, Bools, Floats
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_coefficients
from ufl.core.expr import Expr


@dataclass(frozen=True)
class Kinematics:
    """Strain of a displacement, and volume of the integrals."""

    name: str
    measure: Callable[[Expr], Expr]  # displacement -> strain, 3x3
    # coordinates -> volume per integrated area or volume, such as 1; of UFL and of NumPy (d, q)
    weight: Callable[[Any], Any]
    # (n, d) -> name: (n, d), affine, without strain; closed under changes of centre and unit
    rigid_motions: Callable[[Floats], dict[str, Floats]]
    dimension: int | None = None  # of its meshes, None for any
    # index of the coordinate r >= 0; at r = 0 this displacement must be prescribed
    radius: int | None = None
    # whether the laws solve sigma_zz = 0 for the strain out of the plane
    plane_stress: bool = False
    # near null space for multigrid, like `rigid_motions` (the default)
    nearly_rigid: Callable[[Floats], dict[str, Floats]] | None = None
    # displacement -> deformation gradient F, 3x3; None without finite strain
    gradient: Callable[[Expr], Expr] | None = None
    finite: bool = False  # whether the measure is F

    def of_finite_strain(self) -> "Kinematics":
        """These kinematics with the measure F, whose work-conjugate stress is P.

        Raises:
            ValueError: without a deformation gradient.
        """
        if self.gradient is None:
            raise ValueError(
                "strain is 'finite', which is for the kinematics 'plane strain', 'plane stress', "
                f"'axisymmetric' and 'spatial', or with a gradient: {self.name!r} has none; give "
                "Kinematics(..., gradient=), displacement -> F (3x3)"
            )
        name = f"{self.name}, finite strain"
        return dataclasses.replace(self, name=name, measure=self.gradient, finite=True)

    def strain(self, u: Expr) -> Expr:
        """Strain at u; of F the Green-Lagrange strain."""
        measured = self.measure(u)
        if not self.finite:
            return measured
        return (ufl.transpose(measured) * measured - ufl.Identity(3)) / 2

    def virtual(self, u: Expr, v: Expr) -> Expr:
        """Strain of v at u, d measure(u)/du [v]."""
        return ufl.derivative(self.measure(u), u, v)

    def linear_in(self, u: Expr) -> bool:
        """Whether the strain is linear in u."""
        virtual = self.virtual(u, ufl.TestFunction(u.function_space))
        return u not in extract_coefficients(expand_derivatives(virtual))

    @property
    def unweighted(self) -> bool:
        """Whether the weight is known to be 1."""
        return self.weight is _unit

    def weights_at(self, points: Floats) -> Floats:
        """Weight (q,) at points (q, d); 0 on an axis up to round-off.

        Raises:
            ValueError: for a weight that fails, or is negative or NaN.
        """
        try:
            values = np.asarray(self.weight(points.T), dtype=np.float64)
            weights = np.array(np.broadcast_to(values, len(points)))
        except Exception as error:
            raise ValueError(
                f"kinematics {self.name!r}: the weight raised {type(error).__name__}; it has to "
                "work with UFL and with NumPy coordinates (d, q), such as 2 * pi * x[0]"
            ) from error
        sizes = np.abs(weights).max(initial=0.0), np.abs(points).max(initial=0.0)
        good = weights >= -ROUND_OFF * max(sizes)
        if not good.all():
            raise ValueError(
                f"kinematics {self.name!r}: the weight is negative or NaN at "
                f"{int((~good).sum())} of {len(points)} points; it is a volume"
            )
        return np.maximum(weights, 0.0)


def _plane(u: Expr, hoop: Any = 0) -> Expr:
    g = ufl.grad(u)
    return ufl.as_tensor([[g[0, 0], g[0, 1], 0], [g[1, 0], g[1, 1], 0], [0, 0, hoop]])


def _ring(u: Expr) -> Expr:
    """H, 3x3, of the displacement (u_r, u_z), in the order r, z, theta."""
    return _plane(u, u[0] / ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))[0])


def _of_gradient(name: str, H: Callable[[Expr], Expr], dimension: int, **others: Any) -> Kinematics:
    others = {"weight": _unit, "rigid_motions": translations_and_rotations} | others
    return Kinematics(
        name,
        lambda u: ufl.sym(H(u)),
        gradient=lambda u: ufl.Identity(3) + H(u),
        dimension=dimension,
        **others,
    )


def _unit(x: Any) -> int:
    """Forces are per thickness in the plane."""
    return 1


def translations_and_rotations(x: Floats) -> dict[str, Floats]:
    """The 3 (in the plane) or 6 (in space) rigid motions at points x, (n, d).

    Rotations are right-handed about axes through the origin, of one radian per unit.

    >>> motions = translations_and_rotations(np.array([[2.0, 1.0]]))
    >>> list(motions)
    ['translation x', 'translation y', 'rotation about z']
    >>> motions["rotation about z"].tolist()
    [[-1.0, 2.0]]
    """
    n, d = x.shape
    motions = {f"translation {'xyz'[i]}": np.tile(np.eye(d)[i], (n, 1)) for i in range(d)}
    for i, j in [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]:
        spin = np.zeros((n, d))
        spin[:, i], spin[:, j] = -x[:, j], x[:, i]
        motions[f"rotation about {'xyz'[3 - i - j]}"] = spin
    return motions


plane_strain = _of_gradient("plane strain", _plane, 2)
plane_stress = dataclasses.replace(plane_strain, name="plane stress", plane_stress=True)
axisymmetric = _of_gradient(
    "axisymmetric",
    _ring,
    2,
    weight=lambda x: 2 * np.pi * x[0],  # forces are those of the whole ring
    rigid_motions=lambda x: {"translation along the axis": np.tile([0.0, 1.0], (len(x), 1))},
    radius=0,
    # u_r / r is small compared with the gradients; without these, iterations grow with the mesh
    nearly_rigid=translations_and_rotations,
)
spatial = _of_gradient("spatial", ufl.grad, 3)
KINEMATICS = {
    kind.name.replace(" ", "_"): kind
    for kind in (plane_strain, plane_stress, axisymmetric, spatial)
}
"""What users may choose by name."""


def choose_kinematics(given: Any, d: int) -> Kinematics:
    """Kinematics by name or as given; the default of the dimension d for None.

    Raises:
        ValueError: for an unknown name, or kinematics of another dimension.
    """
    if given is None:
        given = plane_strain if d == 2 else spatial
    names = [name for name, k in KINEMATICS.items() if k.dimension == d]
    choices = f"choose {' or '.join(map(repr, names))}, or give a Kinematics"
    chosen = KINEMATICS.get(given) if isinstance(given, str) else given
    fits = isinstance(chosen, Kinematics) and chosen.dimension in (None, d)
    rule = Rule(f"on a mesh in {d}D {choices}", lambda _: chosen if fits else None)
    return check("kinematics", getattr(given, "name", given), rule)


def on_axis(kinematics: Kinematics, mesh: Mesh, x: Floats) -> Bools:
    """Mask (n,) of points (n, d) on the axis, if there is one; collective."""
    if kinematics.radius is None:
        return np.zeros(len(x), dtype=bool)
    size = float(maximum(mesh.comm, np.abs(mesh.geometry.x).max(initial=0.0))[0])
    return np.asarray(np.abs(x[:, kinematics.radius]) <= ROUND_OFF * size)


def check_radius(kinematics: Kinematics, mesh: Mesh) -> None:
    """Raise a ValueError on all ranks for negative radii; collective."""
    if kinematics.radius is None:
        return
    x, i = np.asarray(mesh.geometry.x, dtype=np.float64), kinematics.radius
    beyond = (x[:, i] < 0.0) & ~on_axis(kinematics, mesh, x)
    farthest = float(maximum(mesh.comm, -x[beyond, i].min(initial=0.0))[0])
    if farthest > 0.0:
        raise ValueError(
            f"kinematics {kinematics.name!r}: the mesh has nodes at r = x[{i}] < 0, down to "
            f"{-farthest:.4g}; it must be the half of the section on which r >= 0, with the axis "
            f"at x[{i}] = 0"
        )
