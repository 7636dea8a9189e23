# SPDX-License-Identifier: MIT
"""What a checkpoint of a problem may hold: checked when it is saved, and before it is restored.

A checksum shows that a file is as it was written, not that its writer was this package.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_mortar.arguments import as_numbers, is_integer
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Floats
from dolfinx_mortar.persistence.committed import ProblemState
from dolfinx_mortar.persistence.identity import subject_of
from dolfinx_mortar.step_report import Ledger

NODES, POINTS = "nodes", "points"
SLIPS = ("slid", "dissipated")
RESULTANTS = ("force", "moment", "master_force", "master_moment", "place")
UNCOMMITTED = "uncommitted "  # before what a step has found that has not been committed
FLAGS = ("active", f"{UNCOMMITTED}active", "carries", "near")  # columns of zeros and ones
UNDEFINED = ("gap",)  # NaN where a slave node faces no master


def name_of(k: int) -> str:
    """Return the name of the table of an interface."""
    return f"interface {k}"


@contextmanager
def named(file: Path) -> Iterator[None]:
    """Let errors in contents of a file name it, and the remedy."""
    try:
        yield
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        told = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(
            f"path is {str(file)!r}, which cannot be restored: {told}; take a file that save() of "
            "this problem has written"
        ) from error


# -- values --------------------------------------------------------------------------------------


def check_values(state: ProblemState, table: str, values: Mapping[str, Floats]) -> None:
    """Raise a ValueError unless a table has all columns (n, c), with numbers that may be theirs."""
    for name, (width, optional) in _columns(state, table).items():
        what = f"tables/{table}/values/{name}"
        if name not in values:
            if optional:
                continue
            raise ValueError(f"{what} is missing")
        found = values[name]
        if found.shape[1] != width:
            raise ValueError(f"{what} has {found.shape[1]} components: need {width}")
        if (np.isinf(found) if name in UNDEFINED else ~np.isfinite(found)).any():
            raise ValueError(f"{what} holds NaN or infinity: need finite numbers")
        if name in FLAGS and not np.isin(found, (0.0, 1.0)).all():
            raise ValueError(f"{what} holds other numbers than 0 and 1")


def _columns(state: ProblemState, table: str) -> dict[str, tuple[int, bool]]:
    """Return the components of the columns of a table, and which columns may be missing."""
    d = state.solid.V.dofmap.index_map_bs
    if table == NODES:
        terms = state.states_of_terms.items()
        columns = {name: (f.function_space.dofmap.bs, False) for name, f in terms}
        columns |= {"displacement": (d, False), "active": (1, False)}
        if state.system.has_friction:
            columns["committed"] = d, False
        columns |= {f"{UNCOMMITTED}active": (1, True), f"{UNCOMMITTED}sliding": (d, True)}
        columns |= {"gained": (d, True), f"{UNCOMMITTED}gained": (d, True)}
        return columns | {"sliding": (d, True), "supports": (2 * d, True), "paired": (d, True)}
    if table == POINTS:
        fields = state.solid.lasting_fields().items()
        columns = {n: (f.function_space.dofmap.bs, n.startswith("shown/")) for n, f in fields}
        return columns | {"material": (1, False)}
    (interface,) = (i for k, i in enumerate(state.interfaces) if name_of(k) == table)
    columns = {f.name: (f.function_space.dofmap.bs, False) for f in interface.functions}
    columns |= dict.fromkeys(SLIPS if interface.rough else (), (1, False))
    multipliers = interface.shown(np.zeros((1, d))).size
    return columns | {"multiplier": (multipliers, False), "carries": (1, False), "near": (1, True)}


# -- what is no nodal value ----------------------------------------------------------------------


def check_about(state: ProblemState, about: Mapping[str, Any], present: Mapping[str, Any]) -> None:
    """Raise an error unless levels, steps and results of interfaces may be those of a problem.

    Args:
        state: the problem.
        about: what a checkpoint says beside its tables.
        present: what `identity.describe` returns, which is that of the checkpoint where it has it.
    """
    newer = {name for name, _ in state.terms}  # of which files of before say nothing
    newer |= {subject_of(k, interface) for k, interface in enumerate(state.interfaces)}
    if missing := present.keys() - about["problem"].keys() - newer:
        raise ValueError(f"problem lacks {', '.join(sorted(missing))}")
    if not isinstance(about["begun"], bool):
        raise ValueError(f"begun is {about['begun']!r}: need true or false")
    _check_numbers("level", about["level"])
    n = len(state.interfaces)
    for name in ("interfaces", "found"):
        if len(about[name]) != n:
            raise ValueError(f"{name} has {len(about[name])} entries, but there are {n} interfaces")
    for k in range(n):
        _check_interface(state, k, about["interfaces"][k], about["found"][k])
    for k, gained in enumerate(about.get("gained", [])):
        _check_gained(f"gained[{k}]", gained)
    for k, step in enumerate(about["steps"]):
        _check_step(state, f"steps[{k}]", step)
    walked, steps = about["walked"], len(about["steps"])
    if not is_integer(walked) or not 0 <= walked <= steps:
        raise ValueError(f"walked is {walked!r}, but there are {steps} steps")
    if about["walk"] is not None:
        _check_walk(about["walk"])


def _check_interface(state: ProblemState, k: int, resultants: Any, found: Any) -> None:
    """Check resultants, None for none, and what `Interface.found` has returned."""
    if resultants is not None:
        for name in RESULTANTS:
            size = state.solid.mesh.geometry.dim if name.endswith("force") else 3
            _check_numbers(f"interfaces[{k}].{name}", resultants[name], (size,))
    own = state.interfaces[k].found()
    if found.keys() != own.keys():
        raise ValueError(
            f"found[{k}] has {', '.join(found) or 'nothing'}, but {state.interfaces[k]} has "
            f"{', '.join(own) or 'nothing'}"
        )
    for name, values in own.items():
        _check_numbers(f"found[{k}].{name}", found[name], (len(values),))


def _check_gained(name: str, gained: Any) -> None:
    """Check what a step has gained, None for nothing."""
    if gained is not None:
        travel = gained["travel"]
        _check_numbers(f"{name}.travel", travel, (len(travel),))
        _check_numbers(f"{name}.duration", gained["duration"])
        if gained["duration"] == 0.0:
            raise ValueError(f"{name}.duration is 0")


def _check_step(state: ProblemState, name: str, step: Any) -> None:
    """Check what is read of a step of the history."""
    _check_numbers(f"{name}.time", step["time"])
    if not is_integer(step["number"]) or step["number"] < 1 or not step["parts"]:
        raise ValueError(
            f"{name} has number {step['number']!r} and {len(step['parts'])} parts: need 1 or more"
        )
    if len(step["forces"]) != len(state.interfaces):
        raise ValueError(f"{name} has {len(step['forces'])} forces: need {len(state.interfaces)}")
    d = state.solid.mesh.geometry.dim
    for k, force in enumerate(step["forces"]):
        _check_numbers(f"{name}.forces[{k}]", force, (d,))
    for k, part in enumerate(step["parts"]):
        if (ledger := part.get("ledger")) is not None:
            _check_ledger(f"{name}.parts[{k}].ledger", Ledger(**ledger), len(state.interfaces), d)


def _check_ledger(name: str, ledger: Ledger, interfaces: int, d: int) -> None:
    """Check the energies of a motion, from which the next step goes on."""
    for key, value in vars(ledger).items():
        if key != "impulses":
            _check_numbers(f"{name}.{key}", value)
    off = ledger.imbalance - ledger.defect * ledger.largest
    if not abs(off) <= HALF_OF_DIGITS * ledger.largest:
        raise ValueError(f"{name} does not add up: its energies and works are off by {off:.3g}")
    if ledger.impulses and len(ledger.impulses) != interfaces:
        raise ValueError(f"{name} has {len(ledger.impulses)} impulses: need {interfaces}")
    for k, impulse in enumerate(ledger.impulses):
        if impulse is not None:
            _check_numbers(f"{name}.impulses[{k}]", impulse, (d,))


def _check_walk(walk: Any) -> None:
    """Check start and tables of a call of `load_steps`, and what there is of its settings."""
    settings = walk.get("settings")
    if not isinstance(settings, dict | None):
        raise ValueError(f"walk.settings is {settings!r}: need values by name")
    if walk.keys() - {"settings"} != {"start", "ramp"}:
        raise ValueError(f"walk has {', '.join(walk)}: need start and ramp")
    _check_numbers("walk.start", walk["start"])
    for k, rows in enumerate(walk["ramp"]):
        table = as_numbers(rows)
        if table is None or table.ndim != 2 or min(table.shape) < 2:
            raise ValueError(f"walk.ramp[{k}] is {rows}: need two rows or more, of equal length")
        if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0.0).any():
            raise ValueError(f"walk.ramp[{k}] is {rows}: need finite numbers, and rising levels")


def _check_numbers(name: str, given: Any, shape: tuple[int, ...] = ()) -> None:
    """Raise a ValueError unless a value of JSON is made of finite numbers, of a shape."""
    numbers = as_numbers(given)
    if numbers is None or numbers.shape != shape or not np.isfinite(numbers).all():
        wanted = f"{shape[0]} finite numbers" if shape else "a finite number"
        raise ValueError(f"{name} is {given!r}: need {wanted}")
