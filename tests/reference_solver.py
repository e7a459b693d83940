"""The model of docs/model.md, line by line: slow, dense, apart from the kernel, which tests compare with it.

Section numbers are those of docs/model.md. Displacements, slopes and the cut have two components, along y and
z; those along z are 0 where all inputs lie in the plane z = 0.

Derivatives are by complex steps: f(p + i h) = f(p) + i h f'(p) to rounding for h = 1e-30, since nothing is
subtracted. Branches follow real parts; |e| is the root of e . e. What the kernel linearises by hand is here
left to complex arithmetic: boundaries and guides carry their step into quadrature points, weights and shape
functions.
"""

# ruff: noqa: N803, N806  EI, K, N: the symbols of the equations
import math

import numpy as np

from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.plan import make_lattice, make_moves, make_stops
from needlefit.mechanics.shape import NeedleShape, compute_scales
from needlefit.mechanics.torsion import turn_tip

H = 1e-30
GUIDE_ENGAGEMENT_MM = 0.05
GUIDE_PARTS = ("x", "y", "slope", "z", "slope_z")


class Inputs:
    """The numbers of a case; complex ones if one of them, `name`, has a step."""

    def __init__(self, needle, tissue, steps, name=""):
        dtype = complex if name else float
        for kind in ("mu", "shape", "friction", "boundaries", "thickness"):
            setattr(self, kind, getattr(tissue, kind).astype(dtype))
        self.law = LAWS[tissue.law]
        self.rigidity = dtype(needle.flexural_rigidity)
        # what is added to the inputs of the steps
        self.offset = self.cut_angle = self.base_y = self.base_slope = self.stage_slope = dtype(0)
        self.roll = self.base_z = self.base_slope_z = self.stage_slope_z = dtype(0)
        places = sorted({guide.x for step in steps for guide in step.controls.guides})
        self.guides = {x: np.zeros(5, dtype) for x in places}
        kind, _, part = name.partition("_") if name.startswith("guide") else (name, "", "")
        number = int("".join(filter(str.isdigit, kind)) or 0)
        kind = kind.rstrip("0123456789")
        if kind == "guide":
            self.guides[places[number - 1]][GUIDE_PARTS.index(part)] += H * 1j
        elif number:
            shape = dict(zip(self.law.shape_names, self.shape, strict=True))
            rows = {**shape, "boundary": self.boundaries, "mu": self.mu, "friction": self.friction}
            rows[kind][number - 1] += H * 1j
        elif name:
            setattr(self, kind, getattr(self, kind) + H * 1j)


def simulate_steps(
    needle,
    tissue,
    steps,
    rules=ModelOptions(),
    lattice=None,
):
    """Bring the tip from stop to stop (section 4); arguments as in `mechanics.simulate.simulate_steps`."""
    steps = turn_tip(needle, tissue, steps)
    return advance(Inputs(needle, tissue, steps), needle, tissue, steps, rules, lattice)


def differentiate(
    needle,
    tissue,
    steps,
    rules,
    name,
    lattice=None,
):
    """Return the derivatives of nodes, deflection, slope and constraint points by one parameter.

    All but those of the nodes have a leading axis of two, y and z.
    """
    steps = turn_tip(needle, tissue, steps)
    shape = advance(Inputs(needle, tissue, steps, name), needle, tissue, steps, rules, lattice)
    planes = (shape.u, shape.w), (shape.slope, shape.slope_z), shape.constraints[:, 1:].T
    return tuple(np.imag(part) / H for part in (shape.x, *planes))


def advance(
    inputs,
    needle,
    tissue,
    steps,
    rules,
    lattice,
):
    """Return the shape at the last stop, its numbers complex where those of the inputs are."""
    lattice = lattice or make_lattice(steps, rules)
    C_int = rules.spacing
    still = np.zeros(2, inputs.mu.dtype)
    c = {0: still}  # y and z of the constraint points, by their number
    rays = {}  # where each ray begins: x, (y, z) and slopes
    track = {}
    x_tip, u_tip, slope_tip, c_tip = 0.0, still, still, still
    iterations = 0
    for stop in make_stops(make_moves(steps, needle.length), lattice):
        if stop.starts_ray:
            if rules.path_angle:
                if x_tip == 0:
                    c[0] = c_tip
                # phi_m = 3/2 u'_{m-1} - 1/2 u'_{m-2}, or u'_{m-1} after a change
                before = track[stop.cell - 2][1] if stop.extrapolates else slope_tip
                rays[stop.ray] = x_tip, c_tip, slope_tip + (slope_tip - before) / 2
            else:
                rays[stop.ray] = x_tip, u_tip, rules.tangent * slope_tip  # tangent: 1, but in variants
        if stop.cell > 0:
            # c_m = u_tip + (x_m - x_tip) (u'_tip + (b / C_int) (cos rho, sin rho)): along the tangent, turned
            # by the bevel; or c_m = c_tip + (x_m - x_tip) (phi_m + theta (cos rho, sin rho)): at an angle to
            # the path
            x_0, c_0, slope_0 = rays[stop.ray]
            bevel = steps[stop.bevel_id].bevel
            turn = (bevel.offset + inputs.offset) / C_int
            if rules.path_angle:
                turn = bevel.cut_angle + inputs.cut_angle
            (y, z), cos, sin = bevel.toward, np.cos(inputs.roll), np.sin(inputs.roll)
            c[stop.cell] = c_0 + (stop.tip - x_0) * (
                slope_0 + turn * np.array([y * cos - z * sin, z * cos + y * sin])
            )
        x_c = np.array([lattice.depth(m) for m in range(stop.cell)] + [stop.tip])
        points = np.column_stack((x_c, [c[m] for m in range(stop.cell + 1)]))  # (M + 1, 3)
        controls = steps[stop.controls_id].controls
        nodes, u, prescribed = mesh(stop, controls, lattice, needle.length, rules.element)
        nodes, u = add_steps(inputs, stop, controls, nodes, u, prescribed)
        u, used = equilibrium(inputs, nodes, points, u, prescribed, rules)
        iterations += used
        x_tip, u_tip, slope_tip = stop.tip, u[-2], u[-1]
        c_tip = c[stop.cell] if stop.cell > 0 else u_tip
        track[stop.cell] = u_tip, slope_tip
    tips = np.array([np.column_stack(track[m]).ravel() for m in range(stop.cell + 1)])
    scales = compute_scales(tissue, stop.tip, C_int)
    (y, z), (slope_y, slope_z) = u[0::2].T, u[1::2].T
    return NeedleShape(nodes, y, slope_y, z, slope_z, points, tips, "converged", iterations, scales)


def mesh(stop, controls, lattice, L, h):
    """Return the nodes of one stop and the prescribed deflections and slopes (sections 3 and 4).

    Base and guides; the entry; every h, fixed in the tissue; the tip. Very short elements ruin the
    conditioning: the entry gets no node when the next one is nearer than h / 2, nor does a place nearer
    than h / 2 to the tip or h / 4 to a guide in the tissue, which holds once the tip is GUIDE_ENGAGEMENT_MM
    past it.

    Deflections and slopes of every node (2 N, 2), along y and z, are what is prescribed, else 0; which are,
    (2 N,), says the last array.
    """
    tip = stop.tip
    within = [guide for guide in controls.within if guide.x <= tip - GUIDE_ENGAGEMENT_MM]
    least = lattice.first_cell - h * (math.ceil((lattice.first_cell - 1e-9) / h) - 1)  # in (0, h]
    fixed = [x for x in least + h * np.arange(math.ceil(tip / h)) if x <= tip - h / 2 + 1e-9]
    fixed = [x for x in fixed if all(abs(x - guide.x) >= h / 4 for guide in within)]
    inserted = sorted([*fixed, *(guide.x for guide in within), tip])
    entry = [0.0] if inserted[0] >= h / 2 - 1e-9 * h else []
    nodes = [tip - L, *(guide.x for guide in controls.before), *entry, *inserted]

    u, prescribed = np.zeros((len(nodes), 2, 2)), np.zeros((len(nodes), 2), dtype=bool)
    u[0, 0] = controls.base_y + controls.stage_slope * tip, controls.base_z + controls.stage_slope_z * tip
    u[0, 1] = controls.base_slope, controls.base_slope_z
    prescribed[0] = True
    held = [(nodes.index(g.x), g) for g in (*controls.before, *within)]
    if controls.tip is not None:
        held.append((len(nodes) - 1, controls.tip))
    for node, one in held:
        u[node] = (one.y, one.z), (0.0, 0.0) if one.slope is None else (one.slope, one.slope_z)
        prescribed[node] = True, one.slope is not None
    return np.array(nodes), u.reshape(-1, 2), prescribed.ravel()


def add_steps(inputs, stop, controls, nodes, u, prescribed):
    """Return nodes and prescribed values of a mesh with what the inputs add to base and guides."""
    x, dtype = nodes, inputs.mu.dtype
    nodes, u, held = nodes.astype(dtype), u.astype(dtype).reshape(-1, 2, 2), prescribed.reshape(-1, 2)
    u[0, 0, 0] += inputs.base_y + inputs.stage_slope * stop.tip
    u[0, 0, 1] += inputs.base_z + inputs.stage_slope_z * stop.tip
    u[0, 1] += inputs.base_slope, inputs.base_slope_z
    for guide in controls.guides:
        for node in np.flatnonzero(x == guide.x):
            # not at the tip, nor at a node that is there anyway
            nodes[node] += inputs.guides[guide.x][0] * held[node, 0]
            u[node] += inputs.guides[guide.x][1:].reshape(2, 2).T * held[node][:, None]
    return nodes, u.reshape(-1, 2)


def equilibrium(inputs, nodes, constraints, u, prescribed, rules):
    """Find u with int EI u'' v'' + sum_i int k_i(lambda) e g v = 0 for all v, by Newton's method (section 3).

    `u` (2 N, 2) is a guess of deflections and slopes of every node, true where they are `prescribed` (2 N,).
    """
    K_b = bending_stiffness(nodes, inputs.rigidity)
    change = change_depths(constraints[:, 0].real, rules)
    x_q, w_q = quadrature(nodes, change, inputs.boundaries)
    N, dN = shape_functions(nodes, x_q)  # (Q, 2 N) each
    layer = np.searchsorted(inputs.boundaries.real, x_q.real)
    c_q = cut(rules, x_q, change, constraints)
    mu, shape = inputs.mu[layer], inputs.shape[:, layer]
    t, gamma = inputs.thickness[layer], inputs.friction[layer]
    u = u.copy()
    free = np.tile(~prescribed, 2)  # of all unknowns along y, then of those along z
    before, settled = math.inf, 0
    for iteration in range(rules.max_iterations):
        e, slope = N @ u - c_q, dN @ u  # (Q, 2) each
        distance, steepness = (np.sqrt(np.sum(part**2, axis=1)) for part in (e, slope))
        lam = (t - distance) / t
        k = mu * inputs.law.k(lam, *shape)
        # the tangent may be real: it is exact where the real part has converged
        dk = mu.real * inputs.law.k(lam.real + H * 1j, *shape.real).imag / H
        g = 1 - gamma * steepness**2 / (1 + steepness**2)  # sin^2(atan |u'|)
        dg = -2 * gamma[:, None] * slope / (1 + steepness**2)[:, None] ** 2  # by both slopes
        away = e / np.where(distance == 0, 1, distance)[:, None]  # the direction of e
        stiffening = -distance / t * dk  # |e| dk/d|e|
        residual = K_b @ u + N.T @ ((w_q * k * g)[:, None] * e)
        # Derivatives of the force along i by e along j, which are w_q g (k + |e| dk/d|e|) along e and w_q g k
        # across it, and by the slope along j.
        by_e = [
            [w_q * g * (k * (i == j) + stiffening * away[:, i] * away[:, j]) for j in (0, 1)] for i in (0, 1)
        ]
        by_slope = [[w_q * k * e[:, i] * dg[:, j] for j in (0, 1)] for i in (0, 1)]
        tangent = np.block(
            [
                [
                    (i == j) * K_b + N.T @ (by_e[i][j][:, None] * N + by_slope[i][j][:, None] * dN)
                    for j in (0, 1)
                ]
                for i in (0, 1)
            ]
        )
        step = np.zeros(u.size, u.dtype)
        # Prescribed values do not change: their rows and columns are left out.
        step[free] = np.linalg.solve(tangent[np.ix_(free, free)], -residual.T.ravel()[free])
        u = u + step.reshape(2, -1).T
        size = np.max(np.abs(step.real))  # of deflections, and of slopes over a millimetre
        if size < rules.tolerance or (size < 1e-4 and size > 0.5 * before):  # or it is but rounding
            if np.any(distance.real >= t.real):
                raise ArithmeticError("tissue is compressed to nothing")
            settled += 1
            if settled == (4 if np.iscomplexobj(u) else 1):  # the imaginary part is a step behind
                return u, iteration + 1
        before = size
    raise ArithmeticError(f"no equilibrium after {rules.max_iterations} iterations")


def compute_positions(shape, s):
    """Return the points (K, 3) at beam coordinates: integrals from the base (section 5) of
    (cos th, u' sin th / th, w' sin th / th) with th^2 = u'^2 + w'^2.

    By Simpson's rule on a thousand pieces of every interval between nodes and wanted coordinates.
    """
    # node, direction, deflection and slope
    u = np.stack((shape.u, shape.slope, shape.w, shape.slope_z), axis=1).reshape(-1, 2, 2)
    edges = np.union1d(shape.x, s)
    at = edges[:-1, None] + np.diff(edges)[:, None] * np.linspace(0, 1, 2001)
    _, dN = shape_functions(shape.x, at.ravel())
    y, z = ((dN @ u[:, plane].ravel()).reshape(at.shape) for plane in (0, 1))
    angle = np.hypot(y, z)
    simpson = np.array([1, *(4, 2) * 999, 4, 1]) / 6000
    direction = np.cos(angle), y * np.sinc(angle / np.pi), z * np.sinc(angle / np.pi)
    pieces = np.column_stack([np.diff(edges) * (part @ simpson) for part in direction])
    reached = np.vstack(([shape.x[0], shape.u[0], shape.w[0]], pieces)).cumsum(axis=0)
    return reached[np.searchsorted(edges, s)]


def bending_stiffness(nodes, EI):
    """Return the bending stiffness int EI N_i'' N_j'' dx, (2 N, 2 N), of two-node cubic elements."""
    K = np.zeros((2 * len(nodes), 2 * len(nodes)), nodes.dtype)
    for a, h in enumerate(np.diff(nodes)):
        K[2 * a : 2 * a + 4, 2 * a : 2 * a + 4] += (EI / h**3) * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    return K


def change_depths(x_c, rules):
    """Return the depths where the next constraint point takes over (section 3); of a linear cut also those of
    the points, where it bends.
    """
    where = (1 - rules.switch) * x_c[:-1] + rules.switch * x_c[1:]
    return np.sort(np.concatenate((where, x_c))) if rules.path_angle else where


def cut(rules, x, change, constraints):
    """Return c(x), (Q, 2): of the nearest constraint point (section 3), or linear between (section 4)."""
    if not rules.path_angle:
        return constraints[np.searchsorted(change, x.real), 1:]
    x_c = constraints[:, 0].real
    cell = np.clip(np.searchsorted(x_c, x.real) - 1, 0, len(x_c) - 2)
    slope = np.diff(constraints[:, 1:], axis=0) / np.diff(x_c)[:, None]
    return constraints[cell, 1:] + (x - x_c[cell])[:, None] * slope[cell]


def quadrature(nodes, change, boundaries):
    """Return two Gauss points and weights on each interval free of nodes, boundaries and changes of
    constraint (section 3).
    """
    inner = np.concatenate((nodes, change, boundaries))
    inner = inner[(inner.real > 0) & (inner.real < nodes[-1].real)]
    inner = inner[np.argsort(inner.real, kind="stable")]
    edges = np.concatenate(([0.0], inner, nodes[-1:]))
    edges = edges[np.concatenate(([True], np.diff(edges.real) > 0))]
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    points = middle[:, None] + half[:, None] * np.array([-1, 1]) / math.sqrt(3)
    return points.ravel(), np.repeat(half, 2)


def shape_functions(nodes, x):
    """Return the cubic Hermite functions of all nodes, and their slopes, at points x: (Q, 2 N) each."""
    N = np.zeros((len(x), 2 * len(nodes)), nodes.dtype)
    dN = np.zeros_like(N)
    element = np.clip(np.searchsorted(nodes.real, x.real) - 1, 0, len(nodes) - 2)
    h = np.diff(nodes)[element]
    s = (x - nodes[element]) / h
    values = (1 - 3 * s**2 + 2 * s**3, h * s * (1 - s) ** 2, 3 * s**2 - 2 * s**3, h * s**2 * (s - 1))
    slopes = (6 * s * (s - 1) / h, (1 - s) * (1 - 3 * s), 6 * s * (1 - s) / h, s * (3 * s - 2))
    for j in range(4):
        N[np.arange(len(x)), 2 * element + j] = values[j]
        dN[np.arange(len(x)), 2 * element + j] = slopes[j]
    return N, dN
