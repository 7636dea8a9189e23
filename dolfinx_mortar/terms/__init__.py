# SPDX-License-Identifier: MIT
"""What adds energy, forces and stiffness: the terms of a problem, and their sum.

Knows nothing of contact, Newton's method or load levels.
"""
