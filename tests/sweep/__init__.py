# SPDX-License-Identifier: MIT
"""Random problems, solved by the public API and checked again from public operators alone."""
