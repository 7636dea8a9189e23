# SPDX-License-Identifier: MIT
"""One Newton iterate: residuals, the QP made of them, the step length, when it is done.

Knows nothing of the insides of a backend, and nothing of load levels.
"""
