"""Needles with known truth, for scripts: datasets that another model than the fitted one generates.

`make_twin` makes the synthetic dataset of the paper's 47 insertions, `straight.simulate_dataset` needles in
one layer. The package `needlefit` knows none of it.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from synthetic.build import build_dataset
from synthetic.design import POPULATION, list_designs, select_designs
from synthetic.insertion import TWIN_SEED, needle_points, simulate_insertion
from synthetic.truth import find_truth as find_truth


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
    return read(build_dataset(Path(folder), seed, plan, population=POPULATION if population else None))


def simulate_twin_needle(name: str, from_tip: ArrayLike) -> Floats:
    """Return the points (N, 3) of a true needle of the shipped twin, world, mm: without any error.

    `name`: an insertion of the dataset `twin`, such as "phantom2-01"; `from_tip` (N,): arc lengths from the
    tip, mm. ConfigError if there is no such insertion.
    """
    (planned,) = select_designs([name])
    simulated = simulate_insertion(planned, TWIN_SEED)
    shape, frame = simulated.true_insertion.shape, simulated.true_insertion.frame
    s = shape.depth - np.asarray(from_tip, dtype=np.float64)
    return needle_points(shape, frame, simulated.deviations, s)
