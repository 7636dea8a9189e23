# SPDX-License-Identifier: MIT
"""The picture of the shrink fit demo: pressure and friction along the axis, force against slip."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

DPI = 110
COLOURS = ("#20609f", "#3a8f3a", "#e0a030", "#8a5aa8", "#c03a2b")


def draw(
    path: Path,
    rows: list[dict[str, Any]],
    surfaces: list[dict[str, np.ndarray]],
    found: dict[str, Any],
) -> None:
    """Draw everything into one picture; call on one rank.

    Args:
        path: of the PNG file.
        rows: the demo's numbers of every step.
        surfaces: slave nodes of every step.
        found: results beside the formulas.
    """
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    pressure, traction, force = figure.subplots(1, 3)
    times = [row["time"] for row in rows]
    chosen = [i for i, t in enumerate(times) if 1.0 <= t <= 2.0] + [len(times) - 1]
    for colour, i in zip(COLOURS, chosen, strict=False):
        z, p, tau = _along(surfaces[i])
        label = f"{abs(1e-3 * rows[i]['force']):.1f} kN"
        pressure.plot(z, p, ".-", color=colour, lw=1.0, ms=4, label=label)
        traction.plot(z, tau, ".-", color=colour, lw=1.0, ms=4, label=label)
    pressure.axhline(found["pressure_lame"], color="black", ls="--", lw=0.8, label="Lame, elastic")
    pressure.set(ylabel="pressure [MPa]", title="pressure", ylim=(0.0, None))
    traction.set(ylabel="shear traction [MPa]", title="friction", ylim=(0.0, None))
    traction.set_ylim(top=1.4 * traction.get_ylim()[1])  # room for the legend
    for axes, place, columns in ((pressure, "lower left", 1), (traction, "upper center", 3)):
        axes.set(xlabel="z [mm]; the shaft is pulled at the right end")
        axes.legend(fontsize="small", loc=place, ncols=columns)
        axes.grid(alpha=0.3)
    pulled = [row for row in rows if row["time"] >= 1.0]
    start = pulled[0]["end"]
    moved = [1e3 * (row["end"] - start) for row in pulled]
    force.plot(moved, [1e-3 * row["force"] for row in pulled], "o-", color=COLOURS[0], ms=4)
    limit = 1e-3 * found["sliding_force_mu_p_A"]
    force.axhline(limit, color="black", ls="--", lw=0.8, label=r"$\mu p A$")
    force.set(xlabel="motion of the shaft's end [µm]", ylabel="pull [kN]", title="pull")
    force.legend(fontsize="small", loc="lower right")
    force.grid(alpha=0.3)
    figure.savefig(path, dpi=DPI)


def _along(nodes: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return z, pressure and axial traction, means over the nodes at the same z."""
    at, group = np.unique(np.round(nodes["X"][:, -1], 9), return_inverse=True)
    count = np.bincount(group)
    values = (nodes["pressure"], np.abs(nodes["traction"][:, -1]))
    p, tau = (np.bincount(group, v) / count for v in values)
    return at, p, tau
