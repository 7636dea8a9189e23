# SPDX-License-Identifier: MIT
"""Inertia and damping, with the letters of theory.md, Motion in time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import any_rank, raised_together
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import NOT_NEGATIVE, POSITIVE, array, check, instance
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.tags import label
from dolfinx_mortar.solid.laws import by_cells
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.terms.mass import assemble_mass, relieve

Density = float | fem.Constant | Mapping[int | str, float | fem.Constant]
Velocity = (
    Sequence[float]
    | npt.NDArray[np.float64]
    | fem.Function
    | Callable[[Floats], Any]
    | Mapping[int | str, Sequence[float]]
)

NO_TIME = (
    "inertia needs the time between two steps: use dm.time_steps(problem, times), or give "
    "newton(problem, level=) a time after that of the last step"
)


def has_square(dt: float) -> bool:
    """Whether dt^2 neither under- nor overflows."""
    return 0.0 < dt * dt < np.inf


MOTION = "velocity", "acceleration", "balance"
FORCES = "contact", "friction", "supports", "load", "damping"
"""Names of the state: the motion, G in the balance M a = G, and its parts."""

as_floats = partial(np.asarray, dtype=np.float64)


@dataclass(frozen=True)
class Scheme:
    """Parameters of the generalised alpha method.

    Second order: gamma = 1/2 - am + af; stable for all dt: am <= af <= 1/2, beta >= 1/4 + (af -
    am)/2.
    """

    am: float = 0.0
    af: float = 0.0
    beta: float = 0.25
    gamma: float = 0.5


NEWMARK = Scheme()
"""Newmark's trapezoidal rule, which keeps the energy of a linear motion."""
IMPLICIT = Scheme(beta=1.0, gamma=1.0)
"""Euler's implicit rule."""


def generalised_alpha(radius: float) -> Scheme:
    """Scheme with spectral radius `radius` at the highest frequencies; 1 damps nothing.

    Chung and Hulbert (1993), eqs. 17, 20 and 25.
    """
    am, af = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
    return Scheme(am, af, 0.25 * (1.0 - am + af) ** 2, 0.5 - am + af)


@dataclass(frozen=True)
class Start:
    """Data at the start of a step."""

    dt: float
    predicted: Floats  # p
    constant: Floats  # g
    kappa: float
    velocity: Floats  # q of the velocity q + rate (u - p) at the end
    rate: float


class Inertia(Term):
    """The inertia of bodies, for `time_steps`: give it in ``ContactProblem(.., terms=[inertia])``.

    Nodes of sides that can open are massless; their mass is moved to the nodes behind them
    (`terms.mass`). Mass, centre and moments of inertia of each body are conserved with four layers
    of nodes behind each side, mass and centre with three; with one or two, nodes keep their mass.
    All of the whole ring, or per thickness.

    Attributes:
        scheme: of the steps; `time_steps` sets it.
        velocity, acceleration: Functions on ``solid.V`` at the end of the last step.

    Args:
        density: mass per volume at X: a positive number or Constant, whose value is read here, or
            one for each tag of cells.
        cell_tags: for ``density`` or ``velocity`` by tag.
        velocity: at the start; d numbers, a Function on ``solid.V``, a function of the coordinates
            for `fem.Function.interpolate`, or d numbers by tag of cells.

    Source: J. Chung, G. M. Hulbert, J. Appl. Mech. 60 (1993) 371-375, for the schemes; H. B.
    Khenous, P. Laborde, Y. Renard, Eur. J. Mech. A 27 (2008) 918-932, for the mass.

    Raises:
        ValueError: on all ranks, naming a wrong argument.
    """

    linear = True
    state: Mapping[str, fem.Function] = MappingProxyType({})
    identity: Mapping[str, Any] = MappingProxyType({})

    def __init__(
        self,
        solid: Solid,
        density: Density,
        cell_tags: MeshTags | None = None,
        *,
        velocity: Velocity | None = None,
    ) -> None:
        """Check the arguments and assemble the mass; collective."""
        check("Inertia: solid", solid, instance(Solid, "give the Solid of the bodies"))
        V = solid.V
        given: dict[str, Any] = {"density": density, "cell_tags": cell_tags}
        if not callable(velocity):
            given["velocity"] = velocity
        check_same_on_all_ranks(V.mesh.comm, **given)
        self.comm = V.mesh.comm
        with raised_together(self.comm):
            numbers = read_numbers(density)
        by_tag = {str(tag): rho for tag, rho in sorted(numbers.items(), key=str)}
        self.identity = {"density": numbers.get(None, by_tag)}
        rho = create_density(solid, numbers, cell_tags)
        weight = ufl.as_ufl(solid.kinematics.weight(ufl.SpatialCoordinate(solid.mesh)))
        self.solid, self.scheme = solid, NEWMARK
        self.plain = self.mass = assemble_mass(V, rho, weight)
        self.state = {name: fem.Function(V, name=name) for name in (*MOTION, *FORCES)}
        self.velocity, self.acceleration = (self.state[name] for name in MOTION[:2])
        set_velocity(self.velocity, velocity, cell_tags)
        self._start: Start | None = None
        self._end: dict[str, Floats] | None = None
        self._added: tuple[int, float] | None = None
        self.contact: Bools = np.zeros(0, dtype=bool)  # of the last `meet`

    def values(self, name: str) -> Floats:
        """A part of the state, (owned nodes, d)."""
        return self._owned(self.state[name])

    def put(self, **values: Floats) -> None:
        """Set parts of the state, (owned nodes, d); collective."""
        for name, given in values.items():
            f = self.state[name]
            f.x.array[: given.size] = given.ravel()
            f.x.scatter_forward()

    def _owned(self, f: fem.Function) -> Floats:
        n, d = self.mass.X.shape
        return np.asarray(f.x.array[: n * d].reshape(n, d))

    def meet(self, contact: Bools, body: Ints) -> None:
        """Remove the mass from contact nodes (owned nodes,); collective."""
        self.mass = relieve(self.plain, contact, body)
        self.couplings = self.mass.couplings(self.plain.matrix)
        self._added, self.contact = None, contact.copy()

    def begin(self, start: float, end: float) -> None:
        """Prepare a step from `start` to `end`; a ValueError unless end > start."""
        dt = end - start
        if not (dt > 0.0 and has_square(dt)):
            raise ValueError(f"Inertia: the step goes from {start:g} to {end:g}; {NO_TIME}")
        # rounded, so that equal steps share a matrix
        dt = float(f"{dt:.11e}")
        s, mass = self.scheme, self.mass
        v, a = mass.extend(self.values("velocity")), self.values("acceleration")
        velocity, rate = v + dt * (1.0 - s.gamma) * a, s.gamma / (s.beta * dt)
        predicted = self._owned(self.solid.u) + dt * v + dt**2 * (0.5 - s.beta) * a
        constant = as_floats((s.am * mass.times(a) - s.af * self.values("balance")) / (1.0 - s.af))
        kappa = (1.0 - s.am) / ((1.0 - s.af) * s.beta * dt**2)
        self._start = Start(dt, predicted, constant, kappa, velocity, rate)
        self._end = None

    def stride(self) -> float:
        """Largest component of u - p on this rank."""
        return float(np.abs(self.change).max(initial=0.0))

    @property
    def start(self) -> Start:
        """Data at the start of the present step."""
        if self._start is None:
            raise ValueError(f"Inertia: no step has begun; {NO_TIME}")
        return self._start

    @property
    def moves(self) -> bool:
        """Whether a step has begun."""
        return self._start is not None

    @property
    def change(self) -> Floats:
        """Displacement u - p (owned nodes, d)."""
        return self._owned(self.solid.u) - self.start.predicted

    def energy(self) -> Floats:
        """Addends of Pi(u) on this rank; 0 before any step."""
        if self._start is None:
            return np.zeros(1)
        w = self.change
        squares = 0.5 * self._start.kappa * w * self.mass.times(w)
        return np.concatenate([squares, self._start.constant * self._owned(self.solid.u)]).ravel()

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add kappa M (u - p) + g."""
        if self._start is None:
            return
        forces = self._start.kappa * self.mass.times(self.change) + self._start.constant
        F.array_w[:] += forces.ravel()

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add kappa M; before any step M, for audits."""
        factor = 1.0 if self._start is None else self._start.kappa
        self.mass.add_to(K, factor)
        self._added = K.handle, factor

    def varies(self, K: PETSc.Mat) -> bool:
        """Whether a matrix was assembled with another kappa."""
        return self._added != (K.handle, self.start.kappa)

    def end(self) -> dict[str, Floats]:
        """Velocity, acceleration and balance G at the present u, (owned nodes, d); collective."""
        start, s, mass = self.start, self.scheme, self.mass
        change, a_n = mass.extend(self.change), self.values("acceleration")
        a = change / (s.beta * start.dt**2)
        mean = mass.times((1.0 - s.am) * a + s.am * a_n)
        balance = (mean - s.af * self.values("balance")) / (1.0 - s.af)
        ends = start.velocity + start.rate * change, a, balance
        return {name: as_floats(values) for name, values in zip(MOTION, ends, strict=True)}

    def finish(self, **state: Floats) -> None:
        """Set the state to be committed instead of `end`."""
        self._end = state

    def commit(self) -> None:
        """Commit the motion at the end of a step; collective."""
        if self.moves:
            self.put(**(self._end or self.end()))
        self.roll_back()

    def roll_back(self) -> None:
        """Discard the step."""
        self._start = self._end = None

    def kinetic_energy(self) -> float:
        """Return 1/2 v.M v; collective."""
        velocity = self.values("velocity")
        return 0.5 * self.sum((velocity * self.mass.times(velocity)).sum())

    def momentum(self) -> Floats:
        """Return sum_i (M v)_i, (d,); collective."""
        moments = self.mass.times(self.values("velocity"))
        return np.asarray(self.comm.allreduce(moments.sum(axis=0), op=MPI.SUM))

    def moment_of_momentum(self, about: Sequence[float] | None = None) -> Floats:
        """Return sum_i (x_i - about) x (M v)_i, (1,) in the plane, (3,) in space; collective.

        x is X at small strain, X + u at finite strain; ``about`` is by default the origin.
        """
        x = self.mass.X - (0.0 if about is None else np.asarray(about, dtype=float))
        if self.solid.strain == "finite":
            x = x + self._owned(self.solid.u)
        moments, d = self.mass.times(self.values("velocity")), x.shape[1]
        arms, moments = (np.pad(values, ((0, 0), (0, 3 - d))) for values in (x, moments))
        total = self.comm.allreduce(np.cross(arms, moments).sum(axis=0), op=MPI.SUM)
        return np.asarray(total[2:] if d == 2 else total)

    def sum(self, share: float | np.floating[Any]) -> float:
        """Sum over all ranks; collective."""
        return float(self.comm.allreduce(float(share), op=MPI.SUM))


class Damping(Term):
    """Rayleigh's damping: forces -C v with C = a M + b K, K the elastic stiffness at X.

    The damping ratio of a mode of angular frequency w is (a / w + b w) / 2.

    Args:
        inertia: of the bodies, in the same problem.
        mass: a >= 0, per time.
        stiffness: b >= 0, a time; at small strain only, since K at X resists rotations.

    Raises:
        ValueError: for other numbers, two zeros, and a stiffness at finite strain.
    """

    linear = True

    def __init__(self, inertia: Inertia, *, mass: float = 0.0, stiffness: float = 0.0) -> None:
        """Check, and assemble K; collective."""
        remedy = "give the Inertia of the problem"
        check("Damping: inertia", inertia, instance(Inertia, remedy))
        check_same_on_all_ranks(inertia.comm, mass=mass, stiffness=stiffness)
        check("Damping: mass", mass, NOT_NEGATIVE)
        check("Damping: stiffness", stiffness, NOT_NEGATIVE)
        if mass == 0.0 and stiffness == 0.0:
            raise ValueError(
                "Damping: mass and stiffness are 0, which damps nothing: give one, or leave the "
                "term out"
            )
        solid = inertia.solid
        if stiffness > 0.0 and solid.strain == "finite":
            raise ValueError(
                f"Damping: stiffness is {stiffness!r}, but at finite strain the stiffness at X "
                "would brake rotations: use mass=, or the numerical damping of time_steps(.., "
                "spectral_radius=)"
            )
        self.inertia, self.shares = inertia, [float(mass), float(stiffness)]
        self._K = solid.create_matrix()
        self._K.zeroEntries()
        solid.forms.add_elastic(self._K, float(stiffness))

    def times(self, velocity: Floats) -> Floats:
        """Return C v, (owned nodes, d); collective."""
        x, y = self._K.createVecs()
        x.array[:] = velocity.ravel()
        self._K.mult(x, y)
        elastic = y.array_r.reshape(velocity.shape)
        return self.shares[0] * self.inertia.mass.times(velocity) + elastic

    def velocity(self) -> Floats:
        """Velocity at the end of the step."""
        start = self.inertia.start
        return start.velocity + start.rate * self.inertia.change

    def energy(self) -> Floats:
        """Addends of |v|^2_C / (2 r), whose derivative is C v."""
        if not self.inertia.moves:
            return np.zeros(1)
        v = self.velocity()
        return np.asarray((0.5 / self.inertia.start.rate * v * self.times(v)).ravel())

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add C v; collective."""
        if self.inertia.moves:
            F.array_w[:] += self.times(self.velocity()).ravel()

    def varies(self, K: PETSc.Mat) -> bool:
        """Whether a matrix was assembled with another r."""
        return self.inertia.varies(K)

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add r C; collective."""
        if self.inertia.moves:
            a, b = (self.inertia.start.rate * share for share in self.shares)
            self.inertia.mass.add_to(K, a)
            self.inertia.solid.forms.add_elastic(K, b)


def read_numbers(density: Any) -> dict[Any, float]:
    """Densities by tag, of None if there is one; a ValueError unless they are positive."""
    several = density if isinstance(density, Mapping) else {None: density}
    remedy = (
        "give a positive number, mass per volume in the units of the model (N, mm, s: tonnes per "
        "mm^3, 7.85e-9 for steel), or one by tag of cells"
    )
    found = {}
    for key, given in several.items():
        name = "density" if key is None else f"density of {key!r}"
        constant = isinstance(given, fem.Constant) and given.value.shape == ()
        value = float(given.value) if constant else given
        found[key] = check(f"Inertia: {name}", value, POSITIVE, remedy)
    return found


def create_density(solid: Solid, numbers: Mapping[Any, float], cell_tags: Any) -> Any:
    """Density in UFL; a ValueError for unknown or missing tags; collective."""
    if None in numbers:
        return fem.Constant(solid.mesh, np.float64(numbers[None]))
    chosen, tags = by_cells(solid.mesh, cell_tags, numbers, "Inertia: density", cover=True)
    rho = fem.Function(fem.functionspace(solid.mesh, ("DG", 0)))
    cells = rho.function_space.dofmap.list[: len(tags), 0]
    for tag, given in chosen.items():
        rho.x.array[cells[tags == tag]] = given
    return rho


def set_velocity(target: fem.Function, given: Any, cell_tags: Any) -> None:
    """Set the initial velocity; a ValueError on all ranks; collective."""
    V, d = target.function_space, target.function_space.dofmap.index_map_bs
    wanted = f"give {d} finite numbers, a Function on solid.V, or a function of the coordinates"
    values = target.x.array.reshape(-1, d)
    rule = array((d,), remedy=wanted)
    if given is None:
        return
    if isinstance(given, fem.Function):
        space = given.function_space  # another space of the same mesh and element is accepted
        same = space.mesh is V.mesh and space.ufl_element() == V.ufl_element()
        if not same or space.component():
            raise ValueError(
                f"Inertia: velocity is a Function on {space.ufl_element()}, which "
                f"is not the space of the displacement, solid.V: {wanted}"
            )
        target.x.array[:] = given.x.array
    elif isinstance(given, Mapping):
        found, tags = by_cells(V.mesh, cell_tags, given, "Inertia: velocity")
        for tag, vector in found.items():
            nodes = np.unique(V.dofmap.list[: len(tags)][tags == tag])
            values[nodes] = check(f"Inertia: velocity of {label(cell_tags, tag)}", vector, rule)
        target.x.scatter_forward()
    elif callable(given):
        x = V.tabulate_dof_coordinates().T
        with raised_together(V.mesh.comm):
            shape = d, x.shape[1]
            remedy = f"return {shape} for points x {x.shape}"
            rule = array(shape, finite=False, remedy=remedy)
            values[:] = check("Inertia: velocity(x)", given(x), rule).T
    else:
        values[:] = check("Inertia: velocity", given, rule)
    if any_rank(V.mesh.comm, not np.isfinite(values).all())[0]:
        raise ValueError(f"Inertia: velocity holds NaN or infinity: {wanted}")
