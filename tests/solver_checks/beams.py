"""Beams whose deflection is known exactly: under a uniform load, and on an elastic foundation.

The load is a very soft tissue whose cut lies so far away that it pulls with the same force everywhere. The
needle of length L stands clamped at its base and is loaded by q on its inserted part, s > a = L - D from the
base:

    24 EI u / q = s^2 ( 6 (L^2 - a^2) - 4 s (L - a) )               s < a
                  s^2 ( 6 L^2 - 4 s L + s^2 ) - a^3 ( 4 s - a )     s > a

A prop at s = p adds a force P that keeps u(p) = 0; it moves the beam by P p^2 (3 s - p) / 6 EI beyond, by
P s^2 (3 p - s) / 6 EI before the prop.

On a foundation of modulus k, EI u'''' + k u = 0: the state v = (u, u', u'', u''') changes by the exponential
of a constant matrix from one interface to the next. The base is clamped and displaced by 1 mm.
"""

# ruff: noqa: N806  L, A: the symbols of the equations
from functools import partial

import numpy as np
from equilibrium import equilibrium
from scipy.linalg import expm

from needlefit.mechanics.control import Controls, Guide, TrackedTip
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from solver_checks import NEEDLE, interpolate, sample_between

EI, L = NEEDLE.flexural_rigidity, NEEDLE.length
LOADED_MM = 90.0
LOAD = 1e-3  # N/mm
FAR = 1e9  # mm: the reaction varies by 1e-9 of itself while the needle bends
FREE_MM, DEPTH_MM = 20.0, 40.0  # before and in the foundation


def _find_error(shape, exact, start):
    """Return the largest error of the deflection from `start` on, mm."""
    x = np.union1d(shape.x, sample_between(shape.x))
    x = x[x >= start]
    return float(np.max(np.abs(interpolate(shape, x) - exact(x))))


def measure_loaded(prop=None, controls=Controls()):
    """Return the largest error over the largest deflection; `prop` is its distance from the base, mm."""
    # linear law: the force is 3 mu e, and e is FAR almost everywhere
    tissue = Tissue([LOAD / FAR / 3], [1.0], thickness=1e3 * FAR, law="linear")
    depths = np.arange(LOADED_MM + 0.5)
    points = np.column_stack((depths, np.full(len(depths), FAR), np.zeros(len(depths))))

    def bend(s):
        a = L - LOADED_MM
        before = s**2 * (6 * (L**2 - a**2) - 4 * s * (L - a))
        beyond = s**2 * (6 * L**2 - 4 * s * L + s**2) - a**3 * (4 * s - a)
        return LOAD / (24 * EI) * np.where(s < a, before, beyond)

    def push(s, p):
        near, far = np.minimum(s, p), np.maximum(s, p)
        return near**2 * (3 * far - near) / (6 * EI)

    def exact(x):
        s = x + L - LOADED_MM
        if prop is None:
            return bend(s)
        at = np.array([prop])
        return bend(s) - push(s, prop) * bend(at) / push(at, prop)

    shape = equilibrium(NEEDLE, tissue, points, controls)
    return _find_error(shape, exact, LOADED_MM - L) / float(np.max(np.abs(exact(shape.x))))


def measure_foundation(k, interfaces=()):
    """Return the largest error of the deflection, mm, in layers of moduli `k` (MPa)."""
    edges = np.array([-FREE_MM, 0.0, *interfaces, DEPTH_MM])
    A = [np.diag([1.0, 1.0, 1.0], 1) for _ in edges[1:]]
    for matrix, modulus in zip(A[1:], k, strict=True):
        matrix[3, 0] = -modulus / EI
    to_edge = [np.eye(4)]  # from the base to each edge
    for matrix, length in zip(A, np.diff(edges), strict=True):
        to_edge.append(expm(matrix * length) @ to_edge[-1])
    # u = 1 and u' = 0 at the base, u'' = u''' = 0 at the tip
    moment, shear = np.linalg.solve(to_edge[-1][2:, 2:], -to_edge[-1][2:, 0])

    def exact(x):
        piece = np.clip(np.searchsorted(edges, x) - 1, 0, len(A) - 1)
        states = (expm(A[i] * (at - edges[i])) @ to_edge[i] for i, at in zip(piece, x, strict=True))
        return np.array([state[0] @ [1.0, 0.0, moment, shear] for state in states])

    return _measure_inserted(k, interfaces, DEPTH_MM, Controls(base_y=1.0), exact)


def measure_clamped_entry(k, depth):
    """Return the largest error, mm, of a needle that a guide clamps at the entry: Hetenyi's formula."""
    beta = (k / (4 * EI)) ** 0.25
    held = Controls(guides=(Guide(0.0, 1.0, 0.0, in_tissue=True),))
    return _measure_inserted(
        (k,), (), depth, held, lambda x: np.exp(-beta * x) * (np.cos(beta * x) + np.sin(beta * x))
    )


def _measure_inserted(
    k,
    interfaces,
    depth,
    controls,
    exact,
):
    tissue = Tissue([one / 3 for one in k], [1.0] * len(k), interfaces, law="linear")
    depths = np.arange(depth + 0.5)
    points = np.outer(depths, [1.0, 0.0, 0.0])
    return _find_error(equilibrium(Needle(depth + FREE_MM, EI), tissue, points, controls), exact, 0.0)


SOFT, STIFF, INTERFACE_MM = 0.6, 99.0, 12.37  # MPa: 3 mu of the paper's layers; mm: inside an element
LOADED = {
    "cantilever": measure_loaded,
    "free guide 25 mm before the tissue": partial(
        measure_loaded, L - LOADED_MM - 25.0, Controls(guides=(Guide(-25.0, slope=None),))
    ),
    "tracked tip": partial(measure_loaded, L, Controls(tip=TrackedTip(0.0))),
}
FOUNDED = {
    "soft": partial(measure_foundation, (SOFT,)),
    "stiff": partial(measure_foundation, (STIFF,)),
    "soft before stiff": partial(measure_foundation, (SOFT, STIFF), (INTERFACE_MM,)),
    "stiff before soft": partial(measure_foundation, (STIFF, SOFT), (INTERFACE_MM,)),
    "semi-infinite, clamped entry": partial(measure_clamped_entry, 30.0, 130.0),
}
