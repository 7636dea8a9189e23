# SPDX-License-Identifier: MIT
r"""Paths of bodies within a step that turns them: steady rigid motions, deformed linearly.

Of a step only the start x_0 and the end x_1 are known. The rigid motion between them that fits
best, x -> R x + c, is taken as steady: a rotation about a fixed line (in the plane, a point) with a
shift along it, of which the share t is made at the time t,

    x(t) = R^t ((1 - t) x_0 + t R^-1 x_1).

A corner moves along an arc. Where the rotation is small, paths are straight.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dolfinx_mortar.arrays import Floats

TURN = 10.0
"""Degrees by which a body turns between two times of a path, at most: the chord of an arc leaves it
by 1 - cos(5 degrees) = 0.4 % of the radius, that of two such parts by 1.5 %."""


@dataclass(frozen=True)
class RigidMotion:
    """x -> R x + c."""

    R: Floats  # (d, d)
    c: Floats  # (d,)

    def at(self, x: Floats) -> Floats:
        """Return where points (.., d) arrive."""
        return np.asarray(x @ self.R.T + self.c)

    def back(self, x: Floats) -> Floats:
        """Return where points (.., d) come from."""
        return np.asarray((x - self.c) @ self.R)

    def seen_from(self, other: "RigidMotion") -> "RigidMotion":
        """Return the motion as seen from what makes another one."""
        return RigidMotion(other.R.T @ self.R, other.back(self.c))

    def rotation(self) -> Floats:
        """Return the vector (3,) of the rotation, in radians; in the plane about the third axis."""
        R, d = np.eye(3), len(self.c)
        R[:d, :d] = self.R
        return np.asarray(Rotation.from_matrix(R).as_rotvec())

    def angle(self) -> float:
        """Return the angle of the rotation in degrees."""
        return float(np.degrees(np.linalg.norm(self.rotation())))

    def part(self, t: float) -> "RigidMotion":
        """Return the share t of a steady motion that turns.

        Example:
            >>> quarter = RigidMotion(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([2.0, 0.0]))
            >>> quarter.part(0.5).at(np.array([[1.0, 1.0], [0.0, 0.0]])).round(3).tolist()
            [[1.0, 1.0], [1.0, -0.414]]
        """
        d = len(self.c)
        R = Rotation.from_rotvec(t * self.rotation()).as_matrix()[:d, :d]
        turns = np.eye(d) - self.R
        fixed = np.linalg.pinv(turns) @ self.c  # on the line about which it turns
        along = self.c - turns @ fixed
        return RigidMotion(R, fixed - R @ fixed + t * along)


def rigid_sums(start: Floats, end: Floats) -> Floats:
    """Return the sums over points (n, d) that `best_motion` takes, which add up over ranks."""
    one = np.ones((len(start), 1))
    return np.concatenate([one, start], axis=1).T @ np.concatenate([one, start, end], axis=1)


def best_motion(sums: Floats) -> RigidMotion:
    """Return the rigid motion that fits best (Kabsch 1976), of sums by `rigid_sums`.

    Example:
        >>> x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> found = best_motion(rigid_sums(x, x @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [2.0, 0.0]))
        >>> bool(np.abs(found.at(x) - [[2, 0], [2, 1], [1, 0]]).max() < 1e-12)
        True
    """
    d = len(sums) - 1
    start, end = sums[0, 1 : d + 1] / sums[0, 0], sums[0, d + 1 :] / sums[0, 0]
    products = sums[1:, d + 1 :] - sums[0, 0] * np.outer(start, end)
    U, _, Vt = np.linalg.svd(products.T)
    signs = np.ones(d)
    signs[-1] = np.linalg.det(U @ Vt)
    R = (U * signs) @ Vt
    return RigidMotion(R, end - R @ start)


def times_of(motions: list[RigidMotion]) -> Floats:
    """Return times from 0 to 1 between which no motion turns by more than `TURN`."""
    most = max((motion.angle() for motion in motions), default=0.0)
    return np.asarray(np.linspace(0.0, 1.0, max(int(np.ceil(most / TURN)), 1) + 1), dtype=float)


def path(motion: RigidMotion, times: Floats, start: Floats, end: Floats) -> Floats:
    """Return points (t, .., d) at the times of a path, from those at its start and its end."""
    if motion.angle() <= TURN:
        return np.stack([(1.0 - t) * start + t * end for t in times])
    held = motion.back(end)
    return np.stack([motion.part(t).at((1.0 - t) * start + t * held) for t in times])
