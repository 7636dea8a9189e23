"""What a notebook shows of reports, audits and materials."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hertz_case import ELASTIC, create_case, create_mesh

import dolfinx_mortar as dm
from dolfinx_mortar.html import items, table


def parsed(shown):
    """Return the tree of well-formed HTML without scripts and colours."""
    text = shown._repr_html_()
    assert not any(word in text for word in ("<script", "color", "background", "onclick"))
    return ET.fromstring(f"<div>{text}</div>")


def texts(tree):
    return [text for text in tree.itertext() if text.strip()]


def test_all_texts_are_escaped():
    bad = "<script>alert('&')</script>"
    for text in (table(bad, [(bad, bad)], (bad, bad)), items([bad])):
        tree = ET.fromstring(f"<div>{text}</div>")
        assert texts(tree).count(bad) == (5 if "table" in text else 1)
        assert tree.find(".//script") is None
    assert items([]) == ""


def test_numbers_are_short():
    tree = ET.fromstring(table("t", [(1, 123456, 2.0 / 3.0, np.float64(1e-9), True, 206900.0)]))
    assert texts(tree)[1:] == ["1", "123456", "0.6667", "1e-09", "True", "2.069e+05"]


@dataclass(frozen=True)
class Own(dm.Material):
    E: float
    state: ClassVar = {}
    linear: ClassVar = True


@pytest.mark.parametrize(
    ("law", "shown"),
    [
        (dm.Elastic(E=2.0, nu=0.3), ["Elastic", "E", "2", "nu", "0.3"]),
        (dm.VonMises(E=2.0, nu=0.3, Y=1.0, a=0.5), ["VonMises", "Y", "0.5", "H"]),
        (dm.VonMisesVoce(E=2, nu=0.3, Y=1, a=0, H=0, Q=1, b=7), ["VonMisesVoce", "b", "7"]),
        (dm.DruckerPrager(E=2.0, nu=0.3, Y=1.0, beta=0.25), ["DruckerPrager", "beta", "0.25"]),
        (Own(E=8.0), ["Own", "E", "8"]),
    ],
)
def test_materials_show_their_parameters(law, shown):
    found = texts(parsed(law))
    assert found[0] == shown[0] and set(shown) <= set(found)


def test_reports_and_audits_show_what_print_shows():
    case = create_case(create_mesh("graded", 0.5), ELASTIC)
    tree = parsed(case.problem.audit())
    assert len(tree.findall(".//tr")) == 2 and str(case.contact) in texts(tree)
    case.press(0.01)
    report = dm.newton(case.problem)
    report.notes.append("a < b")
    tree = parsed(report)
    captions = [c.text for c in tree.findall(".//caption")]
    assert captions[0].startswith(f"converged in {report.newton_iterations} Newton iterations")
    assert captions[1:] == ["certificate", "seconds"]
    rows = tree.find("table").findall(".//tr")
    assert len(rows) == 1 + report.newton_iterations
    assert rows[-1][1].text == f"{report.iterations[-1].increment:.4g}"
    assert "note: a < b" in texts(tree) and "newton iterations" in texts(tree)
    unfinished = dm.StepReport(notes=["no certificate"])
    assert parsed(unfinished).find(".//li").text == "note: no certificate"
