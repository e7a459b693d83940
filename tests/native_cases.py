"""Problems of the native kernel for tests: made, changed, computed."""

from mechanics_cases import random_batch, random_needle, random_rules, random_steps, random_tissue

from needlefit.mechanics import native
from needlefit.mechanics.batch import DERIVATIVE_KINDS, _evaluate, find_columns
from needlefit.mechanics.packing import INPUTS_ALONG_Z, pack_insertion, pack_problem


def make_problem(rng):
    """Return a random insertion with all derivatives, or one with several parameter sets."""
    if rng.random() < 0.5:
        batch = random_batch(rng, int(rng.integers(2, 12)), within=True, friction=0.3)
        return _evaluate(batch, None, tracked=True).problem
    rules = random_rules(rng)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, rng.choice([0.0, 0.3]))
    steps = random_steps(rng, int(rng.integers(0, 4)))
    lattice, packed = pack_insertion(steps, needle.length, rules)
    kinds = (*DERIVATIVE_KINDS, *INPUTS_ALONG_Z) if rng.random() < 0.5 else DERIVATIVE_KINDS
    columns = find_columns(kinds, tissue, steps, rules)
    return pack_problem(needle, tissue, steps, lattice, rules, packed, columns=columns)


def read_numbers(problem):
    """Return the sizes and numbers of a problem."""
    return {name: getattr(problem, name) for name in (*native._SIZES, *native._NUMBERS)}


def compute(problem, lanes=None):
    """Return the shapes, and their derivatives if the problem has some, of all sets."""
    points = int(problem.arrays["stops"]["cell"][problem.stop_count - 1]) + 1
    shapes, lanes = native.make_shapes(problem, points), lanes or native.count_lanes()
    for array in shapes.arrays.values():
        array.fill(0)  # beyond the last node nothing is written
    for first in range(0, problem.sets, lanes):
        native.simulate(problem, shapes, first, lanes)
    return shapes.arrays


def to_bytes(arrays):
    """Return the bytes of arrays, which tell one NaN from another."""
    return {name: array.tobytes() for name, array in arrays.items()}
