"""Compare the needles of all draws at once with single simulations, in the predictions of studies.

    python benchmarks/planned_draws.py study2 study3

Each study is run once; every `--every`-th of its predicted needles is then simulated again, draw by draw. A
row has the time of both, and in mm: the root mean square difference of the tips, the largest one, those of
the ends of the central 95 % of the tips, and the distance of these ends.
"""

import argparse
import tempfile
import time
from unittest.mock import patch

import numpy as np

from needlefit.api import validate
from needlefit.studies import held_out_predictions, planned_draws

COLUMNS = ("needle", "together s", "alone s", "ratio", "rms", "largest", "low end", "high end", "width")


def record_predictions(study: str) -> list[tuple]:
    """Return the arguments of every prediction of a study."""
    calls, simulate = [], planned_draws.simulate_planned

    def record(*arguments):
        calls.append(arguments)
        return simulate(*arguments)

    with patch.object(held_out_predictions, "simulate_planned", record), tempfile.TemporaryDirectory() as to:
        validate(study, out=to, jobs=1)
    return calls


def compare(call: tuple) -> list[float]:
    """Return the figures of one prediction, in the order of `COLUMNS`."""
    begin = time.process_time()
    together = planned_draws.simulate_planned(*call)
    middle = time.process_time()
    alone = planned_draws._simulate_each(*call[:6])
    end = time.process_time()
    solved = together.solved & alone.solved
    tips, exact = together.points[solved, -1, 1], alone.points[solved, -1, 1]
    (low, high), (exact_low, exact_high) = (np.quantile(some, [0.025, 0.975]) for some in (tips, exact))
    off, first, second = tips - exact, middle - begin, end - middle
    rms, largest = np.sqrt(np.mean(off**2)), np.abs(off).max()
    return [
        first,
        second,
        second / first,
        rms,
        largest,
        low - exact_low,
        high - exact_high,
        exact_high - exact_low,
    ]


def main() -> None:
    """Print a row for each needle that is simulated again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="+")
    parser.add_argument("--every", type=int, default=3)
    options = parser.parse_args()
    print("".join(f"{name:>12s}" for name in COLUMNS))
    for study in options.studies:
        for n, call in enumerate(record_predictions(study)[:: options.every]):
            figures = "".join(f"{value:12.3g}" for value in compare(call))
            print(f"{study + ' ' + str(n * options.every):>12s}{figures}", flush=True)


if __name__ == "__main__":
    main()
