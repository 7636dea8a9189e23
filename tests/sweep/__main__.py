# SPDX-License-Identifier: MIT
"""The command line: solve a range of random problems and print what came of them."""

import argparse
import dataclasses
import json
import logging
import sys
import textwrap
from pathlib import Path

from tests.sweep.draws import KINDS
from tests.sweep.problems import COMM
from tests.sweep.run import LARGE, LIMIT_LOAD, TANGLED, run

RESIDUALS = ("equilibrium", "gap", "sign", "complementarity", "force", "limit", "slip", "status")


def seeds(text):
    """Return the seeds of "first:end" (without the end), or of one number.

    >>> seeds("3:5"), seeds("7")
    (range(3, 5), range(7, 8))
    """
    first, colon, end = text.partition(":")
    return range(int(first), int(end) if colon else int(first) + 1)


def table(outcomes):
    """Return one line per kind of problem, and one per failure."""
    lines = [
        "kind     seeds  failed  limit loads  beyond small strain  tangled  cuts  "
        "iterations (mean, most)  " + "  ".join(RESIDUALS)
    ]
    for kind in dict.fromkeys(o.kind for o in outcomes):
        mine = [o for o in outcomes if o.kind == kind]
        counts = [n for o in mine for n in o.iterations] or [0]
        failed = sum(o.is_failed for o in mine)
        excuses = (LIMIT_LOAD, LARGE, TANGLED)
        limits, large, tangled = (sum(o.excuse == excuse for o in mine) for excuse in excuses)
        worst = [max((o.residuals.get(name, 0.0) for o in mine), default=0.0) for name in RESIDUALS]
        lines.append(
            f"{kind:8} {len(mine):5} {failed:7} {limits:12} {large:20}"
            f" {tangled:8} {sum(o.cuts for o in mine):5}"
            f" {sum(counts) / len(counts):17.1f}, {max(counts):4}  "
            + "  ".join(f"{w:{len(n)}.1e}" for n, w in zip(RESIDUALS, worst, strict=True))
        )
    for o in outcomes:
        if o.failure:
            what = o.excuse or "FAILED"
            first = textwrap.shorten(o.failure.splitlines()[0], 160)
            lines.append(f"{what}: {o.kind} {o.seed}, {o.steps} steps done: {first}")
    return "\n".join(lines)


def main(arguments=None):
    """Run the sweep; return 1 if any problem failed without an excuse."""
    parser = argparse.ArgumentParser(prog="tests.sweep", description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seeds", type=seeds, default=range(10), help="first:end, as in 0:100")
    parser.add_argument("--surface", choices=["smooth", "facets"], default="smooth")
    parser.add_argument("--output", type=Path, help="a file to which JSON lines are added")
    options = parser.parse_args(arguments)
    outcomes = []
    for kind in options.kinds:
        for seed in options.seeds:
            outcomes.append(run(kind, seed, options.surface))
            if options.output and COMM.rank == 0:
                with options.output.open("a") as file:
                    file.write(json.dumps(dataclasses.asdict(outcomes[-1])) + "\n")
    if COMM.rank == 0:
        print(table(outcomes))
    return int(any(o.is_failed for o in outcomes))


if __name__ == "__main__":
    logging.getLogger("dolfinx_mortar").setLevel(logging.CRITICAL)
    sys.exit(main())
