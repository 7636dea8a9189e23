# SPDX-License-Identifier: MIT
"""The pictures of the Cattaneo demo: tractions at the turning points, stick zone, the loop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import dolfinx_mortar as dm

DPI = 90
COLOURS = ("#20609f", "#c03a2b", "#3a8f3a", "#8a5aa8")


def draw(
    path: Path,
    rows: list[dict[str, Any]],
    surfaces: list[dict[str, np.ndarray]],
    states: list[dm.analytic.PartialSlip | None],
    h: float,
) -> None:
    """Draw everything into one picture; call on one rank.

    Args:
        path: of the PNG file.
        rows: the demo's numbers of every step.
        surfaces: x, p, q and status of the slave nodes of every step.
        states: Cattaneo's solution of every step, None while the disc is pressed down.
        h: length of a facet in contact.
    """
    figure = Figure(figsize=(10.0, 7.6), layout="constrained")
    (first, back), (zone, loop) = figure.subplots(2, 2)
    times = [row["time"] for row in rows]
    count = sum(1.0 < t <= 2.0 for t in times)
    start = times.index(2.0)
    once = [i for i, t in enumerate(times) if 1.0 < t <= 2.0][:: max(1, count // 3)]
    again = np.unique(np.linspace(start, times.index(3.0), 4).astype(int))
    _tractions(first, sorted({*once[-2:], start}), rows, surfaces, states, "first push")
    _tractions(back, again, rows, surfaces, states, "and back")
    _zone(zone, rows, states, h)
    _loop(loop, rows, states)
    figure.savefig(path, dpi=DPI)


def _tractions(
    axes: Axes,
    chosen: Any,
    rows: list[dict[str, Any]],
    surfaces: list[dict[str, np.ndarray]],
    states: list[dm.analytic.PartialSlip | None],
    title: str,
) -> None:
    """Draw the traction of some steps, the formula, and Coulomb's limits."""
    for colour, i in zip(COLOURS, chosen, strict=False):
        state, nodes = states[i], surfaces[i]
        a, peak = state.contact.half_width, state.friction * state.contact.peak_pressure
        x = a * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 801))
        near = np.abs(nodes["x"]) < 1.2 * a
        label = f"$Q/\\mu P$ = {rows[i]['share']:.2f}"
        axes.plot(x / a, state.traction(x) / peak, color=colour, lw=1.0, label=label)
        axes.plot(nodes["x"][near] / a, nodes["q"][near] / peak, "o", color=colour, ms=3.0)
    for sign in (-1.0, 1.0):
        axes.plot(x / a, sign * np.sqrt(1.0 - (x / a) ** 2), "k:", lw=0.8)
    axes.set(xlabel="$x/a$", ylabel=r"$q/(\mu p_0)$", title=f"shear traction, {title}")
    axes.grid(alpha=0.3)
    axes.set_ylim(0.0 if title == "first push" else -1.1, 1.4)
    axes.legend(fontsize="small", loc="upper center", ncols=2)


def _zone(
    axes: Axes, rows: list[dict[str, Any]], states: list[dm.analytic.PartialSlip | None], h: float
) -> None:
    """Draw the stick zone over the change of the force since its last reversal.

    It ends between the last node that sticks and the next node, a facet of length h away; the bars
    show this interval.
    """
    k = np.linspace(0.0, 1.0, 201)
    axes.plot(1.0 - k, np.sqrt(k), "k-", lw=1.0, label="Cattaneo")
    names = ("first push", "back", "and again")
    for leg, name, colour, size in zip((1, 2, 3), names, COLOURS, (9.0, 6.0, 3.0), strict=False):
        on = [i for i, row in enumerate(rows) if leg < row["time"] <= leg + 1]
        a = np.array([rows[i]["half_width"] for i in on])
        share = 1.0 - (np.array([states[i].stick_half_width for i in on]) / a) ** 2
        stick = np.array([rows[i]["stick_half_width"] for i in on])
        axes.vlines(share, stick / a, (stick + h) / a, color="#b0b0b0", lw=1.0)
        axes.plot(share, stick / a, "o", color=colour, ms=size, label=name)
    axes.set(xlabel=r"change of $Q$ over $\mu P$, or over $2 \mu P$ after a reversal")
    axes.set(ylabel="$c/a$", title="half-width of the stick zone", ylim=(0.0, 1.05))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _loop(
    axes: Axes, rows: list[dict[str, Any]], states: list[dm.analytic.PartialSlip | None]
) -> None:
    """Draw the force over the part of the displacement due to slip, beside the formula."""
    on = [i for i, state in enumerate(states) if state is not None]
    turn = next(i for i in on if rows[i]["time"] == 2.0)
    largest = states[turn].force
    compliance = (rows[turn]["sideways"] - states[turn].displacement) / largest
    contact, friction = states[turn].contact, states[turn].friction
    share = np.linspace(-1.0, 1.0, 201)
    for history, forces in (
        ((), largest * share[share >= 0.0]),
        ((largest,), largest * share),
        ((largest, -largest), largest * share),
    ):
        curve = [dm.analytic.cattaneo_line(contact, friction, (*history, Q)) for Q in forces]
        slip = np.array([state.displacement for state in curve])
        label = "Cattaneo" if not history else None
        axes.plot(1e3 * slip, forces, "k-", lw=1.0, label=label)
    Q = np.array([rows[i]["tangential_force"] for i in on])
    slip = np.array([rows[i]["sideways"] for i in on]) - compliance * Q
    axes.plot(1e3 * slip, Q, "o", color=COLOURS[1], ms=3.5, label="computed")
    axes.set(xlabel="displacement without its linear part [µm]", ylabel="$Q$ [N/mm]")
    axes.set(title="loop of the force")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="lower right")
