# SPDX-License-Identifier: MIT
"""Search, projection and clipping of facets; arrays only, without dofs, ranks or PETSc."""
