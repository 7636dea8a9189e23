# SPDX-License-Identifier: MIT
"""Report of a converged step."""
