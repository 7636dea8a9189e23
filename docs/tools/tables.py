# SPDX-License-Identifier: MIT
"""Make the verification manual and the performance page from files of numbers; none is typed."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
MEASURED = DOCS.parent / "benchmarks" / "measured"
PAGES = DOCS / "generated"


VERIFICATION = """\
# Verification manual

Version {version}. `containers/run python3 docs/tools/verification.py` solves these problems with
the code of the tests and demos, and writes `docs/verification.json`; this page is that file. A
difference is that of two numbers, both of which have errors: references assume half spaces and
small strains, or are themselves results on meshes, as each source says.

{cases}
"""
PERFORMANCE = """\
# Performance

Made from the files in `benchmarks/measured`, which the benchmarks write (`--output`). Machine:
{machine}.

:::{{warning}}
{clock}
:::

## Which element

The plastic Hertz problem at 0.2 mm in one step (`elements.py`); errors are against triangles of
degree 2 on a finer mesh.

{elements}

```{{image}} ../../benchmarks/measured/elements.png
:alt: Error of the contact force against unknowns and time
```

## A contact step in 2D

Ratios within one run (`hertz_2d.py`). Mortar: from search to change of basis, over one
factorisation of the tangent without contact. Step: the first step over the cost of its
factorisations and assemblies alone. Memory: its peak over that of a program that only factorises.
The last column names ratios beyond the limits of the benchmark.

{in_plane}

## A contact step in 3D

A quarter of a ball on a block, hexahedra, conjugate gradients with multigrid (`sphere_3d.py`).

{in_space}

## Friction

A disc and a quarter of a ball, pressed on a block and then pushed sideways with mu = 0.2, over the
step in which they are pressed without friction (`friction.py`, CPU times of one run in turns).

{friction}

## Mortar operators in 3D

Search, cutting, D, M and T of two tied blocks (`mortar_3d.py`).

{operators}

## A quadratic program

In units of one factorisation (`qp_reuse.py`): without a factorisation at the start, and again for a
tangent that has changed.

{reuse}

## More ranks

An elasto-plastic step (`scaling_3d.py`), as many unknowns a rank:

{weak}

The same problem on one rank and two:

{strong}

### From 4 ranks to 1000

```{{include}} ../../benchmarks/README.md
:start-after: "<!-- many ranks -->"
```
"""


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown, numbers to the right.

    >>> print(table(["a", "b"], [["x", 1.5]]))
    | a | b |
    |---|--:|
    | x | 1.5 |
    """
    rows = [list(row) for row in rows]
    numeric = [bool(rows) and not isinstance(cell, str) for cell in rows[0]]
    lines = [head, ["--:" if number else "---" for number in numeric]]
    shown = ["| " + " | ".join(lines[0]) + " |", "|" + "|".join(lines[1]) + "|"]
    return "\n".join([*shown, *("| " + " | ".join(map(said, row)) + " |" for row in rows)])


def said(value: Any) -> str:
    """Return a number to five digits.

    >>> said(2425.467), said(0.46291), said(3), said("x"), said(181407)
    ('2425.5', '0.46291', '3', 'x', '181 407')
    """
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ") if value >= 10_000 else str(value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def difference(reference: float, ours: float) -> str:
    """Return the relative difference.

    >>> difference(10.0, 10.05), difference(10.0, 10.0 + 1e-12)
    ('+0.50 %', '+1e-11 %')
    """
    percent = 100.0 * (ours / reference - 1.0)
    return f"{percent:+.2f} %" if abs(percent) >= 5e-3 or percent == 0 else f"{percent:+.0e} %"


def verification(path: Path) -> str:
    """Return the page of the verification manual."""
    found = json.loads(path.read_text())
    parts = []
    for case in found["cases"]:
        rows = [
            [
                *(r["quantity"], r["unit"] or "–", r["reference"], r["ours"]),
                difference(r["reference"], r["ours"]),
            ]
            for r in case["rows"]
        ]
        head = ["quantity", "unit", "reference", "ours", "difference"]
        parts += [f"## {case['problem']}", f"Reference: {case['source']}.", table(head, rows)]
    return VERIFICATION.format(version=found["version"], cases="\n\n".join(parts))


def elements(found: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table of elements."""
    best = found["reference"][0] if "reference" in found else None
    rows = []
    for name, sizes in found.items():
        for r in sizes if name != "reference" else []:
            row = [name, r["h"], r["unknowns"], r["newton"], round(r["seconds"], 1)]
            row += [difference(best["force"], r["force"])] if best else [r["force"]]
            rows.append(row)
    last = "force against the reference" if best else "force [N/mm]"
    return table(["element", "h [mm]", "unknowns", "Newton", "seconds", last], rows)


def scaling(rows: list[dict[str, Any]], *, clock: bool) -> str:
    """Return a table of ranks, with the time by the clock unless ranks have taken turns."""
    head = ["ranks", "unknowns", "CPU s a rank", *["clock s"] * clock, "Newton", "CG"]
    head += ["messages a rank", "MB a rank", "reductions"]
    return table(
        head,
        [
            [
                *(r["ranks"], r["unknowns"], round(r["cpu"], 1)),
                *[round(r["wall"], 1)] * clock,
                *(r["newton"], r["krylov"]),
                *(int(r["messages"]), round(r["bytes"] / 1e6), int(r["reductions"])),
            ]
            for r in rows
        ],
    )


def steps_in_space(rows: list[dict[str, Any]]) -> str:
    """Return the table of contact steps in 3D."""
    kinds = ("elastic", "updated", "plastic")
    head = ["unknowns", "step", "Newton", "CG", "multigrid set-ups", "seconds"]
    return table(
        head,
        [
            [
                *(r["unknowns"], kind),
                *(r[kind][name] for name in ("newton", "krylov", "set_ups")),
                round(r[kind]["seconds"], 1),
            ]
            for r in rows
            for kind in kinds
        ],
    )


def steps_in_plane(found: dict[str, dict[str, Any]]) -> str:
    """Return the table of contact steps in 2D."""
    rows = [
        [
            *(" ".join(name.split()[2:]), r["dofs"], r["iterations"], r["factorisations"]),
            *(round(r["ratios"][part], 2) for part in ("mortar", "step", "memory")),
            ", ".join(r["missed"]) or "–",
        ]
        for name, r in found.items()
        if "ratios" in r
    ]
    head = ["law, geometry, slave", "unknowns", "Newton", "factorisations", "mortar", "step"]
    return table([*head, "memory", "beyond its limit"], rows)


def friction(found: dict[str, dict[str, Any]]) -> str:
    """Return the table of steps with friction over those without."""
    head = ["problem", "unknowns", "step", "Newton", "with", "linear", "with", "time over without"]
    rows = [
        [
            *(name, r["unknowns"], r["step"]),
            *(r[kind]["newton"] for kind in ("without", "with")),
            *(r[kind]["krylov"] for kind in ("without", "with")),
            round(r["ratio"], 2),
        ]
        for name, case in found.items()
        for r in case["steps"]
    ]
    memory = "; ".join(
        f"{name} {case['memory'][1] / case['memory'][0]:.2f}" for name, case in found.items()
    )
    return f"{table(head, rows)}\n\nPeak memory over that without: {memory}."


def rounded(rows: list[dict[str, Any]], name: str, digits: int) -> list[dict[str, Any]]:
    """Return rows with one entry rounded.

    >>> rounded([{"a": 1.26, "b": 2}], "a", 1)
    [{'a': 1.3, 'b': 2}]
    """
    return [row | {name: round(row[name], digits)} for row in rows]


def reuse(rows: list[dict[str, Any]]) -> str:
    """Return the table of quadratic programs."""
    names = ["unknowns", "active/bounded", "ratio", "solves", "factorisations"]
    names += ["next solves", "next factorisations"]
    return table(names, [[r[name] for name in names] for r in rounded(rows, "ratio", 1)])


def operators(rows: list[dict[str, Any]]) -> str:
    """Return the table of mortar operators."""
    head = ["slave nodes", "unknowns", "µs a node", "mortar over linear solve", "CG"]
    return table(
        head,
        [
            [
                *(r["slave_nodes"], r["unknowns"], round(r["microseconds_per_node"])),
                *(f"{r['mortar_over_linear']:.1%}", r["krylov"]),
            ]
            for r in rows
        ],
    )


def performance(folder: Path) -> str:
    """Return the page of the benchmarks."""

    def load(name: str) -> Any:
        return json.loads((folder / f"{name}.json").read_text())

    conditions, ranks = load("conditions"), load("scaling_3d")
    return PERFORMANCE.format(
        **conditions,
        elements=elements(load("elements")),
        in_plane=steps_in_plane(load("hertz_2d")),
        in_space=steps_in_space(load("sphere_3d")),
        friction=friction(load("friction")),
        operators=operators(load("mortar_3d")),
        reuse=reuse(load("qp_reuse")["rows"]),
        weak=scaling(ranks["weak"], clock=False),
        strong=scaling(ranks["strong"], clock=True),
    )


if __name__ == "__main__":
    PAGES.mkdir(exist_ok=True)
    (PAGES / "verification.md").write_text(verification(DOCS / "verification.json"))
    (PAGES / "performance.md").write_text(performance(MEASURED))
