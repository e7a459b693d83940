"""A random walk of every walker, as wide as the draws by importance (Metropolis)."""

import numpy as np

from needlefit.inference.sampling.samplers import Sampler


def walk(log_density, start, begin, rng):
    """Yield one step after another."""
    thetas, density = start
    spread = 2.4 * begin.thetas.std(axis=0) / np.sqrt(thetas.shape[1])
    while True:
        proposed = thetas + spread * rng.standard_normal(thetas.shape)
        values = log_density(proposed)
        accepted = np.log(rng.uniform(size=len(density))) < values - density
        thetas = np.where(accepted[:, None], proposed, thetas)
        density = np.where(accepted, values, density)
        yield thetas, density


RANDOM_WALK = Sampler("random_walk", walk)
