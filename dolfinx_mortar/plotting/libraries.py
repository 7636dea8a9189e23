# SPDX-License-Identifier: MIT
"""The libraries that draw, imported when they are needed, and a screen for them."""

from __future__ import annotations

import atexit
import ctypes
import ctypes.util
import importlib
import os
import shutil
import subprocess
import sys
from typing import Any


def require(name: str) -> Any:
    """Return a module.

    Raises:
        ImportError: if it is not installed; the message names the extra that brings it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        library = name.partition(".")[0]
        raise ImportError(
            f"{library} is needed for this picture and cannot be imported ({error}): pip install "
            f"'dolfinx_mortar[demo]', or the package python3-{library}.",
            name=name,
        ) from error


def find_screen() -> bool:
    """Make sure that VTK can draw; return whether without a window.

    Where no X server answers, one in memory (Xvfb) is started for the rest of the program.

    Raises:
        RuntimeError: if there is neither; VTK itself would end the program.
    """
    if sys.platform in ("darwin", "win32") or _answers(os.environ.get("DISPLAY", "")):
        return os.environ.get("DISPLAY", "") == _started.get("display", None)
    if shutil.which("Xvfb") is not None and _start():
        return True
    if require("pyvista").vtk_version_info >= (9, 4):  # draws in memory by EGL or OSMesa
        os.environ.pop("DISPLAY", None)
        return True
    raise RuntimeError(
        "there is no screen to draw on in 3D: no X server answers at DISPLAY = "
        f"{os.environ.get('DISPLAY', '')!r}. Install Xvfb (apt-get install xvfb), or a VTK from "
        "9.4 on, which draws in memory."
    )


_started: dict[str, str] = {}  # the screen of our own, if any


def _answers(display: str) -> bool:
    """Tell whether an X server answers at a display."""
    if not display:
        return False
    library = ctypes.util.find_library("X11")
    if library is None:
        return True  # nobody to ask
    x11 = ctypes.CDLL(library)
    x11.XOpenDisplay.restype = ctypes.c_void_p  # not the integer of 32 bits that is the default
    connection = x11.XOpenDisplay(display.encode())
    if connection:
        x11.XCloseDisplay(ctypes.c_void_p(connection))
    return bool(connection)


# The server ends when its input does: with the program, however that ends.
SERVER = """
Xvfb -displayfd 1 -screen 0 1600x1200x24 -nolisten tcp &
exec >/dev/null
read -r end
kill $!
wait
"""


def _start() -> bool:
    """Start an X server in memory and tell the program of it; tell whether that worked."""
    server = subprocess.Popen(
        ["/bin/sh", "-c", SERVER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # or Ctrl-C would end it, and the next picture the program
    )
    assert server.stdout is not None
    with server.stdout as pipe:
        number = pipe.readline().decode().strip()
    if not number:
        _end(server)
        return False
    _started["display"] = os.environ["DISPLAY"] = f":{number}"
    atexit.register(_stop, server)
    return True


def _stop(server: subprocess.Popen[bytes]) -> None:
    """Close what is drawn, then end the X server: the other way round it would end us."""
    if "pyvista" in sys.modules:
        sys.modules["pyvista"].close_all()
    os.environ.pop("DISPLAY", None)
    _end(server)


def _end(server: subprocess.Popen[bytes]) -> None:
    assert server.stdin is not None
    server.stdin.close()
    server.wait()
