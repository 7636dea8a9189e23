# SPDX-License-Identifier: MIT
"""The demo of laws of one's own: right by themselves, and the same in all versions."""

import importlib.util
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.material_point import MaterialPoint

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "demos" / "own_law" / "own_law.py"
SPEC = importlib.util.spec_from_file_location("own_law", PROGRAM)
demo = sys.modules[SPEC.name] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(demo)

E, NU, Y, K0 = 1000.0, 0.3, 2.0, 4e-3
# JAX is in the environment of docs/build, with which .ci/run runs this file once more.
VERSIONS = ["ufl", "numpy", *(["jax"] if demo.jax else [])]
SHEAR = np.array([[0.0, 1.0, 0.5], [1.0, 0.0, 0.2], [0.5, 0.2, 0.0]])


@pytest.mark.parametrize("version", VERSIONS)
def test_the_law_fits_itself(version):
    report = dm.materials.check(demo.LAWS[version](E, NU, Y, K0, 0.2), size=0.03)
    assert report.changed > 10 and max(report.tangent_error, report.skew) < 1e-8
    assert report.state_error < 1e-14 and report.lowest > 0.0


@pytest.mark.parametrize("version", VERSIONS)
def test_with_the_exponent_one_it_is_linear_hardening(version):
    """On a path that turns: the stress of VonMises with H = Y / k0."""
    point = MaterialPoint(demo.LAWS[version](E, NU, Y, K0, 1.0))
    other = MaterialPoint(dm.VonMises(E, NU, Y, 0.0, Y / K0))
    strain = np.zeros((3, 3))
    for step in np.random.default_rng(2).standard_normal((5, 3, 3)):
        strain = strain + 2e-3 * (step + step.T)
        assert np.abs(point.stress(strain) - other.stress(strain)).max() < 1e-12 * E * 1e-2
        assert np.abs(point.commit() - other.commit()).max() < 1e-15


@pytest.mark.parametrize("version", VERSIONS)
def test_the_stress_follows_the_curve(version, exponent=0.5):
    """In shear that grows the deviator is the radius at k = |ep|, in one step as in seven."""
    found = []
    for steps in (1, 7):
        point = MaterialPoint(demo.LAWS[version](E, NU, Y, K0, exponent))
        for size in np.linspace(0.0, 0.05, steps + 1)[1:]:
            stress = point.stress(size * SHEAR)
            k = np.linalg.norm(point.commit())
            assert np.linalg.norm(stress) == pytest.approx(Y * (1 + k / K0) ** exponent, rel=1e-13)
        assert k > 0.05
        found.append(stress)
    assert np.abs(found[0] - found[1]).max() < 1e-13 * Y


def options(tmp_path, *more):
    given = ["--h", "1.0", "--steps", "2", "--output", str(tmp_path), *more]
    return demo.parser.parse_args(given)


@pytest.mark.serial
@pytest.mark.slow
def test_the_versions_agree(tmp_path, capsys):
    demo.main(options(tmp_path))
    summary = json.loads((tmp_path / "summary.json").read_text())
    versions = {"ufl", "numpy"} | ({"jax"} if demo.jax else set())
    assert set(summary["versions"]) == versions and len(summary["steps"]) == 2
    for found in summary["versions"].values():
        assert max(found[what] for what in ("force", "pressure", "stress")) < demo.AGREEMENT
        assert max(found["newton_iterations"]) < 12 and found["assembly_seconds"] > 0.0
    assert (tmp_path / "own_law.png").stat().st_size > 5000
    said = capsys.readouterr().out
    assert "numpy: Newton iterations" in said and (demo.INSTALL in said) == (demo.jax is None)


def test_the_law_of_the_guide_in_jax_is_that_in_ufl():
    """Stresses of both programs of the page, at one point; without JAX it is asked for."""
    text = (ROOT / "docs" / "guide" / "materials.md").read_text()
    ours, in_jax = (
        program
        for program in re.findall(r"```(?:python|\{code-block\} python)\n(.*?)```", text, re.DOTALL)
        if "class Stiffening" in program
    )
    names, both = {"dm": dm}, compile(ours + in_jax, "guide/materials.md", "exec")
    if demo.jax is None:
        with pytest.raises(ImportError, match="jax"):
            exec(both, names)
        return
    exec(both, names)
    laws = [names[n](E=1000.0, nu=0.3, c=1e5) for n in ("Stiffening", "StiffeningInJax")]
    assert dm.materials.check(laws[1]).tangent_error < 1e-8
    strain = 0.1 * (SHEAR + np.diag([1.0, 2.0, -0.5]))
    one, other = (MaterialPoint(law).stress(strain) for law in laws)
    assert np.abs(one - other).max() < 1e-12 * np.abs(one).max()
