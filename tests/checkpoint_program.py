# SPDX-License-Identifier: MIT
"""Compute load steps with a checkpoint, killed on request before the end; see test_checkpoint.

    checkpoint_program.py CHECKPOINT RESULT STEPS [step|send|write|replace|output|on]

The last argument is the moment of death: on all ranks in the third step; on the last rank while it
sends its part of that step's checkpoint; on rank 0 while it completes the draft, or between the
complete file and its name; on all ranks while they write that step to out.xdmf, with which "on"
goes on. The launcher ends the other ranks, wherever they are.
"""

import json
import os
import signal
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx_mortar.output.writer import File
from dolfinx_mortar.persistence import checkpoints
from tests.cases.pressed_blocks import PressedBlocks

STEEL = dm.VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)
LEVELS = [0.25, 0.5, 1.0, 0.75]  # the last one unloads
COMM = MPI.COMM_WORLD


class Press(PressedBlocks):
    """Two plastic blocks that touch at nodes of both, pressed and sheared on each other."""

    def __init__(
        self, partition="graph", law=STEEL, jitter=0.4, comm=COMM, geometry="updated", **options
    ):
        grid = {"n_lower": (5, 4), "n_upper": (6, 5), "x_upper": (0.0, 0.8), "jitter": jitter}
        super().__init__(comm=comm, partition=partition, **grid)
        self.top.value[:] = 0.0
        self.contact = dm.Contact(self.facets, **({"slave": 3, "master": 4} | options))
        self.problem = self.problem([self.contact], law=law, geometry=geometry)

    def on_time(self, t):
        self.top.value[:] = (0.002 * t, -0.008 * t)

    def walk(self, levels=LEVELS, **options):
        options = {"on_time": self.on_time, "rtol": 1e-12} | options
        return dm.load_steps(self.problem, levels, **options)

    def numbers(self):
        """Return what two runs have to agree in."""
        surface, solid = self.contact.gather(self.problem.u), self.problem.solid
        V, comm = self.problem.V, self.mesh.comm
        n = V.dofmap.index_map.size_local
        X, u = V.tabulate_dof_coordinates()[:n, :2], self.problem.u.x.array[: 2 * n].reshape(-1, 2)
        table = np.concatenate(comm.allgather(np.hstack([X, u])))
        return {
            "force": self.contact.force.tolist(),
            "moment": self.contact.moment.tolist(),
            "pressure": surface["pressure"].tolist(),
            "gap": np.nan_to_num(surface["gap"], nan=-1.0).tolist(),
            "active": surface["active"].tolist(),
            "displacement": table[np.lexsort(np.round(table, 9).T[::-1]), 2:].tolist(),
            "plastic": [solid.max("plastic_strain_norm"), solid.plastic_area()],
            "stress": [solid.max("von_mises"), solid.fields.integral("stress_yy")],
            "history": [[step.number, step.time, *step.forces[0]] for step in self.problem.history],
        }


def die(*args, **options):
    """Be killed at the moment that was asked for, and leave a file of its name as a witness."""
    Path(sys.argv[1]).with_name(sys.argv[4]).touch()
    os.kill(os.getpid(), signal.SIGKILL)


def mortal_writer(write):
    """Return `File._write_rows` after which a rank dies: the first field is in the file."""

    def written(*given):
        write(*given)
        die()

    return written


def main(path, result, steps, moment=""):
    press, made = Press(), []

    def on_time(t):
        press.on_time(t)
        if moment == "step" and made == [1, 2]:
            press.problem.solid.evaluate = die  # when the step has converged

    out = Path(path).with_name("out.xdmf") if moment in ("output", "on") else None
    writer = dm.Writer(out, press.problem, resume=True) if out else None
    for step in press.walk(LEVELS[: int(steps)], on_time=on_time, checkpoint=path):
        made.append(step.number)
        if made == [1, 2, 3] and moment == "output":
            File._write_rows = mortal_writer(File._write_rows)
        if writer is not None:
            writer.write(step.number)
        if made == [1, 2, 3] and moment == "write":
            checkpoints.seal = die
        if made == [1, 2, 3] and moment == "send" and COMM.rank == COMM.size - 1:
            checkpoints._write_rows = die
        if made == [1, 2, 3] and moment == "replace":
            Path.replace = die
    numbers = press.numbers() | {"made": made}
    if COMM.rank == 0:
        Path(result).write_text(json.dumps(numbers))


if __name__ == "__main__":
    main(*sys.argv[1:])
