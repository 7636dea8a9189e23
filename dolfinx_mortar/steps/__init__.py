# SPDX-License-Identifier: MIT
"""The drivers: one load step (`newton`), load levels (`load_steps`), bolts (`preload`)."""
