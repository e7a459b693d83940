"""Derivatives of a needle's shape by complex steps through the equations, dense and apart from the kernel.

f(p + i h) = f(p) + i h f'(p) to rounding for h = 1e-30: nothing is subtracted, so nothing cancels. All
branches follow real parts; |e| is the root of e . e. What the kernel linearises by hand is here left to
complex arithmetic: boundaries and guides carry their step into quadrature points, weights and shape
functions.
"""

# ruff: noqa: N803, N806  EI, K, N: the symbols of the equations
import math
from collections.abc import Sequence

import numpy as np

from needlefit.mechanics import reference
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, list_stops, make_lattice
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import turn_tip

H = 1e-30
GUIDE_PARTS = ("x", "y", "slope", "z", "slope_z")


class Inputs:
    """The numbers of a case as complex ones, one of them with a step."""

    def __init__(self, needle: Needle, tissue: Tissue, stands: Sequence[float], name: str) -> None:
        for kind in ("mu", "shape", "friction", "boundaries", "thickness"):
            setattr(self, kind, getattr(tissue, kind).astype(complex))
        self.law = LAWS[tissue.law]
        shape = dict(zip(self.law.shape_names, self.shape, strict=True))
        self.rigidity = complex(needle.flexural_rigidity)
        self.offset = self.cut_angle = self.base_y = self.base_slope = self.stage_slope = 0j
        self.roll = self.base_z = self.base_slope_z = self.stage_slope_z = 0j
        self.guides = {x: np.zeros(5, dtype=complex) for x in stands}
        kind, _, what = name.partition("_") if name.startswith("guide") else (name, "", "")
        number = int("".join(filter(str.isdigit, kind)) or 0)
        kind = kind.rstrip("0123456789")
        if kind == "guide":
            self.guides[stands[number - 1]][GUIDE_PARTS.index(what)] += H * 1j
        elif number:
            row = (
                self.boundaries
                if kind == "boundary"
                else shape[kind]
                if kind in shape
                else getattr(self, kind)
            )
            row[number - 1] += H * 1j
        else:
            setattr(self, kind, getattr(self, kind) + H * 1j)


def follow(
    needle: Needle, tissue: Tissue, steps: Sequence[Step], rules: ModelOptions, name: str,
    lattice: Lattice | None = None,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """Return the derivatives of nodes, deflection, slope and constraint points by one parameter.

    All but those of the nodes have a leading axis of two, y and z.
    """
    steps = turn_tip(needle, tissue, steps)
    stands = sorted({guide.x for step in steps for guide in step.controls.guides})
    inputs = Inputs(needle, tissue, stands, name)
    lattice = lattice or make_lattice(steps, rules)
    still = np.zeros(2, dtype=complex)
    c, rays, tip, slopes, cut = {0: still}, {}, (0.0, still, still), {}, still
    for stop in list_stops(steps, lattice, needle.length):
        if stop.starts_ray:
            rays[stop.ray] = *tip[:2], rules.tangent * tip[2]
            if rules.path_angle:
                c[0] = cut if tip[0] == 0 else c[0]
                before = slopes[stop.cell - 2] if stop.extrapolates else tip[2]
                rays[stop.ray] = tip[0], cut, 1.5 * tip[2] - 0.5 * before
        if stop.cell > 0:
            x, u, slope = rays[stop.ray]
            bevel = steps[stop.bevel_id].bevel
            turn = (bevel.offset + inputs.offset) / rules.spacing
            if rules.path_angle:
                turn = bevel.cut_angle + inputs.cut_angle
            (y, z), roll = bevel.toward, inputs.roll
            toward = np.array([y * np.cos(roll) - z * np.sin(roll), z * np.cos(roll) + y * np.sin(roll)])
            c[stop.cell] = u + (stop.tip - x) * (slope + turn * toward)
        x_c = np.array([lattice.depth(m) for m in range(stop.cell)] + [stop.tip])
        y_c = np.array([c[m] for m in range(stop.cell + 1)])
        controls = steps[stop.controls_id].controls
        real, guess, held = reference.mesh(stop, controls, lattice, needle.length, rules.element)
        nodes, state = (
            real.astype(complex),
            guess.astype(complex).reshape(-1, 2, 2),
        )  # node, u or slope, plane
        state[0, 0, 0] += inputs.base_y + inputs.stage_slope * stop.tip
        state[0, 0, 1] += inputs.base_z + inputs.stage_slope_z * stop.tip
        state[0, 1] += inputs.base_slope, inputs.base_slope_z
        for guide in controls.guides:
            for node in np.flatnonzero(real == guide.x):
                holds = held.reshape(-1, 2)[node]  # not at the tip, nor at a node that is there anyway
                nodes[node] += inputs.guides[guide.x][0] * holds[0]
                state[node] += inputs.guides[guide.x][1:].reshape(2, 2).T * holds[:, None]
        state = _equilibrium(inputs, nodes, x_c, y_c, state.reshape(-1, 2), held, rules).reshape(-1, 2, 2)
        tip = (stop.tip, state[-1, 0], state[-1, 1])
        slopes[stop.cell] = tip[2]
        cut = c[stop.cell] if stop.cell > 0 else tip[1]
    return tuple(a.imag / H for a in (nodes, state[:, 0].T, state[:, 1].T, y_c.T))


def _equilibrium(inputs, nodes, x_c, y_c, u, held, rules):
    K_b = _bending(nodes, inputs.rigidity)
    x, w, layer, nearest = _quadrature(nodes, x_c, inputs.boundaries, rules)
    c = y_c[nearest]
    if rules.path_angle:  # at complex places too
        cell = np.clip(np.searchsorted(x_c, x.real) - 1, 0, len(x_c) - 2)
        c = y_c[cell] + (x - x_c[cell])[:, None] * (np.diff(y_c, axis=0) / np.diff(x_c)[:, None])[cell]
    N, dN = _shapes(nodes, x)
    free = np.tile(~held, 2)
    t, gamma = inputs.thickness[layer], inputs.friction[layer]
    left = 4  # Newton steps after the real part has converged: the imaginary one is a step behind
    for _ in range(60):
        e, slope = N @ u - c, dN @ u
        size = np.sqrt(np.sum(e**2, axis=1))
        lam = 1 - size / t
        mu, shape = inputs.mu[layer], inputs.shape[:, layer]
        k = mu * inputs.law.k(lam, *shape)
        # the tangent may be real: it is exact where the real part has converged
        dk = mu * inputs.law.dk_dstretch(lam.real, *shape.real)
        away = e / np.where(size == 0, 1, size)[:, None]
        steep = np.sum(slope**2, axis=1)
        g = 1 - gamma * steep / (1 + steep)
        dg = -2 * gamma[:, None] * slope / (1 + steep)[:, None] ** 2
        residual = K_b @ u + N.T @ ((w * k * g)[:, None] * e)
        rows = []
        for i in (0, 1):
            blocks = []
            for j in (0, 1):
                by_e = w * g * (k * (i == j) - size / t * dk * away[:, i] * away[:, j])
                by_slope = w * k * e[:, i] * dg[:, j]
                blocks.append((i == j) * K_b + N.T @ (by_e[:, None] * N + by_slope[:, None] * dN))
            rows.append(blocks)
        step = np.linalg.solve(np.block(rows)[np.ix_(free, free)], -residual.T.ravel()[free])
        change = np.zeros(u.size, dtype=complex)
        change[free] = step
        u = u + change.reshape(2, -1).T
        if np.max(np.abs(step.real), initial=0.0) < 1e-7:
            left -= 1
            if left == 0:
                return u
    raise ArithmeticError("the oracle found no equilibrium")


def _bending(nodes, EI):
    K = np.zeros((2 * len(nodes), 2 * len(nodes)), dtype=complex)
    for a, h in enumerate(np.diff(nodes)):
        block = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
        block += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
        K[2 * a : 2 * a + 4, 2 * a : 2 * a + 4] += EI / h**3 * np.array(block)
    return K


def _quadrature(nodes, x_c, boundaries, rules):
    """Split at whatever lies strictly between entry and tip, as complex places in the order of real ones."""
    change = (1 - rules.switch) * x_c[:-1] + rules.switch * x_c[1:]
    inner = np.concatenate((nodes, change, boundaries, x_c if rules.path_angle else x_c[:0]))
    inner = inner[(inner.real > 0) & (inner.real < x_c[-1])]
    edges = np.concatenate(([0j], inner[np.argsort(inner.real, kind="stable")], [x_c[-1] + 0j]))
    edges = edges[np.concatenate(([True], np.diff(edges.real) > 0))]
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    x = (middle[:, None] + half[:, None] * np.array([-1, 1]) / math.sqrt(3)).ravel()
    layer = np.searchsorted(boundaries.real, x.real)
    nearest = np.searchsorted(change, x.real)
    return x, np.repeat(half, 2), layer, nearest


def _shapes(nodes, x):
    N = np.zeros((len(x), 2 * len(nodes)), dtype=complex)
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
