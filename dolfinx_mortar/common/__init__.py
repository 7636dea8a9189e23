# SPDX-License-Identifier: MIT
"""What every layer uses: types and tolerances, checks of arguments, versions of dolfinx."""
