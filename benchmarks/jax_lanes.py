"""The model in JAX, as one would write it for a CPU: scans over steps and nodes, vmap over parameter sets.

Shapes must not change under a scan, so every step works on all 55 elements and those beyond the tip are
made inert. It has the package's quadrature and series of the law, and its rule for stopping Newton; its
free span is one exact element too. It needs `jax` (CPU), which needlefit does not.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from needlefit.mechanics.batch import Batch
from needlefit.mechanics.native import EvaluatedLaw
from needlefit.mechanics.packing import evaluate_layer
from needlefit.mechanics.tissue import Tissue

jax.config.update("jax_enable_x64", True)

Floats = NDArray[np.float64]
_EDGE = 0.25 + np.array([-0.25, 0.25]) / np.sqrt(3.0)  # Gauss points of half an element
_S = np.concatenate((_EDGE, _EDGE + 0.5))  # (4,) of the points in an element of 1 mm
_N = np.stack(
    [1 - 3 * _S**2 + 2 * _S**3, _S * (1 - _S) ** 2, 3 * _S**2 - 2 * _S**3, _S**2 * (_S - 1)], axis=1
)
_WEIGHT = 0.25
_BENDING = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])


def compile_batch(batch: Batch) -> tuple[Callable[[], tuple[Floats, Floats]], int]:
    """Return a function that gives tips (B,) and Newton passes (B,), and the number of its steps."""
    depth = round(batch.steps[-1].depth)
    layer = np.searchsorted(batch.tissue.boundaries, np.arange(depth) + 0.5)
    laws = [_evaluate_layers(batch.pick(i)[1]) for i in range(len(batch))]
    series = jnp.array([[law[n].series for n in layer] for law in laws])  # (B, E, 6)
    curvature = jnp.array([max(one.curvature for one in law) for law in laws])
    rigidity, length = batch.needle.flexural_rigidity, batch.needle.length
    tolerance = batch.rules.tolerance

    def insertion(series, curvature, offset):
        def step(carry, m):
            c, u, passes = carry
            ahead = u[m - 1, 0] + u[m - 1, 1]
            c = c.at[m].set(ahead + offset)
            u = u.at[m].set(jnp.array([ahead, u[m - 1, 1]]))
            inside = jnp.arange(depth) < m

            def unfinished(state):
                _, change, count = state
                return (jnp.minimum(change, curvature * change**2) >= tolerance) & (count < 40)

            def improve(state):
                u, _, count = state
                new = _newton(u, c, series, inside, rigidity, length - m)
                return new, jnp.max(jnp.abs(new[:, 0] - u[:, 0])), count + 1

            u, _, count = lax.while_loop(unfinished, improve, (u, jnp.inf, 0))
            return (c, u, passes + count), None

        start = jnp.zeros(depth + 1), jnp.zeros((depth + 1, 2)), 0
        (_, u, passes), _ = lax.scan(step, start, jnp.arange(1, depth + 1))
        return u[-1, 0], passes

    run = jax.jit(jax.vmap(insertion))
    offset = jnp.array(batch.offset)

    def call() -> tuple[Floats, Floats]:
        tip, passes = run(series, curvature, offset)
        return np.asarray(tip), np.asarray(passes)

    return call, depth


def _evaluate_layers(tissue: Tissue) -> list[EvaluatedLaw]:
    return [evaluate_layer(tissue, layer, np.zeros(1)) for layer in range(tissue.layers)]


def _newton(u, c, series, inside, rigidity, span):
    """Return the deflections and slopes (E + 1, 2) after one pass."""
    ends = jnp.concatenate((u[:-1], u[1:]), axis=1)  # (E, 4)
    at = ends @ _N.T  # (E, 4)
    e = at - jnp.stack((c[:-1], c[:-1], c[1:], c[1:]), axis=1)
    size = jnp.abs(e)
    k = slope = jnp.zeros_like(e)
    for j in range(series.shape[1] - 1, -1, -1):
        slope = slope * size + k
        k = k * size + series[:, j : j + 1]
    tangent = k + size * slope
    stiffness = _WEIGHT * jnp.einsum("eq,qi,qj->eij", tangent, _N, _N) + rigidity * _BENDING
    load = _WEIGHT * (tangent * at - k * e) @ _N
    stiffness = jnp.where(inside[:, None, None], stiffness, jnp.diag(jnp.array([0.0, 0.0, 1.0, 1.0])))
    load = jnp.where(inside[:, None], load, 0.0)
    f = rigidity / span**3
    entry = jnp.array([[12 * f, -6 * f * span], [-6 * f * span, 4 * f * span**2]])

    def forward(carry, element):
        s, r = carry
        k, f = element
        inverse = _inverse(s + k[:2, :2])
        g, z = inverse @ k[:2, 2:], inverse @ (r + f[:2])
        return (k[2:, 2:] - k[2:, :2] @ g, f[2:] - k[2:, :2] @ z), (g, z)

    def backward(after, row):
        g, z = row
        now = z - g @ after
        return now, now

    (s, r), rows = lax.scan(forward, (entry, jnp.zeros(2)), (stiffness, load))
    last = _inverse(s) @ r
    _, before = lax.scan(backward, last, rows, reverse=True)
    return jnp.concatenate((before, last[None]))


def _inverse(s):
    a, b, d = s[0, 0], s[0, 1], s[1, 1]
    return jnp.array([[d, -b], [-b, a]]) / (a * d - b * b)
