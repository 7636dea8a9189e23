# SPDX-License-Identifier: MIT
"""A rubber cylinder between rigid plates (Sussman and Bathe 1987): a quarter of it, on one plate.

R = 200 mm, plane strain, Mooney's law with C10 = .293 and C01 = .177 MPa, K = 1410 MPa, no
friction. Of the approach of the plates each makes half; the force is that of the whole.
"""

from dataclasses import dataclass

from mpi4py import MPI

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from tests.cases.solid import hold, stand

RADIUS = 200.0
RUBBER = dm.MooneyRivlin(0.293, 0.177, 1410.0)


@dataclass
class Cylinder:
    problem: dm.ContactProblem
    contact: dm.Contact
    push: fem.Constant

    @property
    def solid(self):
        return self.problem.solid

    @property
    def force(self):
        """Force of the plates on the whole cylinder, per thickness."""
        return 2.0 * abs(self.contact.force[1])

    def approach(self, distance, **options):
        """Bring the plates nearer to each other, in all by a distance; return the report."""
        self.push.value = -distance / 2
        report = dm.newton(self.problem, **options)
        self.problem.commit()
        return report


def create_cylinder(
    h=20.0, cell="quadrilateral", degree=1, *, law=RUBBER, volumetric="reduced", slave="arc"
):
    """Return a cylinder with elements of a size, on a plate 1e5 times stiffer."""
    shape = {"radius": RADIUS, "block": (800.0, 200.0), "core": RADIUS, "limit": 2.0}
    made = dm.meshing.hertz(MPI.COMM_WORLD, kind="graded", h=h, cell=cell, half=True, **shape)
    laws = {"disc": law, "block": dm.NeoHooke(1e5, 0.3)}
    push = fem.Constant(made.mesh, default_scalar_type(0.0))
    find = made.facet_tags.find

    def supports(V):
        axis = hold(V, find("axis"), 0)
        return [hold(V, find("flat"), 1, push), axis, hold(V, find("bottom"))]

    sides = {"arc": ("arc", "top"), "top": ("top", "arc")}[slave]
    contact = dm.Contact(made.facet_tags, slave=sides[0], master=sides[1])
    how = {"strain": "finite", "volumetric": volumetric, "degree": degree}
    how |= {"cell_tags": made.cell_tags}
    return Cylinder(stand(made.mesh, laws, supports, [contact], **how), contact, push)
