"""Compression tests written from the closed form, so their mu and alpha are known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from needlefit.datasets.compression import SpecimenLoading
from needlefit.mechanics.compression import compute_stress

MU = 0.012  # MPa


def specimen(
    alpha: float,
    low: float = 0.75,
    noise: float = 0.0,
    seed: int = 1,
    measure: str = "nominal",
    count: int = 60,
):
    """A loading to the stretch `low`; `noise` is independent, a part of the largest stress."""
    stretch = np.linspace(1.0, low, count)
    exact = compute_stress(MU, alpha, stretch, measure)
    error = noise * np.abs(exact).max() * np.random.default_rng(seed).normal(size=count)
    return SpecimenLoading("gel", stretch, exact + error)


def write(path: Path, header: str, rows: Sequence[Sequence[object]]) -> Path:
    lines = [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


def gel_file(path: Path, alphas: Sequence[float] = (-4.0, -5.0, -4.5), low: float = 0.8) -> Path:
    """One specimen per alpha, stresses positive in compression, noise of 0.2 %."""
    rows = []
    for k, alpha in enumerate(alphas):
        one = specimen(alpha, low, 0.002, seed=k)
        rows += [
            (f"gel{k + 1}", f"{x:.6f}", f"{-1e3 * y:.6f}")
            for x, y in zip(one.stretch, one.stress, strict=True)
        ]
    return write(path, "sample,stretch,nominal_stress_kpa", rows)
