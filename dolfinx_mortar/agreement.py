# SPDX-License-Identifier: MIT
"""Arguments that must be the same on all ranks, compared by one digest; for all modules.

Every rank runs the same program, so a number, a name or a law that is not the same on all of them
makes a mixture of problems, or ranks that wait for each other in different places. Whatever a user
gives is taken apart into replicated values: numbers, texts, tags, kinds of objects, elements of
Functions, signatures of UFL, and the values of Constants. Values of Functions, dofs and tags of
cells belong to the parts of the mesh, and may differ; so may what a function of points returns.
"""

import dataclasses
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from numbers import Complex, Real
from typing import Any, Protocol, runtime_checkable

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.tags import names_of
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

SHOWN = 60  # characters of a value in a message, at most


@runtime_checkable
class Described(Protocol):
    """Something that tells what its user has given for it."""

    def given(self) -> Mapping[str, Any]:
        """Return the arguments, which all ranks have to give the same, by name."""


def check_same_on_all_ranks(comm: MPI.Comm, **named_values: Any) -> None:
    """Raise a ValueError on all ranks where a value is not the same on all of them; collective.

    One reduction of 16 bytes; the ranks tell each other more only where they differ. Nothing that
    is given can raise another error here, which one rank might meet alone.

    Args:
        **named_values: the values by the names that the error shall use.

    Raises:
        ValueError: naming the first value that differs, and what ranks give for it.
    """
    if comm.size == 1:
        return
    texts = dict(part for name, value in named_values.items() for part in _parts_of(name, value))
    digest = hashlib.sha256(repr(sorted(texts.items())).encode()).digest()[:8]
    own = int.from_bytes(digest, signed=True)
    extremes = np.array([own, ~own])  # ~ turns the order round, and cannot overflow
    comm.Allreduce(MPI.IN_PLACE, extremes, op=MPI.MAX)
    if extremes[0] != ~extremes[1]:
        raise ValueError(_difference(comm.allgather(texts)))


def find_constants(value: Any) -> list[Any] | None:
    """Return the Constants in what a user has given; None where an object is not known inside.

    That is what a user has programmed: laws, terms, interfaces, functions of points.

    >>> find_constants({"nu": 0.3}), find_constants([abs])
    ([], None)
    """
    if _is_constant(value):
        return [value]
    if isinstance(value, Expr | ufl.Form):
        return list(extract_constants(value))
    if _plain(value) is not None or isinstance(value, mesh.MeshTags):
        return []
    package = type(value).__module__.partition(".")[0]
    ours = package in ("dolfinx", __name__.partition(".")[0]) or isinstance(value, Mapping)
    if not (ours or isinstance(value, list | tuple)):
        return None
    found: list[Any] = []
    for entry in _taken_apart("", value)[1].values():
        inside = find_constants(entry)
        if inside is None:
            return None
        found += inside
    return found


def _difference(texts: Sequence[Mapping[str, str]]) -> str:
    """Say what the first value is in which ranks differ, from the texts of all ranks."""
    for name in dict.fromkeys(name for own in texts for name in own):
        every = [own.get(name, "missing") for own in texts]
        others = [rank for rank, text in enumerate(every) if text != every[0]]
        if others:
            break
    differing = (k for k, at in enumerate(zip(*every, strict=False)) if len({*at}) > 1)
    same = next(differing, SHOWN)
    start = max(same - SHOWN // 3, 0) if max(map(len, every)) > SHOWN else 0
    told = [f"{_excerpt(text, start)} on rank {rank}" for rank, text in enumerate(every)]
    more = f" and {len(others) - 3} more" if len(others) > 3 else ""
    return (
        f"{name} differs between the ranks: {told[0]}, but "
        f"{', '.join(told[rank] for rank in others[:3])}{more}; give all ranks the same"
    )


def _excerpt(text: str, start: int) -> str:
    """Return some characters of a text, from one of them on.

    >>> _excerpt("[1.0]", 0), _excerpt("Constant [1.0, 2.0]", 9)
    ('[1.0]', '... [1.0, 2.0]')
    """
    end = start + SHOWN
    return f"{'... ' if start else ''}{text[start:end]}{' ...' if end < len(text) else ''}"


def _is_constant(value: Any) -> bool:
    """Tell whether a value is a Constant of dolfinx, wrapped or not."""
    return isinstance(value, fem.Constant) or type(value).__name__.startswith("Constant_")


def _parts_of(name: str, value: Any) -> list[tuple[str, str]]:
    """Return names and texts of the replicated parts; what fails to tell counts by its type."""
    try:
        return list(_parts(name, value))
    except Exception as error:  # of this rank only, perhaps, which must not leave the others alone
        return [(name, f"{type(value).__name__} ({type(error).__name__})")]


def _parts(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the replicated parts of a value."""
    inside: Mapping[str, Any] = {}
    if _is_constant(value):
        yield name, f"Constant {_plain(np.asarray(value.value))}"
    elif isinstance(value, fem.Function):
        yield name, f"Function, {value.ufl_element()}"
    elif isinstance(value, Expr | ufl.Form):
        yield name, f"{type(value).__name__} {_signature(value)}"
        constants = extract_constants(value)
        inside = {f"{name}: Constant {k}": c for k, c in enumerate(constants, start=1)}
    elif (text := _plain(value)) is not None:
        yield name, text
    else:
        text, inside = _taken_apart(name, value)
        yield name, text
    for key, entry in inside.items():
        yield from _parts(key, entry)


def _taken_apart(name: str, value: Any) -> tuple[str, Mapping[str, Any]]:
    """Return what a value is, and what it holds by the name of that."""
    kind = type(value).__qualname__
    if isinstance(value, fem.DirichletBC):
        space: Any = getattr(value.function_space, "_cpp_object", value.function_space)
        constant = hasattr(value.g, "value")
        of = f", component {space.component()}" if space.component() else ""
        text = f"{kind}{of}, values of a {'Constant' if constant else 'Function'}"
        return text, {f"{name}: value": value.g} if constant else {}
    if isinstance(value, mesh.MeshTags):
        return f"{kind} of dimension {value.dim}", {f"{name}.names": names_of(value)}
    if isinstance(value, Mapping):
        entries = sorted(value.items(), key=lambda item: repr(item[0]))
        return (
            f"entries for {', '.join(repr(key) for key, _ in entries) or 'nothing'}",
            {f"{name}[{key!r}]": entry for key, entry in entries},
        )
    if isinstance(value, list | tuple):
        return f"{len(value)} entries", {f"{name}[{k}]": entry for k, entry in enumerate(value)}
    fields: Mapping[str, Any] = {}
    if not isinstance(value, type):
        if isinstance(value, Described):
            fields = value.given()
        elif dataclasses.is_dataclass(value):
            fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return kind, {f"{name}.{key}": entry for key, entry in fields.items()}


def _plain(value: Any) -> str | None:
    """Return a text that is the same for equal values, None for what is no number or text.

    >>> _plain([1, np.float64(-0.0)]), _plain(np.array([[2.0]])), _plain(("a", None, True))
    ('[1.0, 0.0]', '[[2.0]]', "['a', None, True]")
    """
    if isinstance(value, np.generic):
        return _plain(value.item())
    if value is None or isinstance(value, bool | str | bytes):
        return repr(value)
    if isinstance(value, os.PathLike):
        return repr(os.fspath(value))
    if isinstance(value, Real):
        return repr(float(value) + 0.0)  # -0.0 is no other number
    if isinstance(value, Complex):
        return repr(complex(value))
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if not isinstance(value, list | tuple):
        return None
    texts = [_plain(entry) for entry in value]
    return None if None in texts else f"[{', '.join(map(str, texts))}]"


def _signature(value: Expr | ufl.Form) -> str:
    """Return what tells a form or an expression from others, whatever else a rank has created.

    Numbers in it count, as do the elements of Functions; values of Constants and Functions do not.
    """
    if isinstance(value, Expr):
        domain = extract_unique_domain(value)
        if domain is None:
            return str(value)
        value = ufl.inner(value, value) * ufl.dx(domain)
    return str(value.signature())
