"""How far the solver is from solutions by other means: the table of docs/developers/solver.md.

    python benchmarks/verification.py [--cases 40] [--seed 1]

Each row is the largest error found, or the range of the observed orders. The measures and the named cases
are those of `tests/solver_checks` and `collocation.py`; `--cases` random ones are drawn for each of the
last rows. Random insertions have one to four layers of any law, mu from 1 kPa to 100 MPa and t from 5 to
80 mm; where kernel and derivatives are compared they also have guides, tracked tips, friction, turns of
the bevel and retractions.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import reference_solver
from collocation import COLLOCATED, measure_difference
from mechanics_cases import random_case
from needle_loads import compute_loads
from solver_checks.beams import FOUNDED, LOADED
from solver_checks.clamped import MANUFACTURED, measure_orders
from solver_checks.refinement import (
    ADVANCED,
    PHANTOM2,
    measure_random_meshes,
    measure_shipped_meshes,
    measure_spacing,
)

from needlefit.mechanics.batch import linearize_steps
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.plan import make_lattice
from needlefit.mechanics.simulate import simulate_steps

Row = tuple[str, str, str]
WRT = ("mu", "shape", "friction", "offset", "rigidity", "base_y", "base_slope", "boundaries", "guides")


def measure_reference(rng: np.random.Generator) -> float:
    """Return the largest difference of deflection between kernel and reference, mm, in a random schedule."""
    case = random_case(rng)
    return float(np.max(np.abs(simulate_steps(*case).u - reference_solver.simulate_steps(*case).u)))


def measure_balance(rng: np.random.Generator) -> float:
    """Return the sum of all forces over the sum of their sizes, in a random schedule."""
    needle, tissue, steps, rules, lattice = random_case(rng)
    shape = simulate_steps(needle, tissue, steps, rules, lattice)
    loads = compute_loads(shape, tissue, needle, steps[-1].controls, rules)
    forces = [one.force for one in (loads.tissue, loads.base, *loads.guides, loads.tip)]
    return float(abs(sum(forces)) / np.sum(np.abs(forces)))


def measure_jacobian(rng: np.random.Generator) -> tuple[float, float]:
    """Return the largest error of a column over its largest entry: shape parameters, and the others.

    Columns below 1e-3 mm per unit (per logarithm of mu and EI) are compared with that.
    """
    needle, tissue, steps, rules, lattice = random_case(rng, count=1, deepest=14.0)
    # in soft tissue on a fine mesh the state is not known well enough to compare its derivative
    rules = replace(rules, tolerance=1e-11, element=max(rules.element, 0.5))
    tissue = replace(tissue, mu=np.maximum(tissue.mu, 0.03))
    lattice = lattice or make_lattice(steps, rules)
    _, found = linearize_steps(needle, tissue, steps, rules, lattice, wrt=WRT)
    errors = {True: [0.0], False: [0.0]}
    for p, name in enumerate(found.names):
        _, u, *_ = reference_solver.differentiate(needle, tissue, steps, rules, name, lattice)
        unit = tissue.mu[int(name[2:]) - 1] if name.startswith("mu") else 1.0
        unit = needle.flexural_rigidity if name == "rigidity" else unit
        size = max(np.max(np.abs(u)), 1e-3 / unit)
        of_shape = name.rstrip("0123456789") in LAWS[tissue.law].shape_names
        errors[of_shape].append(float(np.max(np.abs(found.u[..., p] - u)) / size))
    return max(errors[True]), max(errors[False])


def show(error: float) -> str:
    """Return an error with two digits."""
    return f"{error:.1e}".replace("e-0", "e-")


def list_rows(cases: int, seed: int) -> Iterator[Row]:
    """Yield the rows: compared with, quantity, found."""
    loaded, founded = (max(measure() for measure in each.values()) for each in (LOADED, FOUNDED))
    yield f"{len(LOADED)} beams under a uniform load", "error over the largest deflection", show(loaded)
    yield f"{len(FOUNDED)} beams on an elastic foundation", "error, base moved by 1 mm", f"{show(founded)} mm"
    orders = np.array([measure_orders(*case) for case in MANUFACTURED.values()])
    names = ("deflection (theory 4)", "slope (3)", "deflection at the nodes (4)", "slope at the nodes (4)")
    for name, low, high in zip(names, orders.min(axis=0), orders.max(axis=0), strict=True):
        yield f"{len(orders)} manufactured solutions", f"order of the {name}", f"{low:.2f} to {high:.2f}"
    fine, default = np.max([measure_difference(*case) for case in COLLOCATED.values()], axis=0)
    what = f"{len(COLLOCATED)} equilibria by `scipy.integrate.solve_bvp`"
    yield what, "difference, elements of 0.25 mm", f"{show(fine)} mm"
    yield what, "difference, elements of 1 mm", f"{show(default)} mm"
    shipped = measure_shipped_meshes()
    yield f"elements of 1/8 mm, {len(shipped)} shipped scenes", "tip", f"{show(max(shipped.values()))} mm"
    changes = measure_random_meshes(np.random.default_rng(seed), cases)
    yield f"elements of 1/8 mm, {cases} random insertions", "tip", f"{show(max(changes))} mm"
    for name, (tissue, _) in ({**ADVANCED, "layers of phantom 2": (PHANTOM2, 0.0)}).items():
        order, error = measure_spacing(tissue)
        found = f"{100 * error:.2f} %; {order:.2f}"
        yield "limit of small $C_{\\mathrm{int}}$, path angle", f"tip at 1 mm; order: {name}", found
    rng = np.random.default_rng(seed)
    what, largest = f"{cases} random schedules", max(measure_reference(rng) for _ in range(cases))
    yield f"`tests/reference_solver.py`, {what}", "deflection", f"{show(largest)} mm"
    largest = max(measure_balance(rng) for _ in range(cases))
    yield f"balance, {what}", "sum of the forces over their sizes", show(largest)
    few = max(1, cases // 4)  # complex steps through dense matrices take seconds a case
    of_shape, others = np.max([measure_jacobian(rng) for _ in range(few)], axis=0)
    what = f"complex steps, {few} random schedules"
    yield what, "derivatives by shape parameters, over the largest", show(of_shape)
    yield what, "derivatives by other parameters, over the largest", show(others)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("| compared with | quantity | found |\n|---|---|---|", flush=True)
    for row in list_rows(options.cases, options.seed):
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
