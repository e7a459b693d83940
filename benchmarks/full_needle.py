"""The model as one would write it with NumPy and SciPy: 150 elements of the whole needle, as in the paper.

`banded` assembles with vectorised NumPy and solves with `scipy.linalg.solveh_banded`; `dense` assembles
element by element into a full matrix. Both take the exact law and the package's quadrature, and stop
Newton by the package's rule.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from needlefit.mechanics import reference
from needlefit.mechanics.control import Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import compile_law, evaluate_layer
from needlefit.mechanics.tissue import Tissue

Floats = NDArray[np.float64]


class FullNeedle:
    """One insertion on elements of 1 mm; `insertion` is told how to assemble and solve.

    Attributes
    ----------
    passes : int
        Newton passes of the last insertion.
    """

    def __init__(self, needle: Needle, tissue: Tissue, step: Step, tolerance: float) -> None:
        self.offset, self.tolerance, self.passes = step.bevel.offset, tolerance, 0
        self.x_c = np.arange(step.depth + 1.0)
        halfway = (self.x_c[1:] + self.x_c[:-1]) / 2  # where the nearest constraint point changes
        x, self.w = reference.quadrature(self.x_c, halfway, tissue.boundaries)
        self.element = np.searchsorted(self.x_c, x) - 1  # from the entry
        self.nearest = np.argmin(np.abs(x[:, None] - self.x_c), axis=1)
        s = x - self.x_c[self.element]
        self.N = np.stack(
            [1 - 3 * s**2 + 2 * s**3, s * (1 - s) ** 2, 3 * s**2 - 2 * s**3, s**2 * (s - 1)], axis=1
        )
        self._read_law(tissue, np.searchsorted(tissue.boundaries, x))
        self.nodes = round(needle.length) + 1
        k_element = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4.0]])
        self.k_element = needle.flexural_rigidity * k_element
        rows, columns = np.triu_indices(4)
        self.NN = self.N[:, rows] * self.N[:, columns]  # (Q, 10)
        diagonal = 3 - (columns - rows)  # row of solveh_banded's upper form
        self.bending = np.zeros((4, 2 * self.nodes))
        for e in range(self.nodes - 1):
            self.bending[diagonal, 2 * e + columns] += self.k_element[rows, columns]
        self.places = diagonal * 2 * self.nodes + 2 * self.element[:, None] + columns  # (Q, 10) in the bands

    def _read_law(self, tissue: Tissue, layer: NDArray[np.int64]) -> None:
        coefficients, self.powers = (part[layer] for part in compile_law(tissue.law, tissue.shape))
        self.stiffness = tissue.mu[layer, None] * coefficients  # (Q, P)
        self.thickness = tissue.thickness[layer]
        rest = np.zeros(1)
        self.curvature = max(evaluate_layer(tissue, i, rest).curvature for i in range(tissue.layers))

    def insertion(self, step: Callable[..., Floats]) -> float:
        """Insert to the whole depth; return the tip's deflection."""
        c = np.zeros(len(self.x_c))
        u = np.zeros(2 * self.nodes)
        self.passes = 0
        for m in range(1, len(self.x_c)):
            c[m] = u[-2] + u[-1] + self.offset
            u = np.concatenate([u[2:], [u[-2] + u[-1], u[-1]]])  # nodes stay in the tissue, the base moves on
            u[:2] = 0.0
            points = int(np.searchsorted(self.element, m))  # those above the tip
            for _ in range(40):
                new = step(u, c, points, self.nodes - 1 - m)
                change = np.max(np.abs(new[0::2] - u[0::2]))
                u = new
                self.passes += 1
                if min(change, self.curvature * change**2) < self.tolerance:
                    break
        return float(u[-2])

    def reaction(self, at: Floats, c: Floats, q: slice) -> tuple[Floats, Floats]:
        """Return k e and d(k e)/de at quadrature points that stand at `at`."""
        e = at - c[self.nearest[q]]
        d = np.abs(e) / self.thickness[q]
        parts = self.stiffness[q] * (1.0 - d[:, None]) ** self.powers[q]
        k = parts.sum(axis=1)
        return k * e, k - d / (1.0 - d) * (self.powers[q] * parts).sum(axis=1)

    def banded(self, u: Floats, c: Floats, points: int, first: int) -> Floats:
        """One Newton pass: vectorised assembly into bands, solveh_banded."""
        q = slice(0, points)
        dofs = 2 * (first + self.element[q, None]) + np.arange(4)
        at = np.einsum("qi,qi->q", self.N[q], u[dofs])
        force, tangent = self.reaction(at, c, q)
        weighted = (self.w[q] * tangent)[:, None] * self.NN[q]
        flat = self.places[q] + 2 * first
        bands = self.bending + np.bincount(flat.ravel(), weighted.ravel(), 8 * self.nodes).reshape(4, -1)
        residual = (self.w[q] * (tangent * at - force))[:, None] * self.N[q]
        load = np.bincount(dofs.ravel(), residual.ravel(), 2 * self.nodes)
        solved = solveh_banded(
            bands[:, 2:], load[2:], check_finite=False, overwrite_ab=True, overwrite_b=True
        )
        return np.concatenate([[0.0, 0.0], solved])

    def dense(self, u: Floats, c: Floats, points: int, first: int) -> Floats:
        """One Newton pass: element by element into a full matrix, np.linalg.solve."""
        K, load = np.zeros((2 * self.nodes, 2 * self.nodes)), np.zeros(2 * self.nodes)  # noqa: N806
        for e in range(self.nodes - 1):
            K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += self.k_element
        for i in range(points):
            dofs = 2 * (first + self.element[i]) + np.arange(4)
            at = self.N[i] @ u[dofs]
            force, tangent = self.reaction(np.array([at]), c, slice(i, i + 1))
            K[np.ix_(dofs, dofs)] += self.w[i] * tangent[0] * np.outer(self.N[i], self.N[i])
            load[dofs] += self.w[i] * (tangent[0] * at - force[0]) * self.N[i]
        return np.concatenate([[0.0, 0.0], np.linalg.solve(K[2:, 2:], load[2:])])
