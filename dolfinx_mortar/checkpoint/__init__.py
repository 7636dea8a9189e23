# SPDX-License-Identifier: MIT
"""Files of values at places, written by any number of ranks and read by any other number.

Fields are arrays by name; their meaning plays no part. io4dolfinx has the same purpose, but needs
dolfinx 0.10 and, on several ranks, ADIOS2 or an h5py with MPI, which Debian does not have. Here an
h5py without MPI is enough.
"""

from dolfinx_mortar.checkpoint.places import find_places, size_of
from dolfinx_mortar.checkpoint.tables import Table, check_folder, read_about, read_tables, write

__all__ = [
    "Table",
    "check_folder",
    "find_places",
    "read_about",
    "read_tables",
    "size_of",
    "write",
]
