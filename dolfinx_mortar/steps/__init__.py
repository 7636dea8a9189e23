# SPDX-License-Identifier: MIT
"""Drivers: one load step (`newton`), load levels (`load_steps`), time (`time_steps`)."""
