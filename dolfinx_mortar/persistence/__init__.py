# SPDX-License-Identifier: MIT
"""What goes on from step to step, and how it is saved, checked and taken over.

Knows nothing of how a step is solved.
"""
