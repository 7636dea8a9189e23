# SPDX-License-Identifier: MIT
"""Comparison of arguments that must agree among ranks: replicated values only.

Numbers, texts, tags, kinds of objects, elements of Functions, UFL signatures, values of Constants;
not values of Functions, dofs, tags of cells, or functions of points.
"""

import dataclasses
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.common.tags import names_of
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr


def check_same_on_all_ranks(comm: MPI.Comm, **named_values: Any) -> None:
    """Raise a ValueError on all ranks where a value differs; collective (16 bytes)."""
    if comm.size == 1:
        return
    texts = dict(part for name, value in named_values.items() for part in _texts(name, value))
    digest = hashlib.sha256(repr(sorted(texts.items())).encode()).digest()[:8]
    own = int.from_bytes(digest, signed=True)
    extremes = np.array([own, ~own])  # ~ reverses the order and cannot overflow
    comm.Allreduce(MPI.IN_PLACE, extremes, op=MPI.MAX)
    if extremes[0] != ~extremes[1]:
        raise ValueError(_difference(comm.allgather(texts)))


def find_constants(value: Any) -> list[Any] | None:
    """Constants in arguments; None with a user's laws, terms, interfaces or functions.

    >>> find_constants({"nu": 0.3}), find_constants([abs])
    ([], None)
    """
    leaves = [leaf for _, leaf in _leaves("", value)]
    known = not any(isinstance(leaf, type) for leaf in leaves)
    return [leaf for leaf in leaves if not isinstance(leaf, str)] if known else None


def _difference(texts: Sequence[Mapping[str, str]]) -> str:
    first, names = texts[0], [name for own in texts for name in own]
    name, rank, other = next(
        (name, rank, own.get(name, "missing"))
        for name in names
        for rank, own in enumerate(texts)
        if own.get(name) != first.get(name)
    )
    return (
        f"{name} differs between the ranks: {first.get(name, 'missing')} on rank 0, but {other} on "
        f"rank {rank}; give all ranks the same"
    )


def _texts(name: str, value: Any) -> list[tuple[str, str]]:
    """Names and texts of parts; on errors the type."""

    def text_of(leaf: Any) -> str:
        named = leaf.__qualname__ if isinstance(leaf, type) else leaf
        return named if isinstance(named, str) else f"Constant {(leaf.value + 0.0).tolist()}"

    try:
        return [(key, text_of(leaf)) for key, leaf in _leaves(name, value)]
    except Exception as error:  # errors may be local to this rank
        return [(name, f"{type(value).__name__} ({type(error).__name__})")]


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Names and texts of parts; a Constant, or the type of a user's object, instead of a text."""
    inside: Mapping[str, Any] = {}
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    text: Any = _plain(value)
    if isinstance(value, fem.Constant) or type(value).__name__.startswith("Constant_"):
        text = value
    elif isinstance(value, fem.Function):
        text = f"Function, {value.ufl_element()}"
    elif isinstance(value, Expr | ufl.Form):
        text = f"Form {value.signature()}" if isinstance(value, ufl.Form) else "Expression"
        inside = {f": Constant {k}": c for k, c in enumerate(extract_constants(value), start=1)}
    elif isinstance(value, fem.DirichletBC):
        space: Any = getattr(value.function_space, "_cpp_object", value.function_space)
        text = f"DirichletBC, component {space.component()}, values of a {type(value.g).__name__}"
        inside = {": value": value.g} if hasattr(value.g, "value") else {}
    elif isinstance(value, mesh.MeshTags):
        text, inside = f"MeshTags of dimension {value.dim}", {".names": names_of(value)}
    elif isinstance(value, Mapping):
        inside = {f"[{key!r}]": value[key] for key in sorted(value, key=repr)}
        text = f"entries for {', '.join(inside) or 'nothing'}"
    elif isinstance(value, list | tuple):
        text, inside = f"{len(value)} entries", {f"[{k}]": v for k, v in enumerate(value)}
    elif text is None:
        ours = type(value).__module__.partition(".")[0] == __name__.partition(".")[0]
        text = type(value).__qualname__ if ours else type(value)
        inside = {f".{key}": entry for key, entry in _fields(value).items()}
    yield name, text
    for key, entry in inside.items():
        yield from _leaves(f"{name}{key}", entry)


def _fields(value: Any) -> Mapping[str, Any]:
    if hasattr(value, "given") and not isinstance(value, type):
        return dict(value.given())
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return {}
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}


def _plain(value: Any) -> str | None:
    """Text that is equal for equal values, None for others.

    >>> _plain(1), _plain(-0.0), _plain(True), _plain("a"), _plain([1])
    ('1.0', '0.0', 'True', "'a'", None)
    """
    if value is None or isinstance(value, bool | str | bytes | complex):
        return repr(value)
    if isinstance(value, Real):
        return repr(float(value) + 0.0)
    if isinstance(value, os.PathLike):
        return repr(os.fspath(value))
    return None
