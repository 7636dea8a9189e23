# SPDX-License-Identifier: MIT
# ruff: noqa: D100

# # A material law of your own, in UFL, in NumPy and in JAX
#
# The package has no hardening by a power law (Swift). This demo shows how to
#
# - write an elasto-plastic law as a `dm.Material`, in UFL,
# - write it as a `dm.materials.PointwiseLaw`, a function of arrays, in NumPy or in JAX, which
#   derives the consistent tangent,
# - check a law by `dm.materials.check`, and compare the three versions in a contact problem.
#
# **Problem.** The yield stress in tension grows with the plastic strain $p$ as
# $\sigma_0 (1 + p/p_0)^n$, with $\sigma_0$ = 450 MPa, $p_0$ = 0.005, $n$ = 0.2 ($E$ = 206.9 GPa,
# $\nu$ = 0.29). An elastic half disc is pressed by 0.15 mm into a block of this metal, in plane
# strain. In the Frobenius norm the yield radius is $r(k) = Y (1 + k/k_0)^n$ with
# $Y = \sqrt{2/3}\, \sigma_0$ and $k = \int |\dot\varepsilon_p| = \sqrt{3/2}\, p$. Return mapping:
# where the trial stress $\xi = 2\mu\, \mathrm{dev}(\varepsilon - \varepsilon_p)$ lies outside the
# yield surface, $|\xi| > r(k)$, the plastic increment is the root $g$ of
#
# $$|\xi| - 2\mu g - r(k + g) = 0, \qquad
# \sigma = C (\varepsilon - \varepsilon_p) - 2\mu g\, \frac{\xi}{|\xi|}.$$
#
# This equation has no closed solution. For every concave $r$, Newton's method from $g = 0$
# approaches the root from below and converges quadratically. The derivative of $g$ does not come
# from differentiating the iteration but from the implicit function theorem,
# $dg / d|\xi| = 1 / (2\mu + r'(k + g))$. Units: mm, MPa, N per mm.
#
# **Result.** The picture shows the plastic strain below the disc, and the contact pressures of all
# versions.
#
# **Compare with.** The versions are compared with each other: the program ends with an error if
# force, pressures or stresses differ by more than $10^{-12}$ of the largest value.
#
# **Options to try.** `--versions` chooses the versions, `--exponent` the exponent $n$, `--h` the
# element size at the contact.
#
# **JAX.** Without JAX the other two versions are compared. The container has no JAX; it can be
# installed in an environment beside it:
# `containers/run python3 -m venv --system-site-packages build/jax`, then
# `containers/run build/jax/bin/pip install jax` and
# `containers/run build/jax/bin/python demos/own_law/own_law.py`.
#
# **External operators.** Functions written for dolfinx-external-operator return the same values at
# the same points. Its operators appear in forms and have to be replaced before these are compiled,
# whereas `Solid` compiles its forms itself. Use such functions here in a `PointwiseLaw`. The
# releases of that package on PyPI require dolfinx 0.10 or newer, so they cannot be installed with
# Debian's 0.9, and this demo does not use it.

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import dolfinx_mortar as dm
import ufl
from dolfinx import fem

try:
    import jax
    import jax.numpy as jnp
except ImportError:
    jax = None
else:
    jax.config.update("jax_enable_x64", True)

AGREEMENT = 1e-12  # of the largest force and stress
STEPS = 6  # of Newton's method: enough for round-off in increments of ten yield strains
INSTALL = "pip install 'dolfinx_mortar[jax]'"
GUARD, BAND = 1e-14, 1e-10  # of Y: makes |xi| differentiable at 0; tolerance of the yield limit

parser = argparse.ArgumentParser(
    description="A material law of your own, in UFL, in NumPy and in JAX."
)
parser.add_argument(
    "--versions",
    nargs="+",
    choices=["ufl", "numpy", "jax"],
    default=["ufl", "numpy", "jax"] if jax else ["ufl", "numpy"],
)
parser.add_argument("--exponent", type=float, default=0.2, help="n, 0 < n <= 1")
parser.add_argument("--displacement", type=float, default=0.15, help="of the disc, in mm")
parser.add_argument("--steps", type=int, default=3, help="number of equal load steps")
parser.add_argument("--h", type=float, default=0.2, help="element size at the contact")
parser.add_argument("--output", type=Path, default=Path("results/own_law"))


# ## What all versions have in common
#
# The parameters and their ranges, and the internal variables. The law is the sum of a deviatoric
# and a volumetric part, which `volumetric="reduced"` requires.


@dataclass(frozen=True)
class Swift:
    """Parameters, ranges and state of von Mises plasticity with Swift's hardening."""

    E: float
    nu: float
    Y: float
    k0: float
    n: float

    state: ClassVar = {"plastic_strain": (3, 3), "accumulated_plastic_strain": ()}
    linear: ClassVar = False
    splits: ClassVar = True
    ranges: ClassVar = dm.Elastic.ranges | {
        "Y": (0.0, np.inf, False),
        "k0": (0.0, np.inf, False),
        "n": (0.0, np.nextafter(1.0, 2.0), False),
    }
    elastic_stress = staticmethod(dm.Elastic.elastic_stress)

    @classmethod
    def from_uniaxial(cls, E, nu, yield_stress, plastic_strain, exponent):
        """Create the law from a tension test: sigma_0, p_0, n."""
        return cls(E, nu, np.sqrt(2 / 3) * yield_stress, np.sqrt(1.5) * plastic_strain, exponent)


# ## In UFL
#
# With $x = k_0 + k + g$ and $r = c x^n$ an iteration of Newton's method needs a single power.
# Stress and tangent are written explicitly, so that UFL does not differentiate the iteration. The
# incremental potential,
#
# $$\psi = \tfrac12 (\varepsilon - \varepsilon_p) : C (\varepsilon - \varepsilon_p) - |\xi| g
# + \mu g^2 + \int_k^{k+g} r,$$
#
# is used by the line search; its derivative with respect to $g$ vanishes.


class SwiftUfl(Swift, dm.Material):
    """The law in UFL."""

    @staticmethod
    def flow(strain, state, p):
        """Return mu, xi, |xi|, g, dg / d|xi| and x."""
        mu = p.E / (2 * (1 + p.nu))
        xi = 2 * mu * ufl.dev(strain - state["plastic_strain"])
        norm = ufl.sqrt(ufl.inner(xi, xi) + (GUARD * p.Y) ** 2)
        start = x = p.k0 + state["accumulated_plastic_strain"]
        c = p.Y / p.k0**p.n
        radius = c * start**p.n
        flows = ufl.gt(norm, (1 + BAND) * radius)
        goal = ufl.max_value(norm, radius) + 2 * mu * start
        for _ in range(STEPS):
            r = c * x**p.n
            x = (goal - (1 - p.n) * r) / (2 * mu + p.n * r / x)
        slope = 1 / (2 * mu + p.n * c * x ** (p.n - 1))
        return mu, xi, norm, ufl.conditional(flows, x - start, 0), ufl.conditional(flows, slope, 0)

    @staticmethod
    def energy(strain, state, p):
        """Return the potential of the step."""
        mu, _, norm, g, _ = SwiftUfl.flow(strain, state, p)
        start, c = p.k0 + state["accumulated_plastic_strain"], p.Y / p.k0**p.n
        elastic = dm.Elastic.energy(strain - state["plastic_strain"], {}, p)
        hardening = c * ((start + g) ** (p.n + 1) - start ** (p.n + 1)) / (p.n + 1)
        return elastic - norm * g + mu * g**2 + hardening

    @staticmethod
    def stress(strain, state, p):
        """Return the stress."""
        mu, xi, norm, g, _ = SwiftUfl.flow(strain, state, p)
        elastic = dm.Elastic.elastic_stress(strain - state["plastic_strain"], p)
        return elastic - 2 * mu * g / norm * xi

    @staticmethod
    def tangent(strain, state, p, direction):
        """Return its derivative along a strain."""
        mu, xi, norm, g, slope = SwiftUfl.flow(strain, state, p)
        change, normal = 2 * mu * ufl.dev(direction), xi / norm
        turn = g / norm * change + (slope - g / norm) * ufl.inner(normal, change) * normal
        return dm.Elastic.elastic_stress(direction, p) - 2 * mu * turn

    @staticmethod
    def updated_state(strain, state, p):
        """Return the plastic strain and k at the end of the step."""
        _, xi, norm, g, _ = SwiftUfl.flow(strain, state, p)
        return {
            "plastic_strain": state["plastic_strain"] + g / norm * xi,
            "accumulated_plastic_strain": state["accumulated_plastic_strain"] + g,
        }


# ## In NumPy
#
# The same law for the arrays of all points, with a loop for the iteration and an explicit tangent.


class SwiftNumpy(Swift, dm.materials.PointwiseLaw):
    """The law in NumPy."""

    @staticmethod
    def update(strain, state, p):
        """Return stress, tangent and new state at all points."""
        ep, k = state["plastic_strain"], state["accumulated_plastic_strain"]
        mu, bulk = p.E / (2 * (1 + p.nu)), p.E / (3 * (1 - 2 * p.nu))
        one = np.eye(3)
        trace = np.trace(strain, axis1=1, axis2=2)
        xi = (2 * mu)[:, None, None] * (strain - ep - (trace / 3)[:, None, None] * one)
        norm = np.sqrt((xi**2).sum(axis=(1, 2)) + (GUARD * p.Y) ** 2)
        flows = norm > (1 + BAND) * p.Y * (1 + k / p.k0) ** p.n
        g = np.zeros(len(k))
        for _ in range(STEPS):
            r = p.Y * (1 + (k + g) / p.k0) ** p.n
            slope = flows / (2 * mu + p.n * r / (p.k0 + k + g))
            g += slope * (norm - 2 * mu * g - r)
        new = ep + (g / norm)[:, None, None] * xi
        stress = xi - (2 * mu * g / norm)[:, None, None] * xi + (bulk * trace)[:, None, None] * one
        volume, unit = np.einsum("ij,kl->ijkl", one, one), np.einsum("ik,jl->ijkl", one, one)
        shear, along = 2 * mu * (1 - 2 * mu * g / norm), 4 * mu**2 * (slope - g / norm) / norm**2
        tangent = np.multiply.outer(bulk - shear / 3, volume) + np.multiply.outer(shear, unit)
        tangent -= along[:, None, None, None, None] * np.einsum("qij,qkl->qijkl", xi, xi)
        return stress, tangent, {"plastic_strain": new, "accumulated_plastic_strain": k + g}


# ## In JAX
#
# The law of a single point, written like the formulas; JAX derives $r'$ and the consistent tangent,
# and vectorises the law over all points. After the loop there is one more iteration of Newton's
# method. The result of the loop is a constant in it (`stop_gradient`), so that its value is the
# root and its derivative that of the implicit function. For another hardening curve only `radius`
# has to be changed.


def radius(k, p):
    """Return the radius of the yield surface."""
    return p["Y"] * (1 + k / p["k0"]) ** p["n"]


def respond(strain, state, p):
    """Return the stress at one point, and (stress, state) that JAX does not differentiate."""
    ep, k = state["plastic_strain"], state["accumulated_plastic_strain"]
    mu, bulk = p["E"] / (2 * (1 + p["nu"])), p["E"] / (3 * (1 - 2 * p["nu"]))
    trace = jnp.trace(strain)
    xi = 2 * mu * (strain - ep - trace / 3 * jnp.eye(3))
    norm = jnp.sqrt(jnp.sum(xi**2) + (GUARD * p["Y"]) ** 2)

    def newton(g, norm):
        slope = 2 * mu + jax.grad(radius)(k + g, p)
        return g + (norm - 2 * mu * g - radius(k + g, p)) / slope

    flows = norm > (1 + BAND) * radius(k, p)
    goal = jnp.where(flows, norm, radius(k, p))
    held = jax.lax.stop_gradient(goal)
    root = jax.lax.fori_loop(0, STEPS, lambda _, g: newton(g, held), 0.0)
    g = jnp.where(flows, newton(root, goal), 0.0)
    new = {"plastic_strain": ep + g / norm * xi, "accumulated_plastic_strain": k + g}
    stress = bulk * trace * jnp.eye(3) + (1 - 2 * mu * g / norm) * xi
    return stress, (stress, new)


class SwiftJax(Swift, dm.materials.PointwiseLaw):
    """The law in JAX."""

    derived: ClassVar = jax and jax.jit(jax.vmap(jax.jacfwd(respond, has_aux=True)))

    @staticmethod
    def update(strain, state, p):
        """Return stress, tangent and new state at all points."""
        tangent, (stress, new) = SwiftJax.derived(strain, dict(state), vars(p))
        return stress, tangent, new


LAWS = {"ufl": SwiftUfl, "numpy": SwiftNumpy, "jax": SwiftJax}


# ## The contact problem
#
# An elastic half disc is pressed into a block of the metal.


def press(law: Swift, options: argparse.Namespace) -> tuple[dm.ContactProblem, list[dict]]:
    """Press the disc into a block of the law; return the problem and its steps."""
    mesh, cell_tags, facet_tags = dm.meshing.hertz(
        MPI.COMM_WORLD, kind="graded", h=options.h, cell="quadrilateral"
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V, name="displacement")
    bodies = {"block": law, "disc": dm.Elastic(law.E, law.nu)}
    solid = dm.Solid(u, bodies, cell_tags, volumetric="reduced")
    push = fem.Constant(mesh, np.zeros(2))
    bottom, flat = (
        fem.locate_dofs_topological(V, 1, facet_tags.find(side)) for side in ("bottom", "flat")
    )
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, flat, V)]
    contact = dm.Contact(facet_tags, slave="top", master="arc")
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")

    def set_level(d: float) -> None:
        push.value[1] = -d

    levels = np.linspace(0.0, options.displacement, options.steps + 1)[1:]
    steps = []
    for step in dm.load_steps(
        problem, levels, on_time=set_level, rtol=1e-11, cuts="none", progress=False
    ):
        row = {"displacement": step.time, "force": abs(contact.force[1])}
        row["max_plastic_strain"] = solid.max("plastic_strain_norm")
        steps.append(dm.summarise(step) | row)
    return problem, steps


# ## Comparison
#
# Each version computes all steps. The force on the block, the pressures at its nodes and the
# stresses at all integration points are compared with those of the first version.


COMPARED = {
    "force": lambda problem: problem.contacts[0].force,
    "pressure": lambda problem: problem.contacts[0].pressure.x.array,
    "stress": lambda problem: problem.solid.stress.x.array,
}


def disagreements(one: dm.ContactProblem, other: dm.ContactProblem) -> dict[str, float]:
    """Return the largest differences relative to the largest values, over all ranks."""
    found = {}
    for name, read in COMPARED.items():
        sizes = [np.abs(v).max(initial=0.0) for v in (read(other) - read(one), read(one))]
        difference, scale = (MPI.COMM_WORLD.allreduce(size, op=MPI.MAX) for size in sizes)
        found[name] = float(difference / scale)
    return found


def assembly_seconds(solid: dm.Solid) -> float:
    """Return the shortest of five times of the assembly of the tangent, with the law."""
    K, u, taken = solid.create_matrix(), solid.u.x.array, []
    kept = u.copy()
    for k in range(5):
        u[:] = (
            1 + 1e-9 * k
        ) * kept  # changed, since the law is not evaluated again at equal values
        start = time.perf_counter()
        solid.assemble_tangent(K)
        taken.append(time.perf_counter() - start)
    u[:] = kept
    return min(taken)


def main(options: argparse.Namespace) -> None:
    """Solve with all versions, compare them, draw the results."""
    comm = MPI.COMM_WORLD
    options.output.mkdir(parents=True, exist_ok=True)
    problems, steps, compared = {}, {}, {}
    for name in options.versions:
        law = LAWS[name].from_uniaxial(206_900.0, 0.29, 450.0, 0.005, options.exponent)
        if comm.rank == 0:
            print(dm.materials.check(law, size=0.03))  # stress and tangent against differences
        problems[name], steps[name] = press(law, options)
        first = problems[options.versions[0]]
        compared[name] = disagreements(first, problems[name]) | {
            "newton_iterations": [row["newton_iterations"] for row in steps[name]],
            "assembly_seconds": assembly_seconds(problems[name].solid),
        }
    rows, more = steps[options.versions[0]], {"versions": compared, "options": vars(options)}
    dm.write_summary(options.output / "summary.json", first, rows, **more)
    draw(options.output / "own_law.png", problems)
    if comm.rank == 0:
        tell(compared, options, rows[-1])
    worst = max(found[what] for found in compared.values() for what in COMPARED)
    if not worst <= AGREEMENT:
        sys.exit(f"the versions disagree by {worst:.1e}, more than {AGREEMENT:.0e}")


def tell(compared: dict[str, dict], options: argparse.Namespace, last: dict) -> None:
    """Print a line for each version."""
    if jax is None:
        print(f"without JAX: {INSTALL} adds that version")
    for name, found in compared.items():
        print(
            f"{name}: Newton iterations {found['newton_iterations']}, assembly"
            f" {1e3 * found['assembly_seconds']:.1f} ms, from {options.versions[0]}: force"
            f" {found['force']:.0e}, pressure {found['pressure']:.0e}, stress {found['stress']:.0e}"
        )
    print(f"force {last['force']:.1f} N/mm, results in {options.output}")


# ## Picture
#
# The plastic strain below the disc, and the contact pressures of all versions.


def draw(path: Path, problems: dict[str, dm.ContactProblem]) -> None:
    """Draw the plastic strain of the first version, and the pressures of all."""
    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    figure.get_layout_engine().set(wspace=0.08)
    left, right = figure.subplots(1, 2)
    first = next(iter(problems.values()))
    dm.plotting.field(first, "plastic_strain_norm", ax=left)
    left.set(xlim=(-3.0, 3.0), ylim=(-3.5, 1.5))
    for (name, problem), style in zip(problems.items(), ("-", "x", "o"), strict=False):
        nodes = problem.contacts[0].gather(problem.u)
        order = np.argsort(nodes["X"][:, 0])
        x, p = nodes["X"][order, 0], nodes["pressure"][order]
        right.plot(x, p, style, label=name, fillstyle="none", markersize=4 if style == "x" else 8)
    right.set(xlim=(-3.0, 3.0), ylim=(0.0, None), xlabel="x [mm]", ylabel="pressure [MPa]")
    right.legend(frameon=False)
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(path, dpi=110)


def check(options: argparse.Namespace) -> None:
    """End with a message if an option is invalid."""
    if "jax" in options.versions and jax is None:
        parser.error(f"--versions jax: JAX is missing; {INSTALL}, or leave that version out")
    if options.steps < 1 or not 0.0 < options.exponent <= 1.0:
        parser.error(f"--steps {options.steps}, --exponent {options.exponent}: give 1.. and (0, 1]")
    if not (options.displacement > 0.0 and options.h > 0.0):
        parser.error(f"--displacement {options.displacement}, --h {options.h}: more than 0 each")


if __name__ == "__main__":
    chosen = parser.parse_args()
    check(chosen)
    main(chosen)
