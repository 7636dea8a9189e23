# SPDX-License-Identifier: MIT
"""Results for ParaView and meshio: one XDMF file over the steps, one grid per step.

Fields come as Functions by name and leave as files; it must not know what they mean, nor how a
problem found them.
"""

from dolfinx_mortar.output.writer import Writer

__all__ = ["Writer"]
