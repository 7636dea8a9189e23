# SPDX-License-Identifier: MIT
"""The two files of a writer: ownership, space on the disk, the XML document."""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from mpi4py import MPI

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import check, instance
from dolfinx_mortar.disk import (
    demand_space,
    draft_of,
    is_checkpoint,
    replace_by_draft,
    space_for,
)

# The open writers of this program by path, on rank 0: one for each file.
_WRITERS: WeakValueDictionary[Path, Any] = WeakValueDictionary()
# Characters that XML cannot hold.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def claim_files(comm: MPI.Comm, path: Path, data: Path, writer: Any, *, resume: bool) -> None:
    """Reserve both files for one writer; collective.

    Earlier files of these names are removed, except an XDMF file that is resumed.

    Raises:
        ValueError: on all ranks, if rank 0 cannot create them or another writer has them.
    """
    with raised_together(comm):
        if comm.rank == 0:
            if path.resolve() in _WRITERS:
                raise ValueError(f"path is {str(path)!r}, open in another Writer: close it first.")
            try:
                if is_checkpoint(data):
                    raise ValueError(
                        f"path is {str(path)!r}: its numbers would go to {str(data)!r}, which is a "
                        "checkpoint; choose another name."
                    )
                if not resume:
                    path.unlink(missing_ok=True)
                with data.open("wb"):
                    pass
            except OSError as error:
                raise ValueError(
                    f"path is {str(path)!r}, which cannot be written ({error.strerror}); choose an "
                    "existing, writable folder."
                ) from error
            _WRITERS[path.resolve()] = writer


def release_files(path: Path, writer: Any) -> None:
    """Make the files available to other writers."""
    if _WRITERS.get(path.resolve()) is writer:
        del _WRITERS[path.resolve()]


def demand_space_for_step(comm: MPI.Comm, path: Path, data: Path, size: int, fields: int) -> None:
    """Raise on all ranks unless the HDF5 file can grow by what a step needs; collective.

    A disk that is full during a parallel write leaves a broken file and a deadlock.

    Args:
        comm: communicator.
        path: the XDMF file.
        data: the HDF5 file.
        size: bytes of the values of this rank.
        fields: number of fields.
    """
    total = space_for(fields, comm.allreduce(size))
    with raised_together(comm):
        if comm.rank == 0:
            total += path.stat().st_size if path.exists() else 0  # its next version
            demand_space(data, total)


def create_tree(notes: Mapping[str, Any]) -> tuple[ET.Element, ET.Element]:
    """Return the XDMF document and its collection of steps.

    Raises:
        ValueError: for notes that are no texts and no JSON values.
    """
    root = ET.Element("Xdmf", Version="3.0")
    domain = ET.SubElement(root, "Domain")
    steps = ET.SubElement(domain, "Grid", Name="steps", GridType="Collection")
    steps.set("CollectionType", "Temporal")
    check("notes", notes, instance(Mapping, "give a dictionary, name -> text or JSON value"))
    for name, note in notes.items():
        ET.SubElement(domain, "Information", Name=_xml("notes", name), Value=_note(name, note))
    return root, steps


def _note(name: str, note: Any) -> str:
    """Return a note as text: texts as they are, other values in JSON."""
    if isinstance(note, str):
        return _xml(f"notes[{name!r}]", note)
    try:
        return json.dumps(note, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"notes[{name!r}] = {note!r} is no text and no JSON value.") from error


def _xml(what: str, text: Any) -> str:
    """Return a text if XML can hold it."""
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{what}: {text!r} is no text that XML can hold.")
    return text


def field_keys(names: Iterable[str]) -> dict[str, str]:
    """Return the name of each field in the HDF5 file: letters, digits and underscores.

    Raises:
        ValueError: if two fields have names that differ only in other characters or in case.

    >>> field_keys(["von Mises", "p [MPa]"])
    {'von Mises': 'von_Mises', 'p [MPa]': 'p_MPa_'}
    """
    keys = {name: re.sub(r"[^A-Za-z0-9]+", "_", _xml("output fields", name)) for name in names}
    first: dict[str, str] = {}
    for name, key in keys.items():
        other = first.setdefault(key.lower(), name)
        if other != name:
            raise ValueError(
                f"output fields {other!r} and {name!r} would have one name in the file, {key!r}: "
                "rename one so that they differ in letters or digits, whatever the case."
            )
    return keys


def replace_tree(comm: MPI.Comm, path: Path, root: ET.Element) -> None:
    """Replace the XDMF file in one move; collective.

    Raises:
        OSError: on all ranks, naming the file.
    """
    with raised_together(comm):
        if comm.rank == 0:
            ET.indent(root)
            try:
                draft_of(path).write_bytes(ET.tostring(root, "utf-8", xml_declaration=True))
                replace_by_draft(path)
            except OSError as error:
                draft_of(path).unlink(missing_ok=True)
                raise OSError(error.errno, error.strerror, str(path)) from error
