# SPDX-License-Identifier: MIT
"""What a user sees who has not configured logging, and that one who has is left alone."""

import logging
import subprocess
import sys

import pytest

PROGRAM = """
import logging
import dolfinx_mortar
{configure}
logging.getLogger("dolfinx_mortar.steps").warning("no convergence at %g", 0.5)
logging.getLogger("dolfinx_mortar.steps").info("iteration")
logging.getLogger("another").warning("theirs")
"""


def stderr_of(configure):
    program = PROGRAM.format(configure=configure)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()


@pytest.mark.serial
@pytest.mark.parametrize(
    ("configure", "expected"),
    [
        ("", ["WARNING dolfinx_mortar.steps: no convergence at 0.5", "theirs"]),
        (
            "logging.basicConfig(format='%(message)s')",
            ["no convergence at 0.5", "theirs"],
        ),
        (
            "logging.getLogger('dolfinx_mortar').addHandler(logging.NullHandler())",
            ["theirs"],
        ),
    ],
)
def test_level_and_name_of_warnings(configure, expected):
    assert stderr_of(configure) == expected


@pytest.mark.parametrize("logger", [None, "dolfinx_mortar"])
def test_who_has_configured_logging(monkeypatch, logger):
    from dolfinx_mortar.log import LastResort, is_configured

    root, own = logging.getLogger(), logging.getLogger("dolfinx_mortar")
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(own, "handlers", [LastResort()])
    assert not is_configured()
    logging.getLogger(logger).handlers.append(logging.NullHandler())
    assert is_configured()


def test_one_handler_however_often_imported():
    from dolfinx_mortar.log import LastResort, add_last_resort

    add_last_resort()
    handlers = logging.getLogger("dolfinx_mortar").handlers
    assert sum(isinstance(handler, LastResort) for handler in handlers) == 1
