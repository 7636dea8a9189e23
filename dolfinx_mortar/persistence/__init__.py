# SPDX-License-Identifier: MIT
"""The committed state of a problem: how it is saved, compared and restored."""
