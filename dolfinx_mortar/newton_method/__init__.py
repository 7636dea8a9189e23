# SPDX-License-Identifier: MIT
"""One Newton iteration: residuals, QP subproblem, accuracy, line search, convergence."""
