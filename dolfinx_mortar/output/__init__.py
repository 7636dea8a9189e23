# SPDX-License-Identifier: MIT
"""Results for ParaView and meshio: one XDMF file over the steps, one grid per step.

Fields are Functions by name; their meaning plays no part, nor how a problem has computed them.
"""

from dolfinx_mortar.output.writer import Writer

__all__ = ["Writer"]
