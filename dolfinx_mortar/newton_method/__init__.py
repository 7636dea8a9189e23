# SPDX-License-Identifier: MIT
"""One Newton iteration: residuals, the QP subproblem, its accuracy, line search, convergence.

Independent of the QP backend and of load levels.
"""
