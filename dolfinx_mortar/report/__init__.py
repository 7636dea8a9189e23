# SPDX-License-Identifier: MIT
"""What a converged step tells: certificate, results of interfaces, reactions, notes, tables."""
