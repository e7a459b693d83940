"""All compiled functions of the kernel, and a needle that goes through all of its parts."""

import importlib
import pkgutil
from collections.abc import Iterator

import numpy as np
from numba.core.dispatcher import Dispatcher

from needlefit.mechanics import kernel
from needlefit.mechanics.batch import Batch, compute_batch_positions
from needlefit.mechanics.control import Bevel, Step
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.linearize import differentiate_positions, linearize
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue

NEEDLE, BEVEL, DEPTH = Needle.from_tube(50.0, 1.27, 80e3), Bevel(0.03), 4.0


def kernel_functions() -> Iterator[Dispatcher]:
    for found in pkgutil.walk_packages(kernel.__path__, f"{kernel.__name__}."):
        for value in vars(importlib.import_module(found.name)).values():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == found.name:
                yield value


def run_kernel():
    """Simulate a needle by every part of the kernel; what is not compiled yet is compiled."""
    tissue, s = Tissue(mu=np.array([0.2]), alpha=np.array([1.0])), np.array([0.0, DEPTH])
    assert np.isfinite(simulate(NEEDLE, tissue, BEVEL, DEPTH).tip_lateral)
    batch = Batch(NEEDLE, tissue, (Step(DEPTH, BEVEL),), mu=np.full((2, 1), 0.2))
    for shapes in simulate_batches([batch], 1):
        compute_batch_positions(shapes, s)
    shape, jacobian = linearize(NEEDLE, tissue, BEVEL, DEPTH)
    differentiate_positions(shape, jacobian, s)
