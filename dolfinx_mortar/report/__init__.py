# SPDX-License-Identifier: MIT
"""Report of a converged step: certificate, results of interfaces, reactions, notes, tables."""
