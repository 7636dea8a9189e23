# SPDX-License-Identifier: MIT
"""Drivers: one load step (`newton`), load levels (`load_steps`), bolts (`preload`)."""
