"""The 95 % band of the needle under the posterior draws of a fit.

As in `validation/needles_in_scan.py`: the central 95 % of needles simulated with posterior draws of the
parameters and with the user's inputs. It includes neither the noise of measured points, nor errors of the
layers' depths, nor model error.
"""

from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.parameter_draws import ParameterDraws
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.studies.needles_in_scan import BAND_PERCENTILES, NEEDLE_POINTS

MAX_BAND_DRAWS = 100
"""Needles of a band, evenly chosen from all draws: it is computed again whenever the needle moves."""


@dataclass(frozen=True)
class NeedleBand:
    """The band that contains the central 95 % of the drawn needles, from entry to tip, in C.

    Attributes
    ----------
    x : (K,) array
        Depth along the entry axis, median over the needles, mm.
    low, high : (K,) arrays
        Of y, mm.
    failed : int
        Draws whose needle was not found; they are left out.
    """

    x: Floats
    low: Floats
    high: Floats
    failed: int


def compute_band(
    spread: ParameterDraws,
    needle: Needle,
    tissue: Tissue,
    steps: tuple[Step, ...],
    rules: ModelOptions,
    first_cell: float,
) -> NeedleBand | None:
    """Return the band of a needle after `steps`; None if it has no width.

    Every draw replaces moduli and shape parameters of all layers and the strength of the bevel of all steps;
    the layers stay where they are, guides and base where the user holds them. Runs on one core, and lets the
    interpreter go.

    Parameters
    ----------
    steps : tuple of Step
        The shortest that lead to where the needle stands: `Session.input_path`.
    first_cell : float
        Of the session, mm.

    Returns
    -------
    NeedleBand or None
        None before the tip is in, and where no draw can be solved.
    """
    depth = steps[-1].depth
    if not depth > 0:
        return None
    chosen = np.linspace(0, len(spread) - 1, min(MAX_BAND_DRAWS, len(spread))).astype(np.intp)
    batch = spread.only(chosen).make_batch(needle, tissue, steps, replace(rules, first_cell=first_cell))
    # One thread: the other cores are left to the needles that users control at the same time.
    (shapes,) = simulate_batches([batch], threads=1)
    found = compute_batch_positions(shapes, np.linspace(0.0, depth, NEEDLE_POINTS))[
        shapes.converged
    ]  # (B, K, 2)
    if not len(found):
        return None
    low, _, high = np.percentile(found[:, :, 1], BAND_PERCENTILES, axis=0)
    return NeedleBand(np.median(found[:, :, 0], axis=0), low, high, len(shapes) - len(found))
