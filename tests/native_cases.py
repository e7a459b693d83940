"""Problems of the native kernel for tests: made, changed, computed."""

from mechanics_cases import RULES, random_batch, random_case
from space_cases import random_spatial_case

from needlefit.mechanics import native
from needlefit.mechanics.batch import DERIVATIVE_KINDS, _evaluate, find_columns
from needlefit.mechanics.packing import INPUTS_ALONG_Z, pack_insertion, pack_problem


def make_problem(rng):
    """Return a random insertion with all derivatives, in the plane or in space, or several sets of one."""
    kind = str(rng.choice(RULES))
    if rng.random() < 0.5:
        batch = random_batch(rng, int(rng.integers(2, 12)), within=True, friction=0.3, kind=kind)
        return _evaluate(batch, None, tracked=True).problem
    draw = random_spatial_case if rng.random() < 0.5 else random_case
    needle, tissue, steps, rules, _ = draw(rng, kind, int(rng.integers(0, 4)), 22.0)
    lattice, packed = pack_insertion(steps, needle.length, rules)
    columns = find_columns((*DERIVATIVE_KINDS, *INPUTS_ALONG_Z), tissue, steps, rules)
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
