# SPDX-License-Identifier: MIT
"""Contact and tying: what a mortar pair constrains, and the basis in which that is a bound.

Frames of slave nodes, claims of several interfaces on one node, the change of basis u = T y.
Knows nothing of materials.
"""
