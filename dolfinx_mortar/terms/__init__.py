# SPDX-License-Identifier: MIT
"""Terms of a problem, which add energy, forces and stiffness, and their sum."""
