# SPDX-License-Identifier: MIT
"""The picture of the indentations: force over depth, and the surface under each tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tools import Tool

import dolfinx_mortar as dm

DPI = 110


@dataclass(frozen=True)
class Result:
    """The results of one tool."""

    name: str
    tool: Tool
    problem: dm.ContactProblem
    rows: list[dict[str, Any]]  # the demo's numbers of every step
    nodes: Mapping[str, np.ndarray]  # the surface at the largest depth
    found: dict[str, float]  # with the slope of unloading, if there is one


def draw(path: Path, results: list[Result]) -> None:
    """Draw a row for each tool into one picture; call on one rank."""
    figure = Figure(figsize=(10.0, 3.9 * len(results)), layout="constrained")
    for result, (left, right) in zip(
        results, figure.subplots(len(results), 2, squeeze=False), strict=True
    ):
        _curve(left, result)
        if len(result.nodes["x"][0]) == 2:
            _section(right, result)
        else:
            _map(right, result)
    figure.savefig(path, dpi=DPI)


def _curve(axes: Axes, result: Result) -> None:
    """Draw force over depth, with the slope at the start of unloading."""
    depth, force = (
        np.array([0.0, *(row[name] for row in result.rows)]) for name in ("depth", "force")
    )
    axes.plot(depth, force, "o-", color="#20609f", ms=3, label="loading, unloading")
    if "slope" in result.found:
        top = force.max()
        start = depth.max() - top / result.found["slope"]
        axes.plot([start, depth.max()], [0.0, top], "--", color="#c03a2b", lw=1, label="slope S")
    axes.set(xlabel="depth [µm]", ylabel="force [mN]", ylim=(0.0, None), xlim=(0.0, None))
    axes.set_title(result.name)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _section(axes: Axes, result: Result) -> None:
    """Draw the surface and the pressure over the radius."""
    nodes = result.nodes
    order = np.argsort(nodes["x"][:, 0])
    (r, z), pressure = nodes["x"][order].T, nodes["pressure"][order]
    on = r < 2.5 * r[pressure > 0.0].max(initial=1.0)
    floor = z[on].min() - 0.3
    axes.plot(r[on], z[on], color="#555555", lw=1.5)
    axes.fill_between(r[on], z[on], floor, color="#dddddd", lw=0.0)
    axes.set(xlabel="radius [µm]", ylabel="height [µm]", ylim=(floor, None))
    axes.grid(alpha=0.3)
    of_pressure = axes.twinx()
    of_pressure.plot(r[on], pressure[on], color="#c03a2b", lw=1.2)
    of_pressure.set_ylabel("pressure [GPa]", color="#c03a2b")
    of_pressure.set_ylim(0.0, 2.0 * pressure.max())


def _map(axes: Axes, result: Result) -> None:
    """Draw the surface from above, all six symmetric parts, and the nodes in contact."""
    nodes = result.nodes
    images = []
    for k in range(6):
        x, y, z = nodes["x"].T
        angle = np.radians(120.0 * (k // 2))
        c, s = np.cos(angle), np.sin(angle)
        y = -y if k % 2 else y
        images.append(np.column_stack([c * x - s * y, s * x + c * y, z, nodes["pressure"]]))
    x, y, z, pressure = np.concatenate(images).T
    size = 1.6 * np.hypot(x, y)[pressure > 0.0].max(initial=1.0)
    near = np.hypot(x, y) < 2.0 * size
    drawn = axes.tricontourf(x[near], y[near], z[near], levels=24, cmap="viridis")
    on = pressure > 0.0
    axes.plot(x[on], y[on], ".", color="#c03a2b", ms=3, label="in contact")
    axes.set(xlim=(-size, size), ylim=(-size, size), aspect="equal", xlabel="[µm]", ylabel="[µm]")
    axes.legend(fontsize=8)
    axes.figure.colorbar(drawn, ax=axes, label="height [µm]")
