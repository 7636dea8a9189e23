# SPDX-License-Identifier: MIT
"""The terms of a problem, which add energy, forces and stiffness, and their sum.

Knows nothing of contact, Newton's method or load levels.
"""
