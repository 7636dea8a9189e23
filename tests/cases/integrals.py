# SPDX-License-Identifier: MIT
"""Integrals over tagged parts, for which few forms are compiled."""

from mpi4py import MPI

import ufl
from dolfinx import fem, mesh


def integral(form: ufl.Form) -> float:
    """Return an integral over all ranks; all tags share one compiled form."""
    (part,) = form.integrals()
    tags, tag = part.subdomain_data(), part.subdomain_id()
    if tag != "everywhere":
        domain = part.ufl_domain()
        whole = mesh.Mesh(domain.ufl_cargo(), domain)
        chosen = mesh.meshtags(whole, tags.dim, tags.find(tag), 1)
        form = ufl.Form([part.reconstruct(subdomain_id=1, subdomain_data=chosen)])
    value = float(fem.assemble_scalar(fem.form(form)).real)
    return MPI.COMM_WORLD.allreduce(value)


def sizes(mesh, tags, measure, names=None):
    """Return length, area or volume by name, or by tag."""
    one, d = fem.Constant(mesh, 1.0), ufl.Measure(measure, mesh, subdomain_data=tags)
    return {name: integral(one * d(tags.tag(name))) for name in names or tags.names}
