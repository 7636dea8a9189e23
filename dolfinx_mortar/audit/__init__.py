# SPDX-License-Identifier: MIT
"""Checks before the first step: mesh, sides, partners, unconstrained bodies."""
