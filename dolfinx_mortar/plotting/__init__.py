# SPDX-License-Identifier: MIT
"""Pictures in one line each: a mesh with its tags, a field on the deformed bodies, pressures.

    dm.plotting.mesh(*dm.meshing.read_msh("bearing.msh"))
    dm.plotting.field(problem, "von_mises", file="stress.png")
    dm.plotting.pressure(problem)

Bodies in the plane are drawn by matplotlib, bodies in space by PyVista (``pip install
dolfinx_mortar[demo]``), which are imported when the first picture is made. All functions are
collective and gather what they draw on rank 0: for models that fit there. For larger ones there is
`Writer`, and ParaView.
"""

from dolfinx_mortar.plotting.pictures import field, mesh, pressure

__all__ = ["field", "mesh", "pressure"]
