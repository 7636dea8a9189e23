# SPDX-License-Identifier: MIT
"""Closely fitting sides in 3D: a ball in its socket, a pin in a lug, on any mesh and slave."""
