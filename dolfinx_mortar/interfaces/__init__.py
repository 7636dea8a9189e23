# SPDX-License-Identifier: MIT
"""Contact and tying: constraints, and the basis in which each is a bound on one unknown."""
