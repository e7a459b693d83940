"""What a posterior of tip tracks says of each parameter, beside what was known before."""

import math
from collections.abc import Iterator

import numpy as np

from needlefit.inference.identifiability.agreement import is_small
from needlefit.inference.parameters import in_logarithm
from needlefit.inference.sampling.posterior import PERCENTILES, Posterior
from needlefit.inference.tracks.problem import TrackProblem
from needlefit.validation.score import Row


def learned(fit: str, problem: TrackProblem, posterior: Posterior) -> Iterator[Row]:
    """Yield a row per free parameter: percentiles (Pa, mm), and how far the runs narrowed it."""
    percentiles, flat = posterior.percentiles(), posterior.draws.reshape(-1, len(posterior.names))
    widths = dict(zip(problem.names, problem.upper - problem.lower, strict=True))
    for k, name in enumerate(posterior.names):
        drawn = np.log(flat[:, k]) if in_logarithm(name) else flat[:, k]
        sd, stated = float(np.std(drawn)), problem.parameters.prior.sd(name)
        before = stated if math.isfinite(stated) else float(widths[name]) / math.sqrt(12)
        heads = (f"p{at:g}".replace(".", "_") for at in PERCENTILES)
        row: Row = {"fit": fit, "parameter": name, **dict(zip(heads, percentiles[name], strict=True))}
        yield row | {"contraction": sd / before, "determined": is_small(name, sd, before)}
