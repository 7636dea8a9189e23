# SPDX-License-Identifier: MIT
"""Inertia and damping, with the letters of theory.md, Motion in time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.parallel import any_rank, raised_together
from dolfinx_mortar.arguments import NOT_NEGATIVE, POSITIVE, array, check, instance
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.solid.laws import by_cells
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.term import Term
from dolfinx_mortar.tags import label
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
class Motion:
    """Velocity, acceleration and forces at a time, (owned nodes, d) each."""

    velocity: Floats
    acceleration: Floats
    balance: Floats  # G


@dataclass(frozen=True)
class Start:
    """Data at the start of a step."""

    dt: float
    scheme: Scheme
    predicted: Floats  # p
    constant: Floats  # g
    kappa: float


class Inertia(Term):
    """The inertia of bodies, for `time_steps`: give it in ``ContactProblem(.., terms=[inertia])``.

    Nodes of sides that can open are massless; their mass is moved to the nodes behind them
    (`terms.mass`). Mass, centre and moments of inertia of each body are conserved with four layers
    of nodes behind each side, mass and centre with three; with one or two, nodes keep their mass.
    All of the whole ring, or per thickness.

    Attributes:
        scheme: of the steps; `time_steps` sets it.

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
        with raised_together(V.mesh.comm):
            read_numbers(density)
        rho = create_density(solid, density, cell_tags)
        weight = ufl.as_ufl(solid.kinematics.weight(ufl.SpatialCoordinate(solid.mesh)))
        self.solid, self.scheme = solid, NEWMARK
        self._identity = {"density": numbers_of(density)}
        self.plain = self.mass = assemble_mass(V, rho, weight)
        self._state = {
            name: fem.Function(V, name=name)
            for name in (
                "velocity",
                "acceleration",
                "balance",
                "contact",
                "friction",
                "load",
                "damping",
            )
        }
        set_velocity(self.velocity, velocity, cell_tags)
        self._start: Start | None = None
        self._end: Motion | None = None
        self._added: tuple[int, float] | None = None
        self._met: tuple[Bools, Ints] | None = None  # of the last `meet`

    @property
    def state(self) -> Mapping[str, fem.Function]:
        """Velocity, acceleration, and forces at the last commit."""
        return self._state

    @property
    def identity(self) -> Mapping[str, Any]:
        """The density."""
        return self._identity

    @property
    def velocity(self) -> fem.Function:
        """Velocity at the end of the last step, on ``solid.V``."""
        return self._state["velocity"]

    @property
    def acceleration(self) -> fem.Function:
        """Acceleration at the end of the last step, on ``solid.V``."""
        return self._state["acceleration"]

    def values(self, name: str) -> Floats:
        """A part of the state, (owned nodes, d)."""
        return self._owned(self._state[name])

    def put(self, **values: Floats) -> None:
        """Set parts of the state, (owned nodes, d); collective."""
        for name, given in values.items():
            f = self._state[name]
            f.x.array[: given.size] = given.ravel()
            f.x.scatter_forward()

    def _owned(self, f: fem.Function) -> Floats:
        n, d = self.mass.X.shape
        return np.asarray(f.x.array[: n * d].reshape(n, d))

    def meet(self, contact: Bools, body: Ints) -> None:
        """Remove the mass from contact nodes (owned nodes,); collective."""
        self.mass = relieve(self.plain, contact, body)
        self.couplings = self.mass.couplings(self.plain.matrix)
        self._added, self._met = None, (contact.copy(), body.copy())

    def check_met(self, contact: Bools, body: Ints) -> None:
        """Raise a ValueError for other arguments than in `meet`; collective."""
        same = self._met is not None and all(map(np.array_equal, self._met, (contact, body)))
        if any_rank(self.comm, not same)[0]:
            raise ValueError(
                "problem: its Inertia is also in a problem that was made later with other "
                "contacts or ties, and has the mass of that one: make an Inertia for each problem"
            )

    def begin(self, start: float, end: float) -> None:
        """Prepare a step from `start` to `end`; a ValueError unless end > start."""
        dt = end - start
        if not (dt > 0.0 and has_square(dt)):
            raise ValueError(f"Inertia: the step goes from {start:g} to {end:g}; {NO_TIME}")
        # rounded, so that equal steps share a matrix
        dt = float(f"{dt:.11e}")
        s, mass = self.scheme, self.mass
        v, a = mass.extend(self.values("velocity")), self.values("acceleration")
        predicted = self._owned(self.solid.u) + dt * v + dt**2 * (0.5 - s.beta) * a
        constant = as_floats((s.am * mass.times(a) - s.af * self.values("balance")) / (1.0 - s.af))
        kappa = (1.0 - s.am) / ((1.0 - s.af) * s.beta * dt**2)
        self._start, self._end = Start(dt, s, predicted, constant, kappa), None

    def stride(self) -> float:
        """Largest component of u - p on this rank."""
        return float(np.abs(self._change).max(initial=0.0))

    @property
    def start(self) -> Start:
        """Data at the start of the present step."""
        if self._start is None:
            raise ValueError(f"Inertia: no step has begun; {NO_TIME}")
        return self._start

    @property
    def _change(self) -> Floats:
        return self._owned(self.solid.u) - self.start.predicted

    def energy(self) -> Floats:
        """Addends of Pi(u) on this rank; 0 before any step."""
        if self._start is None:
            return np.zeros(1)
        w = self._change
        squares = 0.5 * self._start.kappa * w * self.mass.times(w)
        return np.concatenate([squares, self._start.constant * self._owned(self.solid.u)]).ravel()

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add kappa M (u - p) + g."""
        if self._start is None:
            return
        forces = self._start.kappa * self.mass.times(self._change) + self._start.constant
        F.array_w[:] += forces.ravel()

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add kappa M; before any step M, for audits."""
        factor = 1.0 if self._start is None else self._start.kappa
        self.mass.add_to(K, factor)
        self._added = K.handle, factor

    def varies(self, K: PETSc.Mat) -> bool:
        """Whether a matrix was assembled with another kappa."""
        return self._added != (K.handle, self.start.kappa)

    def end(self) -> Motion:
        """Motion at the end of the step, at the present u; collective."""
        start, s, mass = self.start, self.start.scheme, self.mass
        before, a_n = mass.extend(self.values("velocity")), self.values("acceleration")
        a = mass.extend(as_floats(self._change / (s.beta * start.dt**2)))
        v = before + start.dt * ((1.0 - s.gamma) * a_n + s.gamma * a)
        mean = mass.times((1.0 - s.am) * a + s.am * a_n)
        balance = (mean - s.af * self.values("balance")) / (1.0 - s.af)
        return Motion(v, a, as_floats(balance))

    def finish(self, motion: Motion) -> None:
        """Set the motion to be committed instead of that of `end`."""
        self._end = motion

    def commit(self) -> None:
        """Commit the motion at the end of a step; collective."""
        if self._start is None:
            return
        end = self._end or self.end()
        self.put(velocity=end.velocity, acceleration=end.acceleration, balance=end.balance)
        self._start = self._end = None

    def roll_back(self) -> None:
        """Discard the step."""
        self._start = self._end = None

    def kinetic_energy(self) -> float:
        """Return 1/2 v.M v; collective."""
        return self.energy_of(self.values("velocity"))

    def energy_of(self, velocity: Floats) -> float:
        """1/2 v.M v of a velocity (owned nodes, d); collective."""
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
        moments = self.mass.times(self.values("velocity"))
        if x.shape[1] == 2:
            total = np.array([(x[:, 0] * moments[:, 1] - x[:, 1] * moments[:, 0]).sum()])
        else:
            total = np.cross(x, moments).sum(axis=0)
        return np.asarray(self.comm.allreduce(total, op=MPI.SUM))

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.solid.mesh.comm

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
        self._inertia, self._mass, self._stiffness = inertia, float(mass), float(stiffness)
        self._K = solid.create_matrix()
        self._K.zeroEntries()
        solid.forms.add_elastic(self._K, self._stiffness)

    @property
    def inertia(self) -> Inertia:
        """The inertia of the damped bodies."""
        return self._inertia

    @property
    def shares(self) -> list[float]:
        """Factors a and b."""
        return [self._mass, self._stiffness]

    def times(self, velocity: Floats) -> Floats:
        """Return C v, (owned nodes, d); collective."""
        x, y = self._K.createVecs()
        x.array[:] = velocity.ravel()
        self._K.mult(x, y)
        elastic = y.array_r.reshape(velocity.shape)
        return np.asarray(self._mass * self._inertia.mass.times(velocity) + elastic)

    def _rate(self) -> tuple[float, Floats]:
        """Return r and v' of the velocity r (u - u_n) + v'."""
        inertia, start = self._inertia, self._inertia.start
        s = start.scheme
        rate = s.gamma / (s.beta * start.dt)
        v = inertia.mass.extend(inertia.values("velocity"))
        constant = v + start.dt * (1.0 - s.gamma) * inertia.values("acceleration")
        return rate, constant - rate * start.predicted

    def velocity(self) -> Floats:
        """Velocity at the end of the step."""
        rate, constant = self._rate()
        u = self._inertia.solid.u.x.array[: constant.size].reshape(constant.shape)
        return np.asarray(rate * u + constant)

    @property
    def _moves(self) -> bool:
        return self._inertia._start is not None

    def energy(self) -> Floats:
        """Addends of |v|^2_C / (2 r), whose derivative is C v."""
        if not self._moves:
            return np.zeros(1)
        v = self.velocity()
        return np.asarray((0.5 / self._rate()[0] * v * self.times(v)).ravel())

    def add_forces(self, F: PETSc.Vec) -> None:
        """Add C v; collective."""
        if self._moves:
            F.array_w[:] += self.times(self.velocity()).ravel()

    def varies(self, K: PETSc.Mat) -> bool:
        """Whether a matrix was assembled with another r."""
        return self._inertia.varies(K)

    def add_tangent(self, K: PETSc.Mat) -> None:
        """Add r C; collective."""
        if self._moves:
            rate = self._rate()[0]
            self._inertia.mass.add_to(K, rate * self._mass)
            self._inertia.solid.forms.add_elastic(K, rate * self._stiffness)


def read_numbers(density: Any) -> None:
    """Raise a ValueError unless densities are positive numbers or Constants."""
    several = density.items() if isinstance(density, Mapping) else [(None, density)]
    remedy = (
        "give a positive number, mass per volume in the units of the model (N, mm, s: tonnes per "
        "mm^3, 7.85e-9 for steel), or one by tag of cells"
    )
    for key, given in several:
        name = "density" if key is None else f"density of {key!r}"
        check(f"Inertia: {name}", _value(given), POSITIVE, remedy)


def numbers_of(density: Any) -> Any:
    """Density, or densities by tag."""
    if isinstance(density, Mapping):
        return {str(tag): float(_value(given)) for tag, given in sorted(density.items(), key=str)}
    return float(_value(density))


def _value(given: Any) -> Any:
    if isinstance(given, fem.Constant) and given.value.shape == ():
        return float(given.value)
    return given


def create_density(solid: Solid, density: Any, cell_tags: Any) -> Any:
    """Density in UFL; a ValueError for unknown or missing tags; collective."""
    if not isinstance(density, Mapping):
        return fem.Constant(solid.mesh, np.float64(_value(density)))
    chosen, tags = by_cells(solid.mesh, cell_tags, density, "Inertia: density", cover=True)
    rho = fem.Function(fem.functionspace(solid.mesh, ("DG", 0)))
    cells = rho.function_space.dofmap.list[: len(tags), 0]
    for tag, given in chosen.items():
        rho.x.array[cells[tags == tag]] = float(_value(given))
    return rho


def set_velocity(target: fem.Function, given: Any, cell_tags: Any) -> None:
    """Set the initial velocity; a ValueError on all ranks; collective."""
    V, d = target.function_space, target.function_space.dofmap.index_map_bs
    wanted = f"give {d} finite numbers, a Function on solid.V, or a function of the coordinates"
    if given is None:
        return
    if isinstance(given, fem.Function):
        space = given.function_space  # another space of the same mesh and element is accepted
        same = space.mesh is V.mesh and space.ufl_element() == V.ufl_element()
        if space != V and (not same or space.component()):
            raise ValueError(
                f"Inertia: velocity is a Function on {space.ufl_element()}, which "
                f"is not the space of the displacement, solid.V: {wanted}"
            )
        target.x.array[:] = given.x.array
    elif isinstance(given, Mapping):
        _set_by_tag(target, given, cell_tags, wanted)
    elif callable(given):
        x = V.tabulate_dof_coordinates().T
        with raised_together(V.mesh.comm):
            shape = d, x.shape[1]
            rule = array(shape, finite=False, remedy=f"return {shape} for points x {x.shape}")
            values = check("Inertia: velocity(x)", given(x), rule)
            target.x.array.reshape(-1, d)[:] = values.T
    else:
        target.x.array.reshape(-1, d)[:] = check(
            "Inertia: velocity", given, array((d,), remedy=wanted)
        )
    if any_rank(V.mesh.comm, not np.isfinite(target.x.array).all())[0]:
        raise ValueError(f"Inertia: velocity holds NaN or infinity: {wanted}")


def _set_by_tag(target: fem.Function, given: Any, cell_tags: Any, wanted: str) -> None:
    V, d = target.function_space, target.function_space.dofmap.index_map_bs
    rule = array((d,), remedy=wanted)
    found, tags = by_cells(V.mesh, cell_tags, given, "Inertia: velocity")
    for tag, vector in found.items():
        nodes = np.unique(V.dofmap.list[: len(tags)][tags == tag])
        who = f"Inertia: velocity of {label(cell_tags, tag)}"
        target.x.array.reshape(-1, d)[nodes] = check(who, vector, rule)
    target.x.scatter_forward()
