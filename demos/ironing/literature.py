# SPDX-License-Identifier: MIT
"""Published forces of shallow ironing with a friction coefficient of 0.3.

Read off curves as they are collected in the benchmarks of solids4foam (solid-benchmarks,
hyperElasticity/shallowIroning), per 1 mm of thickness. The problem is that of K. A. Fischer, P.
Wriggers, "Mortar based frictional contact formulation for higher order interpolations using the
moving friction cone", Comput. Methods Appl. Mech. Engrg. 195 (2006) 5020-5036.
"""

FORCES = {  # program: (V, H) in N at t = 1, when the tool is down, and at t = 1.5, half way along
    "Code_Aster SSNP153": ((332.0, 71.0), (421.0, 143.3)),
    "Hartmann 2009": ((319.5, 67.2), (408.4, 160.2)),
    "Fischer, Wriggers 2006": ((297.9, 62.1), (365.1, 188.8)),
    "Yastrebov 2011": ((289.7, 58.5), (359.5, 170.8)),
    "Poulios, Renard 2015": ((267.9, 55.3), (337.5, 102.1)),
    "solids4foam": ((316.4, 55.0), (395.1, 122.7)),
}
