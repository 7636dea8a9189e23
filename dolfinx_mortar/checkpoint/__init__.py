# SPDX-License-Identifier: MIT
"""Files of values at places, written by any number of ranks and read by any other number.

Fields come as arrays by name and leave as arrays; it must not know what they mean.

io4dolfinx, which does the like, asks for dolfinx 0.10, and on several ranks for ADIOS2 or an h5py
that was built with MPI; Debian has neither. What it does not need, we do not need either: HDF5
files by the usual h5py.
"""

from dolfinx_mortar.checkpoint.json_types import check_form
from dolfinx_mortar.checkpoint.places import find_places, size_of
from dolfinx_mortar.checkpoint.reading import read_about, read_tables
from dolfinx_mortar.checkpoint.writing import Table, check_folder, write

__all__ = [
    "Table",
    "check_folder",
    "check_form",
    "find_places",
    "read_about",
    "read_tables",
    "size_of",
    "write",
]
