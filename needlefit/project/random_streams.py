"""Random number generators, keyed by purpose, so that results do not depend on the order of work."""

import hashlib

import numpy as np


def random_stream(seed: int, *keys: str | int) -> np.random.Generator:
    """Return the generator of one purpose, e.g. `random_stream(seed, "study3", "fold 1", "starts")`."""
    words = [int.from_bytes(hashlib.sha256(str(key).encode()).digest()[:8], "little") for key in keys]
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))
