# SPDX-License-Identifier: MIT
"""Rate equations of associated plasticity, integrated with adaptive steps, as references of laws.

Elastic C, yield function f(sigma, ep, k) <= 0, flow direction m = df/dsigma, hardening h:

    dep = m (m : C deps) / (m : C m + h),   dk = |dep_dev|   where f = 0 and m : C deps > 0.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

IDENTITY = np.eye(3)


def deviator(tensor: np.ndarray) -> np.ndarray:
    return tensor - np.trace(tensor) / 3 * IDENTITY


@dataclass(frozen=True)
class Rates:
    """|dev sigma - a ep| + beta tr(sigma)/3 <= radius(k)."""

    E: float
    nu: float
    radius: Callable[[float], float]
    slope: Callable[[float], float] = lambda k: 0.0  # of the radius
    a: float = 0.0
    beta: float = 0.0

    def elastic(self, strain: np.ndarray) -> np.ndarray:
        mu, bulk = self.E / (2 * (1 + self.nu)), self.E / (3 * (1 - 2 * self.nu))
        return bulk * np.trace(strain) * IDENTITY + 2 * mu * deviator(strain)

    def excess(self, strain: np.ndarray, y: np.ndarray) -> float:
        """Return the yield function for plastic strain and k in y, (10,)."""
        ep = y[:9].reshape(3, 3)
        stress = self.elastic(strain - ep)
        size = np.linalg.norm(deviator(stress) - self.a * deviator(ep))
        return float(size + self.beta * np.trace(stress) / 3 - self.radius(y[9]))

    def direction(self, strain: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return m."""
        ep = y[:9].reshape(3, 3)
        shifted = deviator(self.elastic(strain - ep)) - self.a * deviator(ep)
        return shifted / np.linalg.norm(shifted) + self.beta / 3 * IDENTITY

    def flow(self, strain: np.ndarray, rate: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return dy/dt."""
        if self.excess(strain, y) < -1e-8 * self.radius(y[9]):
            return np.zeros(10)
        m = self.direction(strain, y)
        Cm = self.elastic(m)
        speed = max(np.sum(Cm * rate), 0.0) / (np.sum(m * Cm) + self.a + self.slope(y[9]))
        return np.append(speed * m, speed)  # |dev m| = 1

    def integrate(self, path: list[np.ndarray]) -> np.ndarray:
        """Return plastic strain and k, (10,), after straight legs between the strains."""
        y = np.zeros(10)
        for start, end in itertools.pairwise(path):

            def flow(t: float, y: np.ndarray, start=start, rate=end - start) -> np.ndarray:
                return self.flow(start + t * rate, rate, y)

            y = solve_ivp(flow, (0.0, 1.0), y, "DOP853", rtol=1e-9, atol=1e-12).y[:, -1]
        return y
