"""NIST's nonlinear regression problems by every search algorithm, through the shells that fit needles.

    python benchmarks/nist.py [--algorithms leastsquares slsqp ...] [--levels lower] [--evaluations 20000]

Digits of the worst parameter that agree with the certified ones (11 at most), by set, start and algorithm. A
bracket marks an end that the search itself calls no success, an exclamation mark a miss that it calls one: an
end with neither six digits nor a sum of squares within 1e-6 of the certified one. Least squares searches
without bounds and on all levels; the others in a box of ten times the larger start on each side of 0.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from nist_cases import LEVELS, Regression, attained, ended, regressions

from needlefit.inference.optimize import ALGORITHMS

DIGITS = 6


def cell(one: Regression, start: int, algorithm: str, evaluations: int) -> tuple[str, dict[str, bool]]:
    """Return what is printed of one search, and what is counted."""
    end = ended(one, start, algorithm, np.inf if algorithm == "leastsquares" else 10.0, evaluations)
    digits, hit = max(0.0, one.digits(end.theta)), attained(one, end)
    shown = f"{digits:.1f}" if end.succeeded else f"[{digits:.1f}]"
    counts = {
        "hit": hit,
        "six": digits >= DIGITS,
        "success": end.succeeded,
        "false": end.succeeded and not hit,
    }
    return shown + ("!" if counts["false"] else ""), counts


def main() -> None:
    """Search, print the table as it grows, then the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithms", nargs="+", default=list(ALGORITHMS))
    parser.add_argument("--levels", nargs="+", default=["lower", "average"])
    parser.add_argument("--evaluations", type=int, default=20_000)
    options = parser.parse_args()
    counted: dict[str, list[dict[str, bool]]] = {name: [] for name in options.algorithms}
    print("| level | set | start | " + " | ".join(options.algorithms) + " |", flush=True)
    print("|" + "---|" * (3 + len(options.algorithms)))
    for one in regressions().values():
        for start in (0, 1):
            cells = []
            for name in options.algorithms:
                # least squares is asked for on every level, the others up to the given ones
                if one.level in (options.levels if name != "leastsquares" else LEVELS):
                    text, counts = cell(one, start, name, options.evaluations)
                    counted[name].append(counts)
                    cells.append(text)
                else:
                    cells.append("")
            if any(cells):
                print(f"| {one.level} | {one.name} | {start + 1} | {' | '.join(cells)} |", flush=True)
    for name, rows in counted.items():
        six, hit, success, false = (sum(row[k] for row in rows) for k in ("six", "hit", "success", "false"))
        ends = f"{hit} of {len(rows)} hits, {six} to six digits"
        print(f"{name}: {ends}, {success} called a success, {false} of them misses")


if __name__ == "__main__":
    main()
