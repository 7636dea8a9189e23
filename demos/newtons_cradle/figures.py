# SPDX-License-Identifier: MIT
"""The picture of the cradle: velocities and forces over time, and the ledger of energies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

DPI = 110
COLOURS = ("#20609f", "#e0a030", "#c03a2b")


def draw(path: Path, rows: list[dict[str, Any]], found: dict[str, float]) -> None:
    """Draw everything into one picture; call on one rank.

    Args:
        path: of the PNG file.
        rows: the demo's numbers of every step.
        found: results beside those of Saint-Venant.
    """
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    speeds, pushes, energies = figure.subplots(1, 3)
    t = 1e6 * np.array([row["time"] for row in rows])
    names = ("first rod", "second rod", "last rod")
    for k, (colour, name) in enumerate(zip(COLOURS, names, strict=True)):
        v = [1e-3 * row["velocities"][k] for row in rows]
        speeds.plot(t, v, color=colour, lw=1.6, label=name)
    speeds.set(title="mean velocities", ylabel="m/s", xlabel="time [µs]")
    speeds.legend(fontsize=8)
    for k, name in enumerate(("first on second", "second on last")):
        force = [row["pushes"][k] for row in rows]
        pushes.plot(t, force, color=COLOURS[k + 1], lw=1.2, label=name)
    level = found["force_saint_venant"]
    pushes.axhline(level, color="black", ls="--", lw=0.8, label="Saint-Venant")
    pushes.set(title="contact forces", ylabel="N", xlabel="time [µs]", ylim=(0.0, 1.8 * level))
    pushes.legend(fontsize=8, loc="upper right")
    ledger = {n: np.array([row["ledger"][n] for row in rows]) for n in ("kinetic", "stored")}
    energies.stackplot(
        t, ledger["kinetic"], ledger["stored"], colors=("#9ec5e8", "#f0c987"), labels=ledger.keys()
    )
    initial = rows[0]["ledger"]["initial"]
    energies.axhline(initial, color="black", ls="--", lw=0.8, label="at the start")
    defect = found["largest_defect_of_energy"]
    energies.set(
        title=f"energy, kept to {defect:.0e}",
        ylabel="mJ",
        xlabel="time [µs]",
        ylim=(0.0, 1.25 * initial),
    )
    energies.legend(fontsize=8, loc="upper center", ncols=3)
    for axes in (speeds, pushes, energies):
        axes.set_xlim(0.0, t[-1])
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=DPI)
