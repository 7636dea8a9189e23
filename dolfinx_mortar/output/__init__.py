# SPDX-License-Identifier: MIT
"""Results for ParaView and meshio: one XDMF file over the steps, one grid per step."""

from dolfinx_mortar.output.writer import Writer

__all__ = ["Writer"]
