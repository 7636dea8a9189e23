# SPDX-License-Identifier: MIT
"""Run examples and demos, and make a page of each: text and program, pictures, script, notebook.

What they have written is kept in docs/_build/demos until one or the library changes. The tutorial
is run, too, for its pictures.
"""

import ast
import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
KEPT, PAGES = DOCS / "_build" / "demos", DOCS / "generated" / "gallery"


@dataclass(frozen=True)
class Demo:
    """How a demo, or an example, is run and shown."""

    name: str
    short: str  # for the card
    pictures: dict[str, str]  # file -> caption; the first is that of the card
    options: tuple[str, ...] = ()
    view: str = ""  # XDMF file of an interactive view
    others: str = ""  # where else there are numbers of it, which differ
    example: bool = False  # a flat file without options, which writes where it is run


EXAMPLES = [
    Demo(
        "press_a_disc",
        "Contact: a load table, the contact force, and the pressure beside Hertz'.",
        {"press_a_disc.png": "Contact pressure along the top of the block."},
        example=True,
    ),
    Demo(
        "glue_two_meshes",
        "Mesh tying: two non-matching meshes pass the patch test to round-off.",
        {"glue_two_meshes.png": "The two meshes, with the names of their sides."},
        example=True,
    ),
    Demo(
        "tighten_a_bolt",
        "Preload: the bolt force hardly changes under a pull until the joint opens.",
        {"tighten_a_bolt.png": "Von Mises stress in the half section; the joint is open."},
        example=True,
    ),
    Demo(
        "slide_a_block",
        "Friction: a block sticks, then slides, and T = mu N.",
        {"slide_a_block.png": "Von Mises stress of the block that slides."},
        example=True,
    ),
    Demo(
        "press_a_ball",
        "A rigid tool without a mesh: the pressure beside Hertz', axisymmetric.",
        {"press_a_ball.png": "Contact pressure along the radius."},
        example=True,
    ),
    Demo(
        "fit_two_rings",
        "A press fit: contact removes an overlap; the pressure is Lamé's.",
        {"fit_two_rings.png": "Von Mises stress in the section."},
        example=True,
    ),
    Demo(
        "stack_blocks",
        "`find_pairs` finds and tags the contacts of a stack.",
        {"stack_blocks.png": "Vertical stress under the weight."},
        example=True,
    ),
    Demo(
        "wear_a_cylinder",
        "Wear: a cylinder becomes flat, beside the closed form.",
        {"wear_a_cylinder.png": "Contact pressure over the last step."},
        example=True,
    ),
    Demo(
        "yield_in_contact",
        "Plasticity: a plate compresses a cube and lets go.",
        {"yield_in_contact.png": "Stress over compression."},
        example=True,
    ),
    Demo(
        "squeeze_rubber",
        "Finite strain: Neo-Hooke's law at 60 % of the height.",
        {"squeeze_rubber.png": "Horizontal displacement."},
        example=True,
    ),
    Demo(
        "close_a_gap",
        "Heat: a bar expands until it touches a wall.",
        {"close_a_gap.png": "Horizontal displacement, 100 times enlarged."},
        example=True,
    ),
    Demo(
        "conduct_heat",
        "Heat: a bar touches a cold wall, to which its pressure lets heat flow.",
        {"conduct_heat.png": "Horizontal displacement, 100 times enlarged."},
        example=True,
    ),
    Demo(
        "homogenise_a_cell",
        "A periodic cell: the mean stress of a matrix with a loose inclusion.",
        {"homogenise_a_cell.png": "Von Mises stress."},
        example=True,
    ),
    Demo(
        "bounce_a_rod",
        "Dynamics: a rod hits a wall, for the time of a wave.",
        {"bounce_a_rod.png": "Force over time."},
        example=True,
    ),
    Demo(
        "stop_and_go_on",
        "A checkpoint: a walk goes on in another program.",
        {"stop_and_go_on.png": "Plastic strain after the second walk."},
        example=True,
    ),
]

DEMOS = [
    Demo(
        "hertz",
        "The paper's benchmark in plane strain: contact of elasto-plastic bodies, beside Hertz.",
        {
            "fig7_von_mises_zoom.png": "Von Mises stress at the contact.",
            "pressure.png": "Contact pressure beside that of Hertz for the same force.",
            "fig2_mesh.png": "The mesh, of the same size as the paper's.",
            "fig3_hardening.png": "Hardening, the norm of the back stress.",
        },
        ("--steps", "4"),
        others="The picture of the first page and of the README was computed on the graded mesh, "
        "`--mesh graded`, whose numbers differ. By default the program makes one step.",
    ),
    Demo(
        "sphere",
        "A quarter of a ball on a block: 3D, symmetry planes, multigrid, an interactive view.",
        {
            "von_mises.png": "Von Mises stress.",
            "pressure_map.png": "Contact pressure, seen along the axis.",
            "pressure.png": "Contact pressure along the radius, beside that of Hertz.",
        },
        ("--h", "0.2"),
        "sphere.xdmf",
        others="The mesh is coarse, to save time. The default of the program is `--h 0.125`; force "
        "and pressure are then closer to those of other pages.",
    ),
    Demo(
        "ball_joint",
        "Closely fitting sides on coarse meshes: gaps between facets and smooth surfaces.",
        {"pressure.png": "Pressure on the ball, two meshes, with facets and smooth surfaces."},
    ),
    Demo(
        "tied_cylinder",
        "Mesh tying: a tube of two tied rings reaches the limit load of a single body.",
        {"limit.png": "Pressure over the growth of the bore, with the limit load; plastic strain."},
    ),
    Demo(
        "bolted_tee",
        "A bolted T-stub in 3D: preload, contact of flanges, prying forces, yielding.",
        {
            "result.png": "Forces, resistances of EN 1993-1-8; plastic strain in the section.",
            "pull.gif": "The pull, step by step.",
        },
    ),
    Demo(
        "indentation",
        "Axisymmetric contact: a ball is flattened by a rigid plate, far beyond first yield.",
        {"result.png": "Forces and areas beside published fits; pressures; plastic strain."},
    ),
    Demo(
        "hardness",
        "Rigid tools: instrumented indentation of a metal by a cone, a ball and a pyramid.",
        {"result.png": "Force over depth, slope of unloading; the surface with pile-up."},
        ("--tool", "cone", "ball", "berkovich"),
    ),
    Demo(
        "deep_drawing",
        "Rigid tools, one of them driven by a force: deep drawing of a cup.",
        {"result.png": "Force of the punch beside Siebel's estimate; von Mises stress in the cup."},
    ),
    Demo(
        "own_law",
        "A material law of your own, in UFL, in NumPy, and in JAX, which derives its tangent.",
        {"own_law.png": "Plastic strain below the disc, and the pressures of all versions."},
        ("--versions", "ufl", "numpy", "jax"),
    ),
    Demo(
        "cattaneo",
        "Friction: partial slip of a disc that is pushed back and forth, beside Cattaneo.",
        {"result.png": "Shear tractions, stick zone and force over displacement, beside Cattaneo."},
    ),
    Demo(
        "shrink_fit",
        "Interference fit: friction holds a shaft in a hub until it is pulled out.",
        {"result.png": "Pressure and shear traction along the shaft; the pulling force."},
    ),
    Demo(
        "ironing",
        "Finite strain: shallow ironing, large sliding of a tool over a block with friction.",
        {
            "result.png": "Forces beside those of six programs; von Mises stress half way along.",
            "ironing.gif": "The motion of the tool, step by step.",
        },
    ),
    Demo(
        "rubber",
        "Nearly incompressible rubber: a cylinder is pressed between rigid plates.",
        {
            "result.png": "Force beside Sussman and Bathe's; von Mises stress in the cylinder.",
            "rubber.gif": "The approach of the plates, step by step.",
        },
    ),
    Demo(
        "newtons_cradle",
        "Dynamics: impact of three elastic rods; the last one leaves with all of the energy.",
        {"result.png": "Velocities, forces beside Saint-Venant's, ledger of energies."},
    ),
    Demo(
        "bouncing_rings",
        "Dynamics: collision of two rings, and the energy of their vibrations.",
        {"result.png": "Velocities, width of the second ring, and the ledger of energies."},
    ),
    Demo(
        "taylor_bar",
        "Dynamics and finite plasticity: a copper bar hits a wall at 227 m/s.",
        {
            "result.png": "Plastic strain; radius, length beside other codes; ledger of energies.",
            "taylor_bar.gif": "The 80 microseconds of the impact.",
        },
    ),
    Demo(
        "curved_beams",
        "Finite plasticity: a half ring is dragged over another one until they separate.",
        {
            "result.png": "Reactions beside published ones; von Mises stress; plastic strain.",
            "curved_beams.gif": "The motion, step by step.",
        },
    ),
]


def program(demo: Demo) -> Path:
    """Return the script of a demo."""
    if demo.example:
        return ROOT / "examples" / f"{demo.name}.py"
    return ROOT / "demos" / demo.name / f"{demo.name}.py"


def text_of(demo: Demo) -> str:
    """Return the program of a demo as its page shows it: without a function main()."""
    source = program(demo).read_text()
    return source if demo.example else flat(source)


def state(files: list[Path], more: str) -> str:
    """Return a number that changes with files, a text, the library and Python."""
    files = [*files, *sorted((ROOT / "dolfinx_mortar").rglob("*.py"))]
    text = b"\0".join([*(f.read_bytes() for f in files), (more + sys.version).encode()])
    return hashlib.sha256(text).hexdigest()


def run(demo: Demo) -> None:
    """Run a demo unless it has been run in this state; raise RuntimeError if it fails."""
    files = files_of(demo)
    files += [Path(__file__).with_name("view.py")] if demo.view else []
    folder = KEPT / demo.name
    command = [str(program(demo)), *demo.options]
    command += [] if demo.example else ["--output", str(folder)]
    where = folder if demo.example else ROOT
    run_once(str(program(demo).relative_to(ROOT)), command, folder, state(files, repr(demo)), where)


def run_once(name: str, options: list[str], folder: Path, now: str, where: Path) -> None:
    """Run a program that fills a folder unless that is of this state.

    Raises:
        RuntimeError: if the program fails, with its last words.
    """
    stamp = folder / "state"
    if stamp.exists() and stamp.read_text() == now:
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    print(f"docs/build: running {name}", flush=True)
    # a program waits for a form that another one compiles, under load longer than the usual 10 s
    environment = os.environ | {"XDG_CONFIG_HOME": str(Path(__file__).with_name("config"))}
    pipes = {"capture_output": True, "text": True}
    done = subprocess.run([sys.executable, *options], cwd=where, env=environment, **pipes)
    # as for those who run it with its own default
    said = done.stdout.replace(str(folder), f"results/{folder.name}")
    (folder / "said.txt").write_text(said)
    if done.returncode:
        raise RuntimeError(f"{name} failed\n{done.stderr[-2000:]}")
    stamp.write_text(now)


def run_all(demos: list[Demo]) -> None:
    """Run demos as `run` does, as many at a time as there are cores, the longest ones first."""
    first = sorted(demos, key=lambda demo: demo.name not in ("deep_drawing", "indentation"))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for _ in pool.map(run, first):
            pass


def make_view(xdmf: Path, html: Path) -> None:
    """Make the interactive view; say so where that is not possible here."""
    command = [sys.executable, str(Path(__file__).with_name("view.py")), str(xdmf), str(html)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        said = [
            line for line in done.stderr.splitlines() if re.match(r"\w*(Error|Exception)", line)
        ]
        last = said[-1] if said else f"status {done.returncode}"
        print(f"docs/build: no interactive view of {xdmf.stem}: {last}", flush=True)


def flat(source: str) -> str:
    r"""Return a program without main(): its functions, the options' defaults, then its body.

    So it can be pasted and read part by part: no part is cut inside of a function. Texts inside of
    other functions go above them.

    >>> g = "def g():\n    # ## a\n\n    X\n"
    >>> print(flat("X = 1\n\n\ndef main(options):\n    # d\n\n    g()\n\n\n" + g))
    X = 1
    <BLANKLINE>
    # ## a
    <BLANKLINE>
    def g():
    <BLANKLINE>
        X
    <BLANKLINE>
    # ## Run
    #
    # With the defaults of the options.
    <BLANKLINE>
    options = parser.parse_args([])
    <BLANKLINE>
    # d
    <BLANKLINE>
    g()
    <BLANKLINE>
    """
    lines, parts, body, end = source.splitlines(), [], "", 0
    for node in ast.parse(source).body:
        own = "\n".join(lines[end : node.end_lineno])
        end = node.end_lineno or 0
        if isinstance(node, ast.FunctionDef) and node.name == "main":
            after = node.body[0].end_lineno if ast.get_docstring(node) else node.lineno
            body = textwrap.dedent("\n".join(lines[after:end])).strip("\n")
        elif isinstance(node, ast.If) and "__name__" in ast.unparse(node.test):
            continue
        else:
            parts.append("\n" + hoisted(own) if isinstance(node, ast.FunctionDef) else own)
    options = "# ## Run\n#\n# With the defaults of the options.\n\noptions = parser.parse_args([])"
    return "\n".join([*parts, "", options, "", body, ""])


def hoisted(function: str) -> str:
    """Return a function whose paragraphs of comments stand above it, those above it first."""
    function = re.sub(r"(?m)^(?=[ \t]*# #+ )", "\n", function)  # headings start a text
    blocks = re.split(r"\n(?:[ \t]*\n)+", function.strip("\n"))
    is_text = [all(line.lstrip().startswith("#") for line in b.splitlines()) for b in blocks]
    texts = [textwrap.dedent(b) for b, text in zip(blocks, is_text, strict=True) if text]
    code = "\n\n".join(b for b, text in zip(blocks, is_text, strict=True) if not text)
    return "\n\n".join([*texts, code])


def paragraphs(source: str) -> list[tuple[str, str]]:
    r"""Split a program into ("text" or "code", lines): comments between blank lines are text.

    >>> paragraphs("# # A\n#\n# b\n\nx = 1  # c\n# d\ny = 2\n")
    [('text', '# A\n\nb'), ('code', 'x = 1  # c\n# d\ny = 2')]
    """
    parts: list[tuple[str, str]] = []
    source = re.sub(r"(?m)^(?=# #+ )", "\n", source)  # headings start a text
    for block in re.split(r"\n(?:[ \t]*\n)+", source.strip("\n")):
        lines = block.splitlines()
        if all(line.startswith("#") for line in lines):
            if "SPDX" in block or "ruff:" in block:
                continue
            parts.append(("text", "\n".join(re.sub(r"^# ?", "", line) for line in lines)))
        elif parts and parts[-1][0] == "code":
            parts[-1] = ("code", parts[-1][1] + "\n\n" + block)
        else:
            parts.append(("code", block))
    return parts


def page(demo: Demo, folder: Path) -> str:
    """Return the page of a demo in MyST."""
    said: list[str] = []
    for kind, lines in paragraphs(text_of(demo)):
        if kind == "text":
            said.append(re.sub(r"(?m)^(\$\$.*\$\$)$", r"\n\1\n", lines))
        else:
            said.append(f"```python\n{lines}\n```")
    first, rest = said[0], said[1:]
    files = ", ".join(
        f"{{download}}`{name} <{demo.name}/{name}>`"
        for name in sorted(p.name for p in folder.glob("*.[pi]*") if p.suffix in (".py", ".ipynb"))
    )
    shown = []
    if (folder / "view.html").exists():
        shown.append(
            "Turn it with the mouse or a finger; the wheel, or two fingers, come closer.\n\n"
            "```{raw} html\n"
            f'<iframe class="view" src="../../_static/views/{demo.name}.html" loading="lazy" '
            f'title="{demo.short}"></iframe>\n```'
        )
    for file, caption in demo.pictures.items():
        if (folder / file).exists():
            shown.append(f"```{{figure}} {demo.name}/{file}\n:alt: {caption}\n\n{caption}\n```")
    if (folder / "said.txt").exists():
        shown.append(
            ":::{dropdown} What it prints\n"
            f"```{{literalinclude}} {demo.name}/said.txt\n:language: text\n```\n:::"
        )
    shown = ["## Result", *shown] if shown else []
    where = program(demo).relative_to(ROOT)
    command = " ".join(["containers/run python3", str(where), *demo.options])
    these = "pictures and numbers of this page are those of that mesh and these steps"
    run_by = f"Run by `{command}`; {these}. {demo.others} Files: {files}."
    if demo.example:
        run_by = f"Run by `{command}`. Files: {files}."
    return "\n\n".join([first, run_by, *shown, "## Program", *demote(rest)]) + "\n"


def demote(parts: list[str]) -> list[str]:
    """Return the parts with the headings of texts one level down."""
    return [p if p.startswith("```") else re.sub(r"(?m)^##", "###", p) for p in parts]


def files_of(demo: Demo) -> list[Path]:
    """Return the programs of a demo."""
    return [program(demo)] if demo.example else sorted(program(demo).parent.glob("*.py"))


def neighbours(demo: Demo) -> list[Path]:
    """Return the other files of a demo that are imported."""
    return [file for file in files_of(demo) if file != program(demo)]


def notebook(demo: Demo, path: Path, pictures: Path) -> None:
    """Write a demo as a notebook that needs no other file, with the pictures that it has made.

    Args:
        demo: which.
        path: of the notebook.
        pictures: folder of what the demo has drawn, some of it or nothing.
    """
    cells = [code_cell(f"%%writefile {f.name}\n{f.read_text()}") for f in neighbours(demo)]
    for kind, lines in paragraphs(text_of(demo)):
        cell = {"cell_type": "markdown", "metadata": {}, "source": lines}
        cells.append(cell if kind == "text" else code_cell(lines))
    cells.insert(0, cells.pop(len(neighbours(demo))))  # the title
    where = "Path()" if demo.example else "options.output"
    shown = [
        "from pathlib import Path\n",
        "from IPython.display import Image, display\n",
        f"for name in {list(demo.pictures)}:",
        f"    if ({where} / name).exists():",
        f"        display(Image({where} / name))",
    ]
    outputs = []
    for file in (pictures / name for name in demo.pictures):
        if file.exists():
            data = base64.b64encode(file.read_bytes()).decode()
            kind = "image/gif" if file.suffix == ".gif" else "image/png"
            outputs.append({"output_type": "display_data", "metadata": {}, "data": {kind: data}})
    cells.append(code_cell("\n".join(shown), outputs))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    about = {"kernelspec": kernel, "language_info": {"name": "python"}}
    text = {"cells": cells, "metadata": about, "nbformat": 4, "nbformat_minor": 4}
    path.write_text(json.dumps(text, indent=1))


def code_cell(source: str, outputs: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
    """Return a cell of a notebook."""
    more = {"execution_count": None, "outputs": list(outputs)}
    return {"cell_type": "code", "metadata": {}, "source": source} | more


def run_tutorial() -> None:
    """Run the programs of the tutorial for its pictures; raise RuntimeError if they fail."""
    text = (DOCS / "tutorial.md").read_text()
    folder = DOCS / "generated" / "tutorial"
    code = "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    run_once("docs/tutorial.md", ["-c", code], folder, state([], code), folder)


INDEX = """\
# Gallery

Scripts with an explanation in their comments, and a notebook of each. They were run for these
pages.

## Examples

Programs of at most 60 lines, to be pasted and changed. Each asserts its result.

:::::{grid} 1 2 2 3
:gutter: 3

%s
:::::

## Studies

Longer ones, with options (`--help` shows them) and figures, beside known results.

:::::{grid} 1 2 2 3
:gutter: 3

%s
:::::

```{toctree}
:hidden:

%s
```
"""
CARD = """\
::::{{grid-item-card}} {title}
:link: {name}
:link-type: doc
{picture}
{short}
::::
"""


def card(demo: Demo, folder: Path) -> str:
    """Return the card of a demo."""
    title = paragraphs(program(demo).read_text())[0][1].splitlines()[0].lstrip("# ")
    file = next(iter(demo.pictures))
    picture = f":img-top: {demo.name}/{file}\n" if (folder / file).exists() else ""
    return CARD.format(title=title, name=demo.name, picture=picture, short=demo.short)


def main(execute: bool) -> None:
    """Make all pages."""
    shutil.rmtree(PAGES, ignore_errors=True)
    views = DOCS / "generated" / "static" / "views"
    views.mkdir(parents=True, exist_ok=True)
    run_tutorial()  # some seconds; its pages cannot do without
    cards = {}
    if execute:
        run_all([*EXAMPLES, *DEMOS])
    for demo in [*EXAMPLES, *DEMOS]:
        view = KEPT / demo.name / "view.html"
        if execute and demo.view and not view.exists():
            make_view(KEPT / demo.name / demo.view, view)
        folder = PAGES / demo.name
        folder.mkdir(parents=True)
        for file in files_of(demo):
            shutil.copy(file, folder)
        for file in [*demo.pictures, "said.txt", "view.html"]:
            if (KEPT / demo.name / file).exists():
                shutil.copy(KEPT / demo.name / file, folder)
        notebook(demo, folder / f"{demo.name}.ipynb", KEPT / demo.name)
        (PAGES / f"{demo.name}.md").write_text(page(demo, folder))
        if (folder / "view.html").exists():
            (folder / "view.html").replace(views / f"{demo.name}.html")
        cards[demo.name] = card(demo, folder)
    groups = ["\n".join(cards[demo.name] for demo in group) for group in (EXAMPLES, DEMOS)]
    (PAGES / "index.md").write_text(INDEX % (*groups, "\n".join(cards)))


if __name__ == "__main__":
    try:
        main("--no-run" not in sys.argv[1:])
    except RuntimeError as error:
        sys.exit(f"docs/build: {error}")
