"""The synthetic dataset: 47 insertions with known truth, by another model than the fitted one.

What is shipped as `data/twin` was also rendered and reconstructed as scans, by `benchmarks/scanner/twin.py`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from needlefit.api import load_dataset
from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset
from needlefit.errors import ConfigError
from needlefit.inference.problem import Problem
from synthetic.build import build_dataset
from synthetic.design import (
    POPULATION,
    bevel_offset,
    draw_deviations,
    draw_specimen,
    list_designs,
    select_designs,
)
from synthetic.insertion import TWIN_SEED, needle_points, simulate_insertion


def make_twin(
    folder: str | Path, seed: int, media: Sequence[str] = (), *, population: bool = False
) -> Dataset:
    """Write the synthetic dataset of another seed to `folder`, and return it.

    It is measured as a scan would, but not rendered: a second for two insertions.

    Parameters
    ----------
    folder : str or Path
        A new folder for its files.
    seed : int
        Of specimens, bevels and errors of measurement; the plan of the 47 insertions is the same.
    media : sequence of str
        Insertions into these media only, such as `["chicken"]`.
    population : bool
        Whether the tissues, too, are drawn, from a wide population, instead of the paper's values.

    Raises
    ------
    ConfigError
        If there is no insertion into such a medium.
    """
    plan = [design for design in list_designs() if not media or design.medium in media]
    if missing := set(media) - {design.medium for design in plan}:
        raise ConfigError(f"the twin has no insertions into {', '.join(sorted(missing))}")
    return load_dataset(
        build_dataset(Path(folder), seed, plan, population=POPULATION if population else None)
    )


def find_twin_truth(problem: Problem, seed: int) -> dict[str, float]:
    """Return the true moduli (Pa) and b (mm) of the insertions of a problem in a dataset of `make_twin`.

    They are geometric means over the specimens, layers and bevels that a fit learns from. What the truth has
    not is left out: hyperparameters, and exponents.

    Parameters
    ----------
    problem : Problem
        Of insertions of the synthetic dataset, such as `make_problem("study1")`.
    seed : int
        That of `make_twin(..., population=True)`.
    """
    planned = {design.id: design for design in list_designs()}
    fitted = [planned[insertion.id] for insertion in problem.insertions]
    specimens = [draw_specimen(seed, design.medium, design.specimen, POPULATION) for design in fitted]
    pairs = zip(specimens, fitted, strict=True)
    true = {"bevel_mm": [bevel_offset(made, design, draw_deviations(seed, design)) for made, design in pairs]}
    for name in (name for name in problem.parameters.names if name.startswith("mu")):
        tied = [other for other, (_, source) in problem.parameters.ties.items() if source == name]
        layers = [int(other.removeprefix("mu").removesuffix("_pa")) - 1 for other in (name, *tied)]
        true[name] = [1e6 * made.mu[n] for made in specimens for n in layers if n < len(made.mu)]
    return {name: float(np.exp(np.mean(np.log(values)))) for name, values in true.items() if values}


def simulate_twin_needle(name: str, from_tip: ArrayLike) -> Floats:
    """Return the points (N, 3) of a true needle of the shipped twin, world, mm: without any error.

    Parameters
    ----------
    name : str
        An insertion of the dataset `twin`, such as "phantom2-01".
    from_tip : (N,) array_like
        Arc lengths from the tip, mm.

    Raises
    ------
    ConfigError
        If there is no such insertion.
    """
    (planned,) = select_designs([name])
    made = simulate_insertion(planned, TWIN_SEED)
    shape, frame = made.true_insertion.shape, made.true_insertion.frame
    return needle_points(shape, frame, made.deviations, shape.depth - np.asarray(from_tip, dtype=np.float64))
