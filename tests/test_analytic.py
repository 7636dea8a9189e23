# SPDX-License-Identifier: MIT
"""Closed solutions against published numbers, equilibrium and independent quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from dolfinx_mortar import analytic

STEEL = (206_900.0, 0.29, 206_900.0, 0.29)


@pytest.mark.parametrize(
    ("force", "radius", "materials", "half_width", "peak", "digits"),
    [
        (10.0, 8.0, (200.0, 0.3, 200.0, 0.3), 0.96277, 6.61240, (5e-6, 5e-6)),
        (10.0, (8.0, 8.0), (200.0, 0.3, 200.0, 0.3), 0.68078, 9.35135, (5e-6, 5e-6)),
        (2425.4, 8.0, STEEL, 0.46769, 3301.6, (5e-5, 0.1)),
    ],
)
def test_line_contact_numbers(force, radius, materials, half_width, peak, digits):
    c = analytic.hertz_line(force, radius, *materials)
    assert c.half_width == pytest.approx(half_width, abs=digits[0])
    assert c.peak_pressure == pytest.approx(peak, abs=digits[1])


def test_point_contact_numbers():
    c = analytic.hertz_point(117808.787, (6.1237, 6.1237), 1e8, 0.29, 1e6, 0.29)
    assert c.contact_radius == pytest.approx(0.63018, abs=5e-6)
    assert c.peak_pressure == pytest.approx(1.41642e5, rel=5e-6)


def test_pressures_carry_the_force():
    line = analytic.hertz_line(142.9, 8.0, *STEEL)
    a = line.half_width
    total, _ = quad(line.pressure, -a, a)
    assert total == pytest.approx(142.9, rel=1e-8)
    point = analytic.hertz_point(142.9, 8.0, *STEEL)
    total, _ = quad(lambda r: 2 * np.pi * r * point.pressure(r), 0.0, point.contact_radius)
    assert total == pytest.approx(142.9, rel=1e-8)
    assert line.pressure([-1.01 * a, 2 * a]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("z", [0.1, 0.7, 2.5])
def test_axis_stress_is_flamant_superposed(z):
    """Integrate the field of a line force on a half-plane over the Hertz pressure."""

    def below(i):
        def density(t):  # x = sin t, so that the square-root end points are smooth
            x, weight = np.sin(t), np.cos(t) ** 2
            return -2 / np.pi * weight * (x**2 * z, z**3)[i] / (x**2 + z**2) ** 2

        return quad(density, -np.pi / 2, np.pi / 2)[0]

    s = analytic.line_axis_stress(z, 0.29)
    assert s[:2] == pytest.approx([below(0), below(1)], rel=1e-8)
    assert s[2] == pytest.approx(0.29 * (s[0] + s[1]))


@pytest.mark.parametrize(
    ("nu", "ratio", "depth"), [(0.3, 0.5575, 0.704), (0.29, 0.5615, 0.696), (0.1, 0.8, 0)]
)
def test_first_yield_ratio_and_depth(nu, ratio, depth):
    """Published; below nu = 0.194 at the surface, where it is 1 - 2 nu."""
    y = analytic.first_yield_line(450.0, 8.0, 206_900.0, nu, 206_900.0, nu)
    assert y.ratio == pytest.approx(ratio, abs=1e-4)
    assert y.depth / y.half_width == pytest.approx(depth, abs=1e-3)
    assert y.peak_pressure == pytest.approx(450.0 / y.ratio, rel=1e-12)


def test_first_yield_of_the_benchmark():
    y = analytic.first_yield_line(450.0, 8.0, *STEEL)
    numbers = (y.peak_pressure, y.half_width, y.force, y.depth)
    assert numbers == pytest.approx((801.4, 0.11353, 142.9, 0.0790), rel=1e-3)
    hertz = analytic.hertz_line(y.force, 8.0, *STEEL)
    assert hertz.half_width == pytest.approx(y.half_width, rel=1e-12)
    assert hertz.peak_pressure == pytest.approx(y.peak_pressure, rel=1e-12)


def test_fit_recovers_exact_and_noisy_distributions():
    c = analytic.hertz_line(2425.4, 8.0, *STEEL)
    x = np.linspace(-0.44, 0.45, 19)
    exact = analytic.fit_pressure(x, c.pressure(x))
    assert exact == pytest.approx((c.peak_pressure, c.half_width), rel=1e-12)
    noise = 1 + 0.01 * np.random.default_rng(1).standard_normal(len(x))
    noisy = analytic.fit_pressure(x, c.pressure(x) * noise)
    assert noisy == pytest.approx((c.peak_pressure, c.half_width), rel=0.02)
    assert noisy != pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("wrong", [0.0, 2.0])
def test_fit_leaves_out_the_edge(wrong):
    """Whatever the pressure of the two outermost nodes is; not where they lie well inside."""
    c = analytic.hertz_line(2425.4, 8.0, *STEEL)
    x = np.linspace(-0.98 * c.half_width, 0.98 * c.half_width, 15)
    p = c.pressure(x)
    p[[0, -1]] *= wrong
    exact = pytest.approx((c.peak_pressure, c.half_width), rel=1e-12)
    assert analytic.fit_pressure(x, p) == exact
    x = np.linspace(-0.85 * c.half_width, 0.85 * c.half_width, 9)
    p = c.pressure(x)
    p[[0, -1]] *= 1.02
    assert analytic.fit_pressure(x, p) == pytest.approx((c.peak_pressure, c.half_width), rel=0.02)
    assert analytic.fit_pressure(x, p) != exact


@pytest.mark.parametrize(
    ("x", "p"), [([], []), ([0.0], [1.0]), ([-1.0, 1.0], [2.0, 2.0]), ([0.0, 1.0], [1.0, 2.0])]
)
def test_fit_of_too_little_is_nan(x, p):
    assert np.isnan(analytic.fit_pressure(x, p)).all()


LINE, POINT, YIELD = analytic.hertz_line, analytic.hertz_point, analytic.first_yield_line
WRONG = [
    *((LINE, (v, 8.0, *STEEL), "force") for v in (-1.0, True)),
    *((LINE, (1.0, v, *STEEL), "radius") for v in (0.0, (8.0, 8.0, 8.0))),
    (LINE, (1.0, (2.0, -2.0), *STEEL), "radius"),
    (LINE, (1.0, 8.0, np.inf, 0.3, np.inf, 0.3), "E1"),
    (LINE, (1.0, 8.0, 1.0, 0.5, 1.0, 0.3), "nu1"),
    (LINE, (1.0, 8.0, 1.0, 0.3, 1.0, np.nan), "nu2"),
    (POINT, (1.0, (2.0, -2.0), *STEEL), "radius"),
    (YIELD, (-1.0, 8.0, *STEEL), "yield_stress"),
]
FIT = analytic.fit_pressure
CASES = [
    *((f, arguments, rf"^{name} is ") for f, arguments, name in WRONG),
    *((analytic.line_axis_stress, (v, 0.3), "^depth is ") for v in (None, [0.1, -1])),
    (analytic.line_axis_stress, (1.0, 0.5), r"^nu is 0\.5:"),
    (FIT, ([0.0, 1.0], [1.0]), "finite numbers"),
    (FIT, ([0.0, 1.0], [1.0, None]), "^p is "),
    (FIT, (None, [1.0]), "^x is "),
]


@pytest.mark.parametrize(("function", "arguments", "words"), CASES)
def test_bad_numbers_are_named(function, arguments, words):
    with pytest.raises(ValueError, match=words):
        function(*arguments)
