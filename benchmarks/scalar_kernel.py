"""Time per step of the compiled scalar kernel against a banded and a dense solution of the same model.

All three solve the same insertion (150 mm needle, four layers, 1 mm elements and constraint points)
with the same split quadrature, exact Ogden law or its series, and Newton to the same increment, in one
process on one thread, in turns; medians of the rounds are printed, and their ratios.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/scalar_kernel.py [--json] [--rounds N]

Times are processor time of the thread. `kernel` is the compiled insertion alone, `simulate` the public
function around it (nouns, grid and result included); the ratios are to `kernel`.

The rivals mesh the whole needle with 150 elements, as the paper does: `banded` assembles with vectorised
NumPy and solves with `scipy.linalg.solveh_banded`; `dense` assembles element by element into a full matrix.
"""

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
from scipy.linalg import solveh_banded

from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Rules
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

DEPTH = 55.0
TOLERANCE = 1e-9
NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
TISSUE = Tissue(
    mu=np.array([0.2, 33.0, 0.2, 33.0]),
    alpha=np.array([1.0, -1.0, 1.0, -1.0]),
    boundaries=np.array([20.0, 28.0, 45.0]),
)
BEVEL = Bevel(0.085)
TURN = BEVEL.side * BEVEL.offset / 1.0  # of the cut, per constraint spacing of 1 mm


class FullNeedle:
    """The model on 150 elements of the whole needle; `solve` is told how to assemble and solve."""

    def __init__(self) -> None:
        self.x_c = np.arange(DEPTH + 1.0)
        entry_to_tip = np.arange(0.0, DEPTH + 1.0)
        x, self.w = reference.quadrature(entry_to_tip, self.x_c, TISSUE.boundaries)
        self.element = np.searchsorted(entry_to_tip, x) - 1  # from the entry
        self.layer = np.searchsorted(TISSUE.boundaries, x)
        self.nearest = np.argmin(np.abs(x[:, None] - self.x_c), axis=1)
        s = x - entry_to_tip[self.element]
        self.N = np.stack(
            [1 - 3 * s**2 + 2 * s**3, s * (1 - s) ** 2, 3 * s**2 - 2 * s**3, s**2 * (s - 1)], axis=1
        )
        self.NN = self.N[:, :, None] * self.N[:, None, :]  # (Q, 4, 4)
        self.nodes = round(NEEDLE.length) + 1
        EI = NEEDLE.flexural_rigidity  # noqa: N806
        self.k_element = EI * np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
        local = np.arange(4)
        upper = local[:, None] <= local[None, :]
        self.rows, self.columns = np.nonzero(upper)
        self.diagonal = 3 - (self.columns - self.rows)  # row of solveh_banded's upper form
        self.bending = np.zeros((4, 2 * self.nodes))
        for e in range(self.nodes - 1):
            self.bending[self.diagonal, 2 * e + self.columns] += self.k_element[self.rows, self.columns]

    def insertion(self, step: Callable[..., np.ndarray]) -> float:
        """Insert to DEPTH; return the tip's deflection."""
        c = np.zeros(len(self.x_c))
        u = np.zeros(2 * self.nodes)
        for m in range(1, len(self.x_c)):
            c[m] = u[-2] + u[-1] + BEVEL.offset
            u = np.concatenate([u[2:], [u[-2] + u[-1], u[-1]]])  # nodes stay in the tissue, the base moves on
            u[:2] = 0.0
            points = int(np.searchsorted(self.element, m))  # those above the tip
            for _ in range(40):
                new = step(u, c, points, self.nodes - 1 - m)
                change = np.max(np.abs(new[0::2] - u[0::2]))
                u = new
                if change < TOLERANCE:
                    break
        return float(u[-2])

    def reaction(self, u: np.ndarray, c: np.ndarray, q: slice, dofs: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return u, k e and d(k e)/de at quadrature points."""
        at = np.einsum("qi,qi->q", self.N[q], u[dofs])
        e = at - c[self.nearest[q]]
        layer, t = self.layer[q], TISSUE.thickness[0]
        lam = 1.0 - np.abs(e) / t
        k, dk = reference.modulus(TISSUE, layer, lam)
        return at, k * e, k - np.abs(e) / t * dk

    def banded(self, u: np.ndarray, c: np.ndarray, points: int, first: int) -> np.ndarray:
        """One Newton iteration: vectorised assembly into bands, solveh_banded."""
        q = slice(0, points)
        start = 2 * (first + self.element[q])
        dofs = start[:, None] + np.arange(4)
        at, force, tangent = self.reaction(u, c, q, dofs)
        bands, load = self.bending.copy(), np.zeros(2 * self.nodes)
        weighted = (self.w[q] * tangent)[:, None] * self.NN[q][:, self.rows, self.columns]
        flat = self.diagonal * 2 * self.nodes + start[:, None] + self.columns
        bands += np.bincount(flat.ravel(), weighted.ravel(), 8 * self.nodes).reshape(4, -1)
        residual = (self.w[q] * (tangent * at - force))[:, None] * self.N[q]
        load += np.bincount(dofs.ravel(), residual.ravel(), 2 * self.nodes)
        return np.concatenate([[0.0, 0.0], solveh_banded(bands[:, 2:], load[2:], check_finite=False)])

    def dense(self, u: np.ndarray, c: np.ndarray, points: int, first: int) -> np.ndarray:
        """One Newton iteration: element by element into a full matrix, np.linalg.solve."""
        K, load = np.zeros((2 * self.nodes, 2 * self.nodes)), np.zeros(2 * self.nodes)  # noqa: N806
        for e in range(self.nodes - 1):
            K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += self.k_element
        for i in range(points):
            q = slice(i, i + 1)
            dofs = 2 * (first + self.element[q])[:, None] + np.arange(4)
            at, force, tangent = self.reaction(u, c, q, dofs)
            K[np.ix_(dofs[0], dofs[0])] += self.w[i] * tangent[0] * self.NN[i]
            load[dofs[0]] += self.w[i] * (tangent * at - force)[0] * self.N[i]
        return np.concatenate([[0.0, 0.0], np.linalg.solve(K[2:, 2:], load[2:])])


def measure(rounds: int) -> dict[str, float]:
    """Return microseconds per step of each, their ratios to the kernel, and how far the tips differ."""
    full = FullNeedle()
    rivals: dict[str, tuple[int, Callable[[], object]]] = {
        "kernel": (300, lambda: simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=Rules(tolerance=TOLERANCE))),
        "banded": (5, lambda: full.insertion(full.banded)),
        "dense": (1, lambda: full.insertion(full.dense)),
    }
    shape = simulate(NEEDLE, TISSUE, BEVEL, DEPTH, rules=Rules(tolerance=TOLERANCE))
    tip = shape.deflection
    figures = {"tip_mm": tip, "banded_differs_mm": abs(full.insertion(full.banded) - tip)}
    figures["dense_differs_mm"] = abs(full.insertion(full.dense) - tip)
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(rounds):
        for name, (repeats, call) in rivals.items():
            call()
            begin = time.thread_time()  # this thread's own: a busy machine stretches the clock on the wall
            for _ in range(repeats):
                call()
            seconds[name].append((time.thread_time() - begin) / repeats)
    for name, values in seconds.items():
        figures[f"{name}_us_per_step"] = float(np.median(values)) / DEPTH * 1e6
    for name in ("banded", "dense"):
        figures[f"{name}_over_kernel"] = figures[f"{name}_us_per_step"] / figures["kernel_us_per_step"]
    figures["newton_iterations_per_step"] = shape.iterations / DEPTH
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    figures = measure(arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for name, value in figures.items():
        print(f"{name:28s} {value:12.4g}")


if __name__ == "__main__":
    main()
