# SPDX-License-Identifier: MIT
"""Faster compilation of forms, which takes a third of a run of the tests with empty caches.

Measured over 128 forms, processor time of each: 171 ms without all this, 128 ms with it. Forms that
are compiled already are found and loaded only once by each process, and cells of elements made
once: 13.9 s instead of 16.3 s for 77 tests with full caches, 74 s instead of 79 s for 301 tests
with empty ones.
"""

import functools
import importlib.metadata
import os
import subprocess
import sysconfig

import basix.ufl
import ufl
from ffcx.codegeneration import jit

# As the sources that cffi writes begin: the compiler takes the precompiled header for these lines,
# or reads them where its options do not fit.
HEADER = """
#define _CFFI_
#include <pyconfig.h>
#if !defined(Py_DEBUG) && !defined(Py_TRACE_REFS) && !defined(Py_REF_DEBUG)
#define Py_LIMITED_API
#endif
#include <Python.h>
"""
SAME = ["-x", "c-header", "-std=c17", "-O0", "-g0"]  # the last two as in tests/config


def know_what_stays():
    """Find what libraries look for again and again only once."""
    # setuptools starts the compiler for each module of kernels, and six times reads the entry
    # points of all installed packages, which stay the same during a run.
    importlib.metadata.entry_points = functools.cache(importlib.metadata.entry_points)
    # An element makes its cell, and that the cells of all its parts, whenever it is asked for it.
    cell = functools.cache(ufl.Cell)
    basix.ufl._ElementBase.cell = property(lambda element: cell(element._cellname))
    jit.get_cached_module = _loaded_once(jit.get_cached_module)


def _loaded_once(load):
    """Return a function that loads a module of kernels once, and not for each equal form.

    Each time FFCx lists the folder of all modules, which has some thousand files, and the linker
    opens one.
    """
    loaded = {}

    @functools.wraps(load)
    def get(name, objects, folder, timeout):
        key = name, tuple(objects), str(folder)
        if key not in loaded:
            found = load(name, objects, folder, timeout)
            if found[0] is None:  # to be compiled first
                return found
            loaded[key] = found
        return loaded[key]

    return get


def precompile(folder):
    """Let the compiler read the header of Python once, which is most of what it reads for a form.

    Programs that tests start inherit it.
    """
    path = folder / "python_header.h"
    path.write_text(HEADER)
    names = ("CC", "CFLAGS", "CCSHARED")
    command = " ".join(sysconfig.get_config_var(name) or "" for name in names).split()
    command += [f"-I{sysconfig.get_path('include')}", *SAME, str(path), "-o", f"{path}.gch"]
    if subprocess.run(command, capture_output=True).returncode == 0:
        os.environ["CPPFLAGS"] = f"{os.environ.get('CPPFLAGS', '')} -include {path}"
