# SPDX-License-Identifier: MIT
"""The numbers that all of the floor shares: round-off, a limit of rounds, a share of tolerances."""

import numpy as np

EPS = float(np.finfo(np.float64).eps)
ROUND_OFF = 16.0
"""Round-off of A x, in units of eps |diag(A) x|: rows of a stiffness have 10 to 100 entries."""
LIMIT = 100
"""Rounds of anything that ends by a rule of its own; no problem met so far needs half as many."""
PATIENCE = 20
"""Solves of sets with friction that come no nearer to the law; of 40 random problems (sweep
friction, seeds 0 to 39: 938 QPs), whose sets all settle, none has more than 7 of them in a row."""
SHARE = 0.5
"""Who works for a check takes this share of its tolerance: its scale may shrink meanwhile."""
