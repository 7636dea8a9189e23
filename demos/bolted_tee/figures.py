# SPDX-License-Identifier: MIT
"""The pictures of the bolted T-stub: forces, the section through the bolt, an animation of both."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import tees
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from tee_stub import TeeStub

import dolfinx_mortar as dm
from dolfinx_mortar.common import compat

SCALE = 5.0  # of displacements
Array = npt.NDArray[np.float64]


class Section:
    """The facets in the plane of symmetry through the bolt."""

    def __init__(self, problem: dm.ContactProblem, sides: dm.Tags) -> None:
        """Find the corners of the facets that this rank owns."""
        self.problem, mesh = problem, problem.V.mesh
        mesh.topology.create_connectivity(2, 3)
        to_cell = mesh.topology.connectivity(2, 3)
        facets = sides.find("front")
        facets = facets[facets < mesh.topology.index_map(2).size_local]
        self.cells = to_cell.array[to_cell.offsets[facets]]
        nodes = np.asarray(compat.cell_nodes(mesh))[self.cells]
        x = mesh.geometry.x[nodes]  # (m, 8, 3)
        corners = np.argsort(np.abs(x[:, :, 1]), axis=1, kind="stable")[:, :4]
        corners = np.sort(corners, axis=1)[:, [0, 1, 3, 2]]
        self.x = np.take_along_axis(x, corners[:, :, None], axis=1)[:, :, [0, 2]]
        self.dofs = np.take_along_axis(problem.V.dofmap.list[self.cells], corners, axis=1)

    def gather(self) -> tuple[Array, Array] | None:
        """Return corners (m, 4, 2), moved, and plastic strains (m,) on rank 0; collective."""
        u = self.problem.u.x.array.reshape(-1, 3)[self.dofs][:, :, [0, 2]]
        strain = self.problem.solid.cell_values("plastic_strain_norm").x.array[self.cells]
        parts = self.problem.comm.gather((self.x + SCALE * u, strain))
        if parts is None:
            return None
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def draw_section(axes, frame: tuple[Array, Array], largest: float) -> PolyCollection:
    """Draw the section and its mirror image."""
    corners, strain = frame
    both = np.concatenate([corners, corners * [-1.0, 1.0]])
    shown = PolyCollection(
        both, array=100 * np.tile(strain, 2), edgecolor="white", linewidth=0.2, cmap="magma_r"
    )
    shown.set_clim(0.0, 100 * largest)
    axes.add_collection(shown)
    room = tees.HEIGHT + SCALE * 2.2
    axes.set(xlim=(-1.05 * tees.HALF, 1.05 * tees.HALF), ylim=(-0.55 * room, 0.75 * room))
    axes.set_aspect("equal")
    axes.axis("off")
    return shown


def draw_forces(axes, rows: list[dict], limits: TeeStub, upto: int) -> None:
    """Draw forces against the opening of the flanges at the web, up to a step."""
    x = np.array([row["opening"] for row in rows])
    for name, label, style in (
        ("force", "pull $F$", "o-"),
        ("bolt", "bolt $B$", "s-"),
        ("prying", "between flanges $Q$", "^-"),
    ):
        values = 1e-3 * np.array([row[name] for row in rows])
        axes.plot(x[:upto], values[:upto], style, markersize=3, label=label)
    for k, mode in enumerate((limits.mode_1, limits.mode_2), start=1):
        axes.axhline(1e-3 * mode, color="black", linestyle="--", linewidth=0.8)
        axes.text(x[-1], 1e-3 * mode, f"$F_{k}$ ", va="bottom", ha="right")
    highest = max(limits.mode_2, *(row["force"] for row in rows))
    axes.set(xlabel="opening at the web [mm]", ylabel="force [kN]")
    axes.set(xlim=(-0.02 * x[-1], 1.02 * x[-1]), ylim=(-2.0, 1.1e-3 * highest))
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.42), frameon=False)


def picture(
    rows: list[dict],
    frames: list[tuple[Array, Array]],
    limits: TeeStub,
    step: int,
) -> Figure:
    """Return forces up to a step, beside the section then."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.4))
    draw_forces(left, rows, limits, step + 1)
    largest = max(float(strain.max()) for _, strain in frames) or 1e-2
    shown = draw_section(right, frames[step], largest)
    label = f"plastic strain [%], Frobenius norm; displacements x {SCALE:g}"
    figure.colorbar(shown, ax=right, label=label, shrink=0.7, orientation="horizontal")
    return figure


def draw(
    folder: Path,
    rows: list[dict],
    frames: list[tuple[Array, Array]],
    limits: TeeStub,
    *,
    animated: bool,
) -> None:
    """Write result.png and, on request, pull.gif."""
    picture(rows, frames, limits, len(rows) - 1).savefig(folder / "result.png", dpi=110)
    if not animated:
        return
    images = []
    for step in range(len(rows)):
        figure = picture(rows, frames, limits, step)
        figure.set_dpi(80)
        figure.canvas.draw()
        images.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB"))
    shown = [*images, *([images[-1]] * 4)]
    shown[0].save(folder / "pull.gif", save_all=True, append_images=shown[1:], duration=350, loop=0)
