# SPDX-License-Identifier: MIT
"""The picture of the indentation: force over depth, and the surface under the tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

DPI = 110


def draw(
    path: Path, rows: list[dict[str, Any]], nodes: dict[str, np.ndarray], found: dict[str, float]
) -> None:
    """Draw everything into one picture; call on one rank.

    Args:
        path: of the PNG file.
        rows: the demo's numbers of every step.
        nodes: the surface at the largest depth.
        found: what was found, with the slope of unloading.
    """
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    curve, section = figure.subplots(1, 2)
    depth, force = (np.array([0.0, *(row[name] for row in rows)]) for name in ("depth", "force"))
    curve.plot(depth, force, "o-", color="#20609f", ms=3, label="in and out")
    if "slope" in found:
        top = force.max()
        start = depth.max() - top / found["slope"]
        curve.plot([start, depth.max()], [0.0, top], "--", color="#c03a2b", lw=1, label="slope S")
    curve.set(xlabel="depth [µm]", ylabel="force [mN]", ylim=(0.0, None), xlim=(0.0, None))
    curve.legend(fontsize=8)
    r, z = nodes["x"][:, :2].T
    order = np.argsort(r)
    r, z, pressure = r[order], z[order], nodes["pressure"][order]
    on = r < 2.5 * max(rows[-1]["radius"], r[pressure > 0.0].max(initial=1.0))
    section.plot(r[on], z[on], color="#555555", lw=1.5, label="surface")
    section.fill_between(r[on], z[on], z[on].min() - 0.3, color="#dddddd", lw=0.0)
    section.set(xlabel="radius [µm]", ylabel="height [µm]", ylim=(z[on].min() - 0.3, None))
    of_pressure = section.twinx()
    of_pressure.plot(r[on], pressure[on], color="#c03a2b", lw=1.2)
    of_pressure.set_ylabel("pressure [GPa]", color="#c03a2b")
    of_pressure.set_ylim(0.0, 2.0 * pressure.max())
    for axes in (curve, section):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=DPI)
