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
from scipy.optimize import brentq, minimize_scalar

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
        """Return dy/dt under plastic loading."""
        m = self.direction(strain, y)
        Cm = self.elastic(m)
        speed = max(np.sum(Cm * rate), 0.0) / (np.sum(m * Cm) + self.a + self.slope(y[9]))
        return np.append(speed * m, speed)  # |dev m| = 1

    def onset(self, start: np.ndarray, rate: np.ndarray, y: np.ndarray) -> float:
        """Return when the leg start + t rate, t from 0 to 1, begins to flow; inf if never."""

        def f(t: float) -> float:
            return self.excess(start + t * rate, y)

        scale = self.radius(y[9])
        lowest = minimize_scalar(f, bounds=(0.0, 1.0), method="bounded").x  # f is convex
        if f(0.0) > -1e-9 * scale and np.sum(self.direction(start, y) * self.elastic(rate)) > 0:
            return 0.0
        return np.inf if f(1.0) <= 0 else brentq(f, lowest, 1.0, xtol=1e-15, rtol=1e-14)

    def integrate(self, path: list[np.ndarray]) -> np.ndarray:
        """Return plastic strain and k, (10,), after straight legs between the strains."""
        y = np.zeros(10)
        for start, end in itertools.pairwise(path):
            rate = end - start
            if (begin := self.onset(start, rate, y)) < 1.0:

                def flow(t: float, y: np.ndarray, start=start, rate=rate) -> np.ndarray:
                    return self.flow(start + t * rate, rate, y)

                y = solve_ivp(flow, (begin, 1.0), y, "DOP853", rtol=1e-12, atol=1e-16).y[:, -1]
        return y
