# SPDX-License-Identifier: MIT
"""The committed state of a problem: saved, compared and restored."""
