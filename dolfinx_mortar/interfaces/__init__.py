# SPDX-License-Identifier: MIT
"""Contact and tying: constraints, and the basis in which each is a bound on one unknown.

Frames of slave nodes, claims of several interfaces on one node, the change of basis u = T y.
Knows nothing of materials.
"""
