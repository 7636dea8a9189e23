# SPDX-License-Identifier: MIT
"""Faults that are put into the package, one at a time: its tests must find them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# A module, a part of its text, what stands there instead, and the tests that then fail.
FAULTS = [
    (
        "interfaces/contact_tangent",
        "change -= link.coupling.R[:, :, :1] * along[:, None]",
        "change += link.coupling.R[:, :, :1] * along[:, None]",
        "test_tangent",
    ),
    (
        "interfaces/tool",
        "return 0.5 * (forth + back)",
        "return forth",
        "test_obstacle",
    ),
    (
        "interfaces/results",
        'return moment - np.cross(self._resultant("place"), whole)',
        'return moment + np.cross(self._resultant("place"), whole)',
        "test_obstacle",
    ),
    (
        "interfaces/contact",
        "return (left >= MIN_FREE_NORMAL)[:, None]",
        "return (left > 0.0)[:, None]",
        "test_numbers_of_steps",
    ),
    (
        "interfaces/tie",
        "return nearest + WITHIN * sizes",
        "return WITHIN * sizes",
        "test_tie_reach",
    ),
    (
        "interfaces/tie",
        "if not around and float(axis @ normal) < -ALONG * length:",
        "if not around and float(axis @ normal) < -length:",
        "test_pretension",
    ),
    (
        "mortar/curvature_correction",
        "K -= 0.5 * np.trace(K, axis1=1, axis2=2)[:, None, None] * tangential",
        "K -= 0.25 * np.trace(K, axis1=1, axis2=2)[:, None, None] * tangential",
        "test_smooth_3d",
    ),
    (
        "mortar/duals",
        "pulls = keep & (force <= LEAST_COVERAGE * weights[0])",
        "pulls = keep & (force <= -weights[0])",
        "test_mortar",
    ),
    (
        "mortar/integrals",
        "room = np.minimum(1.5, 8.0 * rise / np.maximum(length, TINY))",
        "room = np.minimum(1.5, 2.0 * rise / np.maximum(length, TINY))",
        "test_tangent",
    ),
    (
        "mortar/passing",
        "signs = np.ones(d)\n    signs[-1] = np.linalg.det(U @ Vt)",
        "signs = np.ones(d)",
        "test_passing",
    ),
    (
        "mortar/self_contact",
        "settled |= (own == other) & known & (distance > then / 2)",
        "settled |= (own == other) & known",
        "test_self_contact",
    ),
    (
        "mortar/tangent",
        "e[..., None] * e[:, :, None] / -2.0",
        "e[..., None] * e[:, :, None] / -4.0",
        "test_tangent",
    ),
    (
        "mortar/facing_bodies",
        "reach = facing.size.max(axis=1, initial=0.0) if within is None else within",
        "reach = facing.size.min(axis=1, initial=np.inf) if within is None else within",
        "test_pairs",
    ),
    (
        "geometry/curvature",
        "higher = ((K_y @ to_y) ** 2).sum(axis=2) * (K_y * y).sum(axis=2) / 8",
        "higher = ((K_y @ to_y) ** 2).sum(axis=2) * (K_y * y).sum(axis=2) / 4",
        "test_smooth",
    ),
    (
        "geometry/line",
        "if distance < least and depth <= deepest[c]:",
        "if distance < least:",
        "test_edges",
    ),
    (
        "geometry/moments",
        "rate = -reach[:, 1:] / np.where((part > 0.0) & (part < 1.0), part, np.inf)",
        "rate = -reach[:, 1:] / np.where(part > 0.0, part, np.inf)",
        "test_tangent",
    ),
    (
        "geometry/flat",
        "hit &= depth > HALF_OF_DIGITS * size[a]",
        "hit &= np.abs(depth) > HALF_OF_DIGITS * size[a]",
        "test_self_contact",
    ),
    ("qp/bound_qp", "and self.feasibility <= length", "and self.feasibility >= 0.0", "test_qp"),
    (
        "qp/scalars",
        "law = replace(law, rest=law.rest + law.pick(way))",
        "law = replace(law, rest=law.rest - law.pick(way))",
        "test_driven_tools",
    ),
    (
        "qp/linear",
        "if round_off <= max(QUARTER_OF_DIGITS * force, UNDERFLOW):",
        "if True:",
        "test_linear",
    ),
    (
        "materials/elastic",
        '"nu23^2 < E2 / E3": p.nu23**2 < p.E2 / p.E3',
        '"nu23^2 < E2 / E3": p.nu23**2 < p.E3 / p.E2',
        "test_materials",
    ),
    (
        "materials/plasticity",
        "flow = (2 * shear_modulus(p) + p.a) / 2 * g**2 + (p.Y - norm) * g",
        "flow = (2 * shear_modulus(p) + p.a) * g**2 + (p.Y - norm) * g",
        "test_law_check",
    ),
    (
        "solid/forms",
        "return [not np.array_equal(*pair) for pair in zip(now, self.complete(), strict=True)]",
        "return [not np.array_equal(now[0], self.complete()[0])] * len(now)",
        "test_eigenstrain",
    ),
    ("solid/laws", "return J * P * inverse", "return P * inverse", "test_eigenstrain"),
    (
        "steps/failures",
        "return driven or problem.terms.assemble_forces(problem.K.createVecLeft()) > 0.0",
        "return driven or problem.terms.assemble_forces(problem.K.createVecLeft()) >= 0.0",
        "test_finite_strain",
    ),
    (
        "steps/ramp",
        "if min(levels) < first - slack or max(levels) > last + slack:",
        "if min(levels) < first - slack:",
        "test_ramp",
    ),
    (
        "shapes/primitives",
        "found = flank.where(s * across.value + c * height > 0.0, tip)",
        "found = flank.where(height > 0.0, tip)",
        "test_shapes",
    ),
    (
        "shapes/shape",
        "return Distance(found.value, found.gradient, found.hessian - rest)",
        "return Distance(found.value, found.gradient, found.hessian)",
        "contracts/test_shapes",
    ),
    ("terms/inertia", "x = x + self._owned(self.solid.u)", "x = 1.0 * x", "test_impact"),
    (
        "terms/loads",
        "share = 2 if solid.kinematics.radius is None and d == 2 else 3",
        "share = d",
        "test_finite_loads",
    ),
    (
        "solid/supports",
        "for form in (held, touching - uneven):",
        "for form in (held, touching):",
        "test_audit",
    ),
    (
        "persistence/checkpoints",
        'other = tables[POINTS]["material"] != material_numbers(state.solid)',
        "other = np.zeros(1)",
        "test_checkpoint_errors",
    ),
    (
        "persistence/checkpoints",
        "if off > SAME * np.abs(b).max(initial=0.0):",
        "if off > np.abs(b).max(initial=0.0):",
        "test_checkpoint_errors",
    ),
    (
        "common/agreement",
        "return [leaf for leaf in leaves if not isinstance(leaf, str)] if known else None",
        "return [leaf for leaf in leaves if not isinstance(leaf, str)]",
        "test_ramp",
    ),
    (
        "analytic",
        "beyond = shares > np.append(1.0, shares[:-1]) + HALF_OF_DIGITS",
        "beyond = shares > 1.0 + HALF_OF_DIGITS",
        "test_partial_slip",
    ),
]
ALL = pytest.mark.parametrize(
    ("module", "text", "fault", "tests"), FAULTS, ids=[f"{k}-{f[0]}" for k, f in enumerate(FAULTS)]
)


@ALL
@pytest.mark.serial
def test_the_text_of_a_fault_is_there_once(module, text, fault, tests):
    assert (ROOT / "dolfinx_mortar" / f"{module}.py").read_text().count(text) == 1
    assert text != fault and (ROOT / "tests" / f"{tests}.py").exists()


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Return a copy of package and tests, in which compiled kernels are kept."""
    folder = tmp_path_factory.mktemp("faults")
    for name in ("dolfinx_mortar", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


@ALL
@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.serial
def test_a_fault_is_found(copy, module, text, fault, tests):
    file = copy / "dolfinx_mortar" / f"{module}.py"
    given = file.read_text()
    kernels = [f for f in copy.rglob("*.py") if "numba" in f.read_text()]

    def write(source):
        file.write_text(source)
        for kernel in kernels if file in kernels else ():  # others may contain those of the file
            os.utime(kernel)

    write(given.replace(text, fault))
    call = [sys.executable, "-m", "pytest", "-q", "-x", f"tests/{tests}.py"]
    try:
        assert subprocess.run(call, cwd=copy, check=False).returncode == 1
    finally:
        write(given)
