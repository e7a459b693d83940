"""The model of docs/model.md, line by line: slow, dense, and meant to be read beside the equations.

Section numbers are those of docs/model.md. `mechanics.simulate` is the same model, compiled; one test
ties the two.
"""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from needlefit.mechanics import laws
from needlefit.mechanics.control import Bevel, Controls, Rules
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import check_reach
from needlefit.mechanics.tissue import Tissue

Floats = NDArray[np.float64]


def simulate(
    needle: Needle,
    tissue: Tissue,
    bevel: Bevel,
    depth: float,
    controls: Controls = Controls(),
    rules: Rules = Rules(),
) -> NeedleShape:
    """Section 4: push the tip from one constraint point to the next; arguments as in `mechanics.simulate`."""
    check_reach(needle, depth, controls)
    L, C_int = needle.length, rules.spacing
    x_c = constraint_depths(depth, C_int)
    c = np.zeros_like(x_c)
    x_guide = -math.inf if controls.guide_distance is None else -controls.guide_distance
    free = min(L, -x_guide)  # at first contact
    u_tip, slope_tip = controls.base_y + controls.base_slope * free, controls.base_slope
    track = [(u_tip, slope_tip)]
    iterations = 0
    for m in range(1, len(x_c)):
        # c_m = u_tip + (x_m - x_{m-1}) (u'_tip + s b / C_int): along the tangent, turned by the bevel
        c[m] = u_tip + (x_c[m] - x_c[m - 1]) * (slope_tip + bevel.side * bevel.offset / C_int)
        nodes = mesh(x_c[: m + 1], rules.element, max(x_c[m] - L, x_guide))
        guess = np.zeros(2 * len(nodes))
        u, used = equilibrium(
            needle, tissue, nodes, np.column_stack((x_c, c))[: m + 1], guess, controls, rules
        )
        iterations += used
        u_tip, slope_tip = u[-2], u[-1]
        track.append((u_tip, slope_tip))
    return NeedleShape(
        nodes, u[0::2], u[1::2], np.column_stack((x_c, c)), np.array(track), "converged", iterations
    )


def constraint_depths(depth: float, spacing: float) -> Floats:
    """Section 4: 0, then every C_int back from D, so that x_1 is the remainder, or C_int where that is 0."""
    cells = max(1, math.ceil(depth / spacing - 1e-9))
    return np.concatenate(([0.0], depth - spacing * np.arange(cells - 1, -1, -1)))


def mesh(x_c: Floats, h: float, x_base: float) -> Floats:
    """Section 4: the base, the entry unless the next node is too near, then every h back from x_c."""
    inserted = {x_c[1] - j * h for j in range(math.ceil(x_c[1] / h - 1e-9))}
    for a, b in pairwise(x_c[1:]):
        inserted |= {b - j * h for j in range(round((b - a) / h))}
    entry = [0.0] if min(inserted) >= 0.5 * h else []
    return np.array([x_base, *entry, *sorted(inserted)])


def equilibrium(
    needle: Needle,
    tissue: Tissue,
    nodes: Floats,
    constraints: Floats,
    u: Floats,
    controls: Controls,
    rules: Rules,
) -> tuple[Floats, int]:
    """Section 3: find u with int EI u'' v'' + sum_i int k_i(lambda) e g v = 0 for all v, by Newton's method.

    `u` (2 N,) holds deflection and slope of every node; the base's two are prescribed.
    """
    K_b = bending_stiffness(nodes, needle.flexural_rigidity)
    x_q, w_q = quadrature(nodes, constraints[:, 0], tissue.boundaries)
    N, dN = shape_functions(nodes, x_q)  # (Q, 2 N) each
    layer = np.searchsorted(tissue.boundaries, x_q)
    nearest = np.argmin(np.abs(x_q[:, None] - constraints[:, 0]), axis=1)
    t, gamma = tissue.thickness[layer], tissue.friction[layer]
    u = u.copy()
    u[:2] = controls.base_y, controls.base_slope
    before = math.inf
    for iteration in range(rules.max_iterations):
        e = N @ u - constraints[nearest, 1]
        slope = dN @ u
        lam = (t - np.abs(e)) / t
        k, dk = modulus(tissue, layer, lam)
        g = 1 - gamma * np.sin(np.arctan(slope)) ** 2
        dg = -2 * gamma * slope / (1 + slope**2) ** 2
        kt = k - np.abs(e) / t * dk  # d(k e)/de
        residual = K_b @ u + N.T @ (w_q * k * e * g)
        tangent = K_b + N.T @ ((w_q * kt * g)[:, None] * N) + N.T @ ((w_q * k * e * dg)[:, None] * dN)
        step = np.linalg.solve(tangent[2:, 2:], -residual[2:])
        u[2:] += step
        change = np.max(np.abs(step[0::2]))
        if np.any(np.abs(e) >= t) and change < rules.tolerance:
            raise ArithmeticError("tissue is compressed to nothing")
        if change < rules.tolerance or (change < 1e-4 and change > 0.5 * before):  # or it is but rounding
            return u, iteration + 1
        before = change
    raise ArithmeticError(f"no equilibrium after {rules.max_iterations} iterations")


def modulus(tissue: Tissue, layer: NDArray[np.int64], lam: Floats) -> tuple[Floats, Floats]:
    """Section 3: k(lambda) and dk/dlambda at points in the given layers; the law is a sum of powers."""
    c, q = (terms[layer] for terms in laws.power_terms(tissue.law, tissue.alpha))  # (Q, P)
    mu, lam = tissue.mu[layer], lam[:, None]
    return mu * np.sum(c * lam**q, axis=1), mu * np.sum(c * q * lam ** (q - 1), axis=1)


def bending_stiffness(nodes: Floats, EI: float) -> Floats:
    """Return int EI N_i'' N_j'' dx, (2 N, 2 N), of two-node cubic elements."""
    K = np.zeros((2 * len(nodes), 2 * len(nodes)))
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


def quadrature(nodes: Floats, x_c: Floats, boundaries: Floats) -> tuple[Floats, Floats]:
    """Section 3: two Gauss points on each interval without node, boundary or change of constraint inside."""
    halfway = (x_c[1:] + x_c[:-1]) / 2
    edges = np.unique(np.clip(np.concatenate(([0.0], nodes, halfway, boundaries)), 0.0, x_c[-1]))
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    points = middle[:, None] + half[:, None] * np.array([-1, 1]) / math.sqrt(3)
    return points.ravel(), np.repeat(half, 2)


def shape_functions(nodes: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return the cubic Hermite functions of all nodes, and their slopes, at points x: (Q, 2 N) each."""
    N, dN = np.zeros((len(x), 2 * len(nodes))), np.zeros((len(x), 2 * len(nodes)))
    element = np.clip(np.searchsorted(nodes, x) - 1, 0, len(nodes) - 2)
    h = np.diff(nodes)[element]
    s = (x - nodes[element]) / h
    values = (1 - 3 * s**2 + 2 * s**3, h * s * (1 - s) ** 2, 3 * s**2 - 2 * s**3, h * s**2 * (s - 1))
    slopes = (6 * s * (s - 1) / h, (1 - s) * (1 - 3 * s), 6 * s * (1 - s) / h, s * (3 * s - 2))
    for j in range(4):
        N[np.arange(len(x)), 2 * element + j] = values[j]
        dN[np.arange(len(x)), 2 * element + j] = slopes[j]
    return N, dN
