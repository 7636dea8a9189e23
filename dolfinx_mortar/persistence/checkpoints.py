# SPDX-License-Identifier: MIT
"""Checkpoints: saving and restoring the committed state of a problem.

Not the data that a program sets before each step: loads, supports, jumps, changing parameters.
"""

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, maximum, raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arguments import as_numbers
from dolfinx_mortar.common.arrays import SAME, Floats
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.spaces import set_owned
from dolfinx_mortar.common.step_report import LoadStep
from dolfinx_mortar.interfaces.interface import check_owned
from dolfinx_mortar.interfaces.results import Resultants
from dolfinx_mortar.materials.protocol import named_parameters
from dolfinx_mortar.persistence.committed import (
    Before,
    Gained,
    ProblemState,
    SupportForces,
    Walk,
)
from dolfinx_mortar.persistence.tables import (
    PLACES,
    Values,
    find_places,
    read_about,
    read_tables,
    write,
)
from dolfinx_mortar.solid.solid import Solid

NODES, POINTS = "nodes", "integration points"
RESULT = "interfaces[{}]: {}"  # column at nodes
RESULTANTS = ("force", "moment", "master_force", "master_moment", "place")


def save(state: ProblemState, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint, see `ContactProblem.save`."""
    file = check_path(state.comm, path)
    check_owned(state.interfaces, state.supports)
    committed = state.committed
    about = {
        "problem": describe(state),
        "begun": committed.begun,
        "level": committed.level,
        "walked": committed.walked,
        "walk": None if committed.walk is None else dataclasses.asdict(committed.walk),
        "steps": [step.as_dict() for step in committed.history],
        "interfaces": [
            i.resultants and {name: getattr(i.resultants, name) for name in RESULTANTS}
            for i in state.interfaces
        ],
        "gained": committed.gained and (committed.gained.travel, committed.gained.duration),
        "found": [interface.state(False) for interface in state.interfaces],
    }
    values = {NODES: _at_nodes(state), POINTS: _at_points(state)}
    with raised_together(state.comm):
        for name, table in values.items():
            for column, array in table.items():
                # the gap is NaN where a slave node faces no master
                if not column.endswith(" gap") and not np.isfinite(array).all():
                    raise ValueError(f"{name}: {column} holds NaN or infinity: nothing is saved")
    write(state.comm, file, about, values)


def read(state: ProblemState, path: str | os.PathLike[str]) -> "Saved":
    """Read a checkpoint of this problem, from any number of ranks; collective.

    Raises:
        OSError: on all ranks, if it cannot be read.
        ValueError: on all ranks, if it is no checkpoint, damaged, of another version or problem,
            with all differences; or if a later problem uses one of the interfaces.
    """
    file, comm = check_path(state.comm, path), state.comm
    check_owned(state.interfaces, state.supports)
    about = read_about(comm, file)
    tables: dict[str, dict[str, Floats]] = {}
    wrong = differences(about["problem"], describe(state))
    if not wrong:
        size = maximum(comm, np.abs(state.solid.mesh.geometry.x).max(initial=0.0))[0]
        spaces = {NODES: state.solid.V, POINTS: state.solid.stress.function_space}
        places = {name: find_places(V) for name, V in spaces.items()}
        tables, others = read_tables(comm, file, about, places, float(size))
        wrong = [f"{name}: {text}" for name, text in others.items()]
    if not wrong:
        other = tables[POINTS]["material"] != material_numbers(state.solid)
        moved = comm.allreduce(int(other.sum()), op=MPI.SUM)
        wrong = [f"solid: {moved} integration points have another material"] if moved else []
    if wrong:
        raise ValueError(
            f"path is {str(file)!r}, a checkpoint of another problem: {'; '.join(wrong)}"
        )
    return Saved(state, about, tables, [LoadStep.from_dict(step) for step in about["steps"]])


@dataclass(frozen=True)
class Saved:
    """A checkpoint of this problem, read, but not yet restored."""

    state: ProblemState
    about: Mapping[str, Any]
    tables: Values
    steps: list[LoadStep]

    @property
    def walk(self) -> list[float]:
        """The levels of the last call of `load_steps`."""
        return [step.time for step in self.steps[len(self.steps) - self.about["walked"] :]]

    def put(self) -> None:
        """Restore it, or raise an error on all ranks and change nothing; collective."""
        before = Before(self.state, None)
        try:
            self._put()
        except BaseException:
            before.restore()
            raise

    def _put(self) -> None:
        state, committed, about = self.state, self.state.committed, self.about
        nodes, points = self.tables[NODES], self.tables[POINTS]
        with raised_together(state.comm):
            for interface, found in zip(state.interfaces, about["found"], strict=True):
                interface.restore({name: np.array(v, float) for name, v in found.items()})
        for name, f in {"displacement": state.solid.u, **state.states_of_terms}.items():
            set_owned(f, nodes[name])
        for name, f in state.solid.points.lasting_fields().items():
            known = name if name in points else name.replace("shown/", "committed/")
            set_owned(f, points[known])
        state.solid.forms.committed.forget()
        for k in range(len(state.interfaces)):
            self._put_results(k, nodes)
        # without a column of directions, steps begin stuck
        committed.active, committed.sliding = nodes["active"][:, 0] > 0.0, nodes.get("sliding")
        committed.displacement = nodes.get("committed", nodes["displacement"]).flatten()
        committed.slid[:], committed.dissipated[:] = nodes["slid"].T, nodes["dissipated"].T
        # displacement of the pairing, empty for X
        committed.paired = np.zeros(0) if state.geometry == "reference" else None
        if "paired" in nodes:
            committed.paired = nodes["paired"].flatten()
        committed.supports = committed.gained = None
        if "supports" in nodes:
            committed.supports = SupportForces(*np.split(nodes["supports"], 2, axis=1))
        if about["gained"] is not None:
            travel, duration = about["gained"]
            committed.gained = Gained(nodes["gained"].flatten(), np.array(travel, float), duration)
        committed.begun, committed.level = about["begun"], about["level"]
        committed.walk = None if about["walk"] is None else Walk(**about["walk"])
        committed.walked, committed.brought = about["walked"], len(self.steps)
        committed.history[:] = self.steps
        state.system.faced = True

    def _put_results(self, k: int, values: Mapping[str, Floats]) -> None:
        state, interface = self.state, self.state.interfaces[k]
        resultants, nodes = self.about["interfaces"][k], state.system.sides[k].nodes
        interface.clear()
        if resultants is None:
            return
        multiplier, carries = (
            values[RESULT.format(k, n)][nodes] for n in ("multiplier", "carries")
        )
        interface.resultants = Resultants(
            **{name: np.array(v, float) for name, v in resultants.items()},
            multiplier=multiplier[:, 0] if interface.unilateral else multiplier,
            nodes=nodes,
            carries=carries[:, 0] > 0.0,
        )
        for name, function in interface.nodal.items():
            set_owned(function, values[RESULT.format(k, name)])
        interface.sum_up(state.comm, nodes)


def _at_nodes(state: ProblemState) -> dict[str, Floats]:
    u, committed = _owned(state.solid.u), state.committed
    found = {
        PLACES: find_places(state.solid.V),
        "displacement": u,
        "slid": committed.slid.T,
        "dissipated": committed.dissipated.T,
    }
    found["active"] = committed.active[:, None].astype(float)
    if state.system.has_friction and committed.sliding is not None:
        found["sliding"] = committed.sliding
    if committed.gained is not None:
        found["gained"] = committed.gained.by.reshape(u.shape)
    if (paired := committed.paired) is not None and len(paired):
        found["paired"] = paired.reshape(u.shape)
    if (supports := committed.supports) is not None:
        found["supports"] = np.hstack([supports.forces, supports.points])
    if state.system.has_friction:  # slips are measured from it
        found["committed"] = committed.displacement.reshape(u.shape)
    for k, (interface, side) in enumerate(zip(state.interfaces, state.system.sides, strict=True)):
        if (results := interface.resultants) is not None:
            own = {"multiplier": np.atleast_2d(results.multiplier.T).T}
            for name, rows in (own | {"carries": results.carries[:, None]}).items():
                found[RESULT.format(k, name)] = np.zeros((len(u), rows.shape[1]))
                found[RESULT.format(k, name)][side.nodes] = rows
            found |= {RESULT.format(k, name): _owned(f) for name, f in interface.nodal.items()}
    return found | {name: _owned(f) for name, f in state.states_of_terms.items()}


def _at_points(state: ProblemState) -> dict[str, Floats]:
    fields = {name: _owned(f) for name, f in state.solid.points.lasting_fields().items()}
    for name in [name for name in fields if name.startswith("shown/")]:
        differs = not np.array_equal(fields[name], fields[name.replace("shown/", "committed/")])
        if not any_rank(state.comm, differs)[0]:
            del fields[name]
    places = find_places(state.solid.stress.function_space)
    return {PLACES: places, "material": material_numbers(state.solid)} | fields


def _owned(f: fem.Function) -> Floats:
    dofmap = f.function_space.dofmap
    return np.asarray(f.x.array.reshape(-1, dofmap.bs)[: dofmap.index_map.size_local])


def describe(state: ProblemState) -> dict[str, Any]:
    """Identity of a problem on any ranks, by argument; collective.

    Without loads, supports and changing parameters. Laws are known by name, not by their code.
    """
    solid, V = state.solid, state.solid.V
    domain, fields = V.mesh, solid.points.lasting_fields() | state.states_of_terms
    materials = [material for region in solid.regions for material, _ in region.parts]
    found = {
        "mesh: dimension": domain.geometry.dim,
        "mesh: cell": domain.topology.cell_name(),
        "mesh: degree": compat.cell_degree(domain),
        "displacement: degree": V.element.basix_element.degree,
        "solid: kinematics": solid.kinematics.name,
        "solid: quadrature_degree": solid.quadrature_degree,
        "solid: volumetric": solid.volumetric,
        "solid: materials": ", ".join(type(material).__name__ for material in materials),
        "problem: geometry": state.geometry,
        "problem: interfaces": ", ".join(map(repr, state.interfaces)),
    }
    found |= {f"components of {name}": f.function_space.dofmap.bs for name, f in fields.items()}
    for k, material in enumerate(materials):
        for name, value in named_parameters(material).items():
            subject = f"material {k}, {type(material).__name__}: {name}"
            found[subject] = float(value) if isinstance(value, Real) else "changing"
    names = [name for name, _ in state.terms]
    identities = dict(zip(names, state.ask_terms("identity"), strict=True))
    for k, interface in enumerate(state.interfaces):
        if interface.rigid is not None:
            identities[f"interfaces[{k}], {interface!r}"] = interface.rigid.identity
    return found | {f"{i}: {n}": v for i, values in identities.items() for n, v in values.items()}


def material_numbers(solid: Solid) -> Floats:
    """Number of the material (points, 1) at the owned points."""
    dofmap = solid.stress.function_space.dofmap
    numbers = np.zeros((solid.stress.x.array.size // dofmap.bs, 1))
    for k, (_, cells) in enumerate(part for region in solid.regions for part in region.parts):
        numbers[dofmap.list[cells].ravel()] = k
    return numbers[: dofmap.index_map.size_local]


def differences(saved: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    """Differences of two problems in words."""
    told = []
    for name in {**present, **saved}:
        before, now = saved.get(name, "missing"), present.get(name, "missing")
        a, b = as_numbers(before), as_numbers(now)
        if isinstance(now, list) and a is not None and b is not None and a.shape == b.shape:
            off = float(np.abs(a - b).max(initial=0.0))
            if off > SAME * np.abs(b).max(initial=0.0):
                told.append(f"{name} is off by up to {off:.3g} from the checkpoint")
        elif before != now:
            told.append(f"{name} is {now!r}, in the checkpoint {before!r}")
    return told
