# SPDX-License-Identifier: MIT
"""A contact problem: arguments, loads, interfaces, and what a step reads at its start."""
