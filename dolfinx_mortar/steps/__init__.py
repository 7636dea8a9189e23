# SPDX-License-Identifier: MIT
"""A load step: arguments, audit, linearisation, Newton's method, certificate, load levels, reports.

Joins the solid and the interfaces to a bound-constrained QP and lets a backend solve it.
Knows nothing of the insides of a backend.
"""
