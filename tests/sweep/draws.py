# SPDX-License-Identifier: MIT
"""The data of random problems. The order of the draws is frozen, so that seeds keep theirs."""

import numpy as np

import dolfinx_mortar as dm

GEOMETRIES = ["updated", "reference"]


def draw(kind, seed):
    """Return the data of a random problem."""
    return KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))


def _choice(rng, *values):
    return float(rng.choice(values))


def _laws(rng, tags):
    """Draw moduli over two and a half decades, also auxetic; six of ten laws are plastic.

    Half of the plastic ones do not harden.
    """
    laws = {}
    for tag in tags:
        E, nu = 10 ** rng.uniform(3.0, 5.7), rng.uniform(-0.2, 0.49)
        if rng.uniform() < 0.6:
            limit = E * 10 ** rng.uniform(-3.2, -1.8)
            modulus = _choice(rng, 0.0, E * 10 ** rng.uniform(-3, -0.5))
            laws[tag] = dm.VonMises.from_uniaxial(E, nu, limit, modulus)
        else:
            laws[tag] = dm.Elastic(E, nu)
    return laws


def _hertz(rng):
    """Draw a half disc on a block, pressed and perhaps pushed aside."""
    radius = rng.uniform(3, 20)
    kind = str(rng.choice(["paper", "graded", "graded", "graded"]))
    gap = _choice(rng, 0.0, rng.uniform(0, 0.1), -rng.uniform(0, 0.2))
    h = tuple(float(v) for v in rng.uniform(0.15, 0.9, 2))
    cell = str(rng.choice(["triangle", "quadrilateral"]))
    block = (rng.uniform(1.5, 4) * radius, rng.uniform(0.5, 2) * radius)
    depth = max(gap, 0.0) + 10 ** rng.uniform(-3, np.log10(0.6))
    steps = int(rng.integers(1, 6))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    laws = _laws(rng, range(1, 3))
    tilt = _choice(rng, 0, 0, rng.uniform(-0.3, 0.3))
    mesh = {"kind": kind, "h": h, "radius": radius, "gap": gap, "cell": cell, "block": block}
    step = {"depth": depth, "steps": steps, "tilt": tilt}
    return {"mesh": mesh, "slave": slave, "geometry": geometry, "laws": laws} | step


def _sphere(rng):
    """Draw a quarter of a half ball on a block."""
    radius = rng.uniform(4, 12)
    core = radius * rng.uniform(0.1, 0.25)
    h = tuple(core / rng.uniform(1.5, 3.5) for _ in range(2))
    gap = _choice(rng, 0.0, rng.uniform(0, 0.1), -rng.uniform(0, 0.1))
    cell = str(rng.choice(["hexahedron", "tetrahedron"]))
    depth = max(gap, 0.0) + 10 ** rng.uniform(-3, np.log10(0.6))
    steps = int(rng.integers(1, 4))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    laws = _laws(rng, range(1, 3))
    block = (4 * radius, 4 * radius, 1.2 * radius)
    mesh = {"cell": cell, "h": h, "radius": radius, "gap": gap, "core": core, "block": block}
    step = {"depth": depth, "steps": steps}
    return {"mesh": mesh, "slave": slave, "geometry": geometry, "laws": laws} | step


def _pile(rng):
    """Draw two to four wavy blocks on each other, under a displacement or a traction."""
    count = int(rng.integers(2, 5))
    right = rng.uniform(1, 4)
    boxes, gaps, y = [], [], 0.0
    for k in range(count):
        height = rng.uniform(0.4, 1.5)
        narrow = rng.uniform() >= 0.5
        x = (rng.uniform(0, 0.3), right - rng.uniform(0, 0.3)) if narrow else None
        gap = _choice(rng, 0, 0, rng.uniform(0, 0.01), -rng.uniform(0, 0.01)) if k else 0.0
        cells = (int(rng.integers(2, 12)), int(rng.integers(1, 6)))
        boxes.append((*(x or (0.0, right)), y + gap, y + gap + height, *cells))
        gaps.append(gap)
        y += gap + height
    cell = str(rng.choice(["triangle", "quadrilateral"]))
    wave = (_choice(rng, 0.0, rng.uniform(-0.2, 0.2)), rng.uniform(1, 5))
    laws = _laws(rng, range(1, count + 1))
    lower_is_slave = [bool(rng.uniform() < 0.5) for _ in range(1, count)]
    load = str(rng.choice(["disp", "traction"]))
    # two blocks may slide: the upper one is then held by the prescribed displacement
    both = load == "disp" and count == 2
    lateral = str(rng.choice(["west", "none"])) if both else "west"
    depth = 10 ** rng.uniform(-3, np.log10(0.15))
    steps, geometry = int(rng.integers(1, 6)), str(rng.choice(GEOMETRIES))
    tilt = _choice(rng, 0.0, rng.uniform(-0.3, 0.3))
    shape = {"boxes": boxes, "gaps": gaps, "cell": cell, "wave": wave}
    sides = {"lower_is_slave": lower_is_slave, "load": load, "lateral": lateral}
    step = {"geometry": geometry, "laws": laws, "depth": depth, "steps": steps, "tilt": tilt}
    return shape | sides | step


def _boxes3(rng):
    """Draw two boxes with irregular grids and a wavy interface."""
    cell = str(rng.choice(["hexahedron", "tetrahedron"]))
    lower, upper = (tuple(int(v) for v in rng.integers(1, 6, 3)) for _ in range(2))
    ends = (0.0, 1.0, 0.0, 1.0)
    if rng.uniform() < 0.6:
        a, b, c, d = (rng.uniform(0, 0.3) for _ in range(4))
        ends = (a, 1 - b, c, 1 - d)
    gap = _choice(rng, 0.0, rng.uniform(0, 0.01), -rng.uniform(0, 0.01))
    wave = _choice(rng, 0.0, rng.uniform(-0.1, 0.1))
    jitter, grid_seed = rng.uniform(0, 0.6), int(rng.integers(1000))
    laws = _laws(rng, range(1, 3))
    slave, geometry = int(rng.choice([3, 4])), str(rng.choice(GEOMETRIES))
    steps = int(rng.integers(1, 4))
    depth = max(gap, 0.0) + 10 ** rng.uniform(-3, -1)
    tilt = _choice(rng, 0.0, rng.uniform(-0.3, 0.3))
    mesh = {"n_lower": lower, "n_upper": upper, "upper": ends, "gap": gap, "cell": cell}
    mesh |= {"jitter": jitter, "seed": grid_seed}
    step = {"depth": depth, "steps": steps, "tilt": tilt}
    return {"mesh": mesh, "wave": wave, "slave": slave, "geometry": geometry, "laws": laws} | step


def _ring(rng):
    """Draw the half sections of a half ball and a round plate."""
    data = _hertz(rng)
    mesh = data["mesh"] | {"half": True}
    return data | {"mesh": mesh, "tilt": 0.0, "kinematics": "axisymmetric"}


def _heated(rng):
    """Draw rings that are heated while they are pressed; half of the quadrilaterals reduced.

    Cooled bodies would part, and forces of contact be the round-off of those of heat.
    """
    data = _ring(rng)
    heat = {tag: _choice(rng, 0.0, rng.uniform(0, 2e-3)) for tag in data["laws"]}
    reduced = data["mesh"]["cell"] == "quadrilateral" and rng.uniform() < 0.5
    return data | {"heat": heat, "volumetric": "reduced" if reduced else "full"}


def _second(rng):
    """Draw discs on blocks, or balls on plates, of second order on coarser meshes."""
    data = _ring(rng) if rng.uniform() < 0.3 else _hertz(rng)
    mesh = data["mesh"] | {"h": tuple(min(1.5 * h, 0.9) for h in data["mesh"]["h"])}
    return data | {"mesh": mesh, "degree": 2}


def _second3(rng):
    """Draw two boxes of second order."""
    data = _boxes3(rng)
    mesh = data["mesh"]
    coarse = {name: tuple(min(n, 3) for n in mesh[name]) for name in ("n_lower", "n_upper")}
    return data | {"mesh": mesh | coarse, "degree": 2}


def _mixed(rng):
    """Draw discs on blocks, or rings, each body of another one of the newer laws."""
    data = _ring(rng) if rng.uniform() < 0.3 else _hertz(rng)
    return data | {"laws": {tag: _newer_law(rng) for tag in data["laws"]}}


def _newer_law(rng):
    E, nu = 10 ** rng.uniform(3.0, 5.7), rng.uniform(-0.2, 0.49)
    Y, a, H, Q = (E * 10 ** rng.uniform(*ends) for ends in _EXPONENTS)
    kind = str(rng.choice(["isotropic", "mixed", "voce", "cone", "wood"]))
    if kind == "voce":
        b = 10 ** rng.uniform(0.5, 2.5)
        return dm.VonMisesVoce(E, nu, Y, _choice(rng, 0.0, a), H, Q, b)
    if kind == "cone":
        return dm.DruckerPrager(E, nu, Y, rng.uniform(0.05, 0.4))
    if kind == "wood":
        moduli = (E * 10 ** rng.uniform(-1.0, 0.0) for _ in range(6))
        E1, E2, E3, *G = sorted(moduli, reverse=True)
        ratios = (rng.uniform(0.0, 0.45) for _ in range(3))
        return dm.Orthotropic(E1, E2, E3, *ratios, *G, yaw=rng.uniform(0.0, 3.0))
    return dm.VonMises(E, nu, Y, 0.0 if kind == "isotropic" else a, H)


def _friction(rng):
    """Draw bodies of all shapes and cells that are pressed, pushed aside and pushed back.

    "path" holds the way of the push (lateral, and across it in space) and the share of the depth
    at the end of each step.
    """
    base = (_hertz, _boxes3, _ring, _second, _second3)[int(rng.choice(5, p=_SHAPES))]
    data = base(rng)
    name = str(rng.choice(["friction", "friction", "friction", "tresca"]))
    value = _choice(rng, rng.uniform(0.0, 0.3), rng.uniform(0.0, 1.0), 1.0)
    if name == "tresca":
        softest = min(getattr(law, "E", None) or law.E1 for law in data["laws"].values())
        value *= softest * 10 ** rng.uniform(-4.0, -1.0)
    given = str(rng.choice(["number", "constant", "function"]))
    presses, pushes, returns = (int(rng.integers(1, n)) for n in (3, 4, 4))
    far = data["depth"] * rng.uniform(0.1, 1.0)
    eases = float(rng.choice([1.0, 1.0, rng.uniform(0.2, 1.0)]))
    path = [(0.0, 0.0, k / presses) for k in range(1, presses + 1)]
    turn = rng.uniform(-np.pi, np.pi)
    there = far * np.array([np.cos(turn), np.sin(turn)])
    aside = far * rng.uniform(-0.3, 0.3, 2)
    ring = data.get("kinematics") == "axisymmetric"  # cannot be pushed aside, so it is let off
    for k in range(1, pushes + 1):
        path.append((*(there * k / pushes), 1.0 - 0.5 * ring * k / pushes))
    for k in range(1, returns + 1):
        share = k / returns
        depth = 0.5 * (1.0 + share) if ring else 1.0 + share * (eases - 1.0)
        path.append((*((1.0 - 2.0 * share) * there + share * aside), depth))
    law = {"name": name, "value": value, "given": given}
    # limits that act on open sides, too, want sides that stay where they are
    geometry = "reference" if name == "tresca" else data["geometry"]
    walk = {"path": path, "steps": len(path), "tilt": 0.0}
    return data | {"law": law, "geometry": geometry} | walk


def _finite(rng):
    """Draw bodies of all shapes and cells at finite strain, pressed far and perhaps dragged.

    Rubber and metals, also nearly incompressible; where the cells allow it, half of them reduced.
    Frictionless, with updated geometry.
    """
    base = (_hertz, _boxes3, _ring, _second, _second3)[int(rng.choice(5, p=_SHAPES_OF_FINITE))]
    data = base(rng) | {"geometry": "updated", "strain": "finite"}
    ring, d = "kinematics" in data, 3 if "jitter" in data["mesh"] else 2
    size = data["mesh"].get("radius", 1.0)
    depth = max(data["mesh"]["gap"], 0.0) + size * 10 ** rng.uniform(-2.0, -0.7)
    presses, drags = int(rng.integers(1, 5)), int(rng.integers(0, 5))
    way = 0.0 if ring else size * rng.uniform(-0.5, 0.5)
    path = [(0.0, 0.0, k / presses) for k in range(1, presses + 1)]
    path += [(way * k / drags, 0.3 * way * k / drags, 1.0) for k in range(1, drags + 1)]
    laws = {tag: _law_of_finite(rng) for tag in (1, 2)}
    cell, degree = data["mesh"]["cell"], data.get("degree", 1)
    splits = all(getattr(law, "volumetric", None) or law.splits for law in laws.values())
    quads = cell in ("quadrilateral", "hexahedron")
    reduced = splits and (quads or degree == 2) and rng.uniform() < 0.5
    turn = rng.uniform(-0.5, 0.5) if d == 2 and not ring else 0.0
    step = {"depth": depth, "path": path, "steps": len(path), "tilt": 0.0, "turn": turn}
    return data | step | {"laws": laws, "volumetric": "reduced" if reduced else "full"}


def _law_of_finite(rng):
    E, nu = 10 ** rng.uniform(0.0, 3.0), rng.uniform(-0.2, 0.49)
    Y, a, H = (E * 10 ** rng.uniform(*ends) for ends in _EXPONENTS_OF_FINITE)
    mu, bulk = E / 3, E * 10 ** rng.uniform(0.0, 3.0)
    kind = str(rng.choice(["neo", "neo", "mooney", "ogden", "elastic", "mises", "mixed"]))
    if kind == "neo":
        return dm.NeoHooke(E, nu)
    if kind == "mooney":
        share = rng.uniform(0.0, 1.0)
        return dm.MooneyRivlin(share * mu / 2, (1 - share) * mu / 2, bulk)
    if kind == "ogden":
        return dm.Ogden((mu, -mu / 5), (1.5, -2.0), bulk)
    if kind == "elastic":
        return dm.Elastic(E, nu)
    return dm.VonMises(E, nu, Y, a if kind == "mixed" else 0.0, H)


_SHAPES_OF_FINITE = (0.4, 0.2, 0.2, 0.12, 0.08)
_EXPONENTS_OF_FINITE = ((-2.5, -1.3), (-2.0, -0.5), (-2.0, -0.5))
_SHAPES = (0.4, 0.3, 0.1, 0.12, 0.08)
# Of E: yield radius, moduli of kinematic and isotropic hardening, growth of the radius
_EXPONENTS = ((-3.2, -1.8), (-3.0, -0.5), (-3.0, -0.5), (-3.5, -2.0))
KINDS = {
    **{"hertz": _hertz, "sphere": _sphere, "pile": _pile, "boxes3": _boxes3},
    **{"ring": _ring, "heated": _heated, "second": _second, "second3": _second3, "mixed": _mixed},
    "friction": _friction,
    "finite": _finite,
}
