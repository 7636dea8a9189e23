# SPDX-License-Identifier: MIT
"""A contact problem: arguments, loads, interfaces, and the data of a step."""
