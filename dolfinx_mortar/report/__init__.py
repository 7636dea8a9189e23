# SPDX-License-Identifier: MIT
"""The report of a converged step: certificate, results of interfaces, reactions, notes, tables."""
