# SPDX-License-Identifier: MIT
"""An interactive view of a result as one file of HTML, by PyVista's static export, offline.

PyVista asks VTK's web module for a list of objects. Debian builds VTK without it; that list is all
that a static export needs, so where the module is missing the list below stands in.
"""

import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


class ObjectIds:
    """The part of vtkObjectIdMap that is asked for: numbers of objects, and the active view."""

    def __init__(self) -> None:
        """Start empty."""
        self.objects: list[Any] = []
        self.active: dict[str, Any] = {}

    def GetGlobalId(self, wanted: Any) -> int:  # noqa: D102 - VTK's names
        for number, known in enumerate(self.objects, start=1):
            if known is wanted:
                return number
        self.objects.append(wanted)
        return len(self.objects)

    def GetVTKObject(self, number: int | str) -> Any:  # noqa: D102
        return self.objects[int(number) - 1] if 0 < int(number) <= len(self.objects) else None

    def SetActiveObject(self, name: str, given: Any) -> None:  # noqa: D102
        self.active[name] = given

    def GetActiveObject(self, name: str) -> Any:  # noqa: D102
        return self.active.get(name)

    def FreeObject(self, given: Any) -> None:  # noqa: D102
        pass


class WebApplication:
    """The part of vtkWebApplication that is asked for."""

    def __init__(self) -> None:
        """Make the list."""
        self.ids = ObjectIds()

    def SetImageEncoding(self, encoding: int) -> None:  # noqa: D102
        pass

    def GetObjectIdMap(self) -> ObjectIds:  # noqa: D102
        return self.ids


def stand_in() -> None:
    """Provide vtkmodules.vtkWebCore where VTK was built without it."""
    if importlib.util.find_spec("vtkmodules.vtkWebCore") is None:
        module: Any = types.ModuleType("vtkmodules.vtkWebCore")
        module.vtkWebApplication = WebApplication
        module.vtkObjectIdMap = ObjectIds
        module.vtkWebInteractionEvent = type("vtkWebInteractionEvent", (), {})
        sys.modules["vtkmodules.vtkWebCore"] = module


def write_view(xdmf: Path, html: Path) -> None:
    """Write the last step of an XDMF file, on the deformed bodies, coloured by von Mises stress."""
    stand_in()
    import meshio
    import pyvista as pv

    from dolfinx_mortar.plotting.in_space import find_screen

    with meshio.xdmf.TimeSeriesReader(xdmf) as reader:
        points, cells = reader.read_points_cells()
        _, nodal, cellwise = reader.read_data(reader.num_steps - 1)
    points = points + 0.0
    points[:, : nodal["displacement"].shape[1]] += nodal["displacement"]
    grid = pv.from_meshio(meshio.Mesh(points, cells, cell_data=cellwise))
    outside = grid.extract_surface()
    find_screen()
    plotter = pv.Plotter(off_screen=True, window_size=(900, 600))
    bar = {"title": "von Mises stress [MPa]", "color": "black", "vertical": True}
    outside.cell_data.active_scalars_name = "von_mises"
    lit = {"ambient": 0.6, "diffuse": 0.4, "specular": 0.0}  # colours are those of the bar, nearly
    plotter.add_mesh(outside, scalars="von_mises", scalar_bar_args=bar, **lit)
    edges = outside.extract_all_edges()
    plotter.add_mesh(edges, color="black", opacity=0.25, line_width=1)
    plotter.background_color = "white"
    plotter.view_vector((-1.0, -1.4, 0.6), viewup=(0.0, 0.0, 1.0))  # both planes of symmetry
    plotter.export_html(html)
    # the viewer would fetch its icon from its makers
    text = html.read_text().replace("https://kitware.github.io/vtk-js/icon/favicon-", "data:,")
    html.write_text(text)


if __name__ == "__main__":
    write_view(Path(sys.argv[1]), Path(sys.argv[2]))
