"""What the cost of the model grows with: depth, layers, parameter sets, parameters of the Jacobian.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/costs.py [--json] [--rounds N] [--out FOLDER]

Processor time of one thread, the least of the rounds, which measure all points in turns; everything around
the kernel is included; tolerance 1e-7 mm. Straight lines are fitted by least squares and their slopes
printed; for the whole insertion also the power of the depth that it grows with, over the deeper half. The
time of a step is that by which an insertion 20 mm deeper takes longer. With --out the points and fits are
drawn, as `costs.svg` and `costs.png`.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from reference_problem import BEVEL, DEPTH, NEEDLE, TISSUE, batch, layered

from needlefit.mechanics.batch import linearize, simulate_batches
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.simulate import simulate, simulate_steps

Floats = NDArray[np.float64]
TOLERANCE = 1e-7  # mm
RULES = ModelOptions(tolerance=TOLERANCE)
DEPTHS = np.arange(5, 121, 5)  # mm
LAYERS = np.array([1, 2, 3, 4, 6, 8, 12, 16])
SETS = np.array([32, 64, 128, 256, 512, 1024, 2048])
CALLS = 3  # in a row
WINDOW = 4  # depths between which the time of a step is read
BLOCK = 32  # sets, where their number is not what is varied


def deep(depth: float) -> dict[str, Callable[[], object]]:
    """Return an insertion to `depth`, scalar and in lanes."""
    steps, sets = (Step(depth, BEVEL),), [batch(BLOCK, TOLERANCE, depth)]
    return {
        "depth, scalar": lambda: simulate_steps(NEEDLE, TISSUE, steps, RULES),
        "depth, lanes": lambda: simulate_batches(sets, 1),
    }


def with_layers(layers: int) -> dict[str, Callable[[], object]]:
    """Return an insertion through so many layers: scalar, in lanes, and with derivatives."""
    tissue = layered(layers)
    sets = [batch(BLOCK, TOLERANCE, tissue=tissue)]
    return {
        "layers, scalar": lambda: simulate(NEEDLE, tissue, BEVEL, DEPTH, rules=RULES),
        "layers, lanes": lambda: simulate_batches(sets, 1),
        "layers, jacobian": lambda: linearize(NEEDLE, tissue, BEVEL, DEPTH, rules=RULES),
    }


def many(count: int) -> dict[str, Callable[[], object]]:
    """Return an insertion with so many sets."""
    sets = [batch(count, TOLERANCE)]
    return {"sets, lanes": lambda: simulate_batches(sets, 1)}


def measure(rounds: int) -> dict[str, Floats]:
    """Return the time of a call for every point of every curve, us."""
    points = [
        *(list(deep(float(depth)).items()) for depth in DEPTHS),
        *(list(with_layers(int(layers)).items()) for layers in LAYERS),
        *(list(many(int(count)).items()) for count in SETS),
    ]
    calls = [one for some in points for one in some]
    taken = np.empty((rounds, len(calls)))
    for _, call in calls:
        call()
    for n in range(rounds):
        for i, (_, call) in enumerate(calls):
            call()  # brings its own arrays into the cache
            begin = time.thread_time()
            for _ in range(CALLS):
                call()
            taken[n, i] = (time.thread_time() - begin) / CALLS
    typical = np.median(taken, axis=0) * 1e6
    names = [name for name, _ in calls]
    return {
        name: typical[[i for i, other in enumerate(names) if other == name]] for name in dict.fromkeys(names)
    }


def curves(taken: dict[str, Floats]) -> dict[str, tuple[Floats, Floats, str, str]]:
    """Return x, y and their names of the straight lines that are expected."""
    ends = DEPTHS[WINDOW:], DEPTHS[:-WINDOW]
    found = {}
    for way, sets in (("scalar", 1), ("lanes", BLOCK)):
        whole = taken[f"depth, {way}"]
        per_step = (whole[WINDOW:] - whole[:-WINDOW]) / (ends[0] - ends[1]) / sets
        found[f"step by depth, {way}"] = (sum(ends) / 2, per_step, "depth, mm", "us per step (and lane)")
    for way, sets in (("scalar", 1), ("lanes", BLOCK)):
        per_step = taken[f"layers, {way}"] / DEPTH / sets
        found[f"layers, {way}"] = (LAYERS * 1.0, per_step, "layers", "us per step (and lane)")
    found["sets, lanes"] = (SETS * 1.0, taken["sets, lanes"] / 1e3, "parameter sets", "ms per batch")
    more = (taken["layers, jacobian"] - taken["layers, scalar"]) / DEPTH
    found["derivatives"] = (
        2.0 * LAYERS + 1,
        more,
        "parameters: 1, and 2 per layer",
        "us per step, more than without",
    )
    return found


def fit(x: Floats, y: Floats) -> dict[str, float]:
    """Return slope and value at 0 of a straight line, and the share of the variance that it explains."""
    slope, start = np.polyfit(x, y, 1)
    left = np.sum((y - start - slope * x) ** 2) / np.sum((y - y.mean()) ** 2)
    return {"slope": float(slope), "at_0": float(start), "r_squared": float(1 - left)}


def figures(taken: dict[str, Floats]) -> dict[str, dict[str, float]]:
    """Return all fits."""
    found = {name: fit(x, y) for name, (x, y, _, _) in curves(taken).items()}
    half = len(DEPTHS) // 2
    for way in ("scalar", "lanes"):
        whole = taken[f"depth, {way}"]
        power = np.polyfit(np.log(DEPTHS[half:]), np.log(whole[half:]), 1)[0]
        quadratic = np.polyfit(DEPTHS, whole, 2)
        found[f"insertion by depth, {way}"] = {
            "power": float(power), "us_per_mm2": float(quadratic[0]), "us_per_mm": float(quadratic[1]),
            "at_0": float(quadratic[2]),
        }  # fmt: skip
    return found


def draw(taken: dict[str, Floats], folder: Path) -> None:
    """Draw points and fits, a panel per curve; whole insertions beside the steps that they are made of."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.fonttype"] = "none"
    mpl.rcParams["svg.hashsalt"] = "costs"
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 4, figsize=(14, 6.4), layout="constrained")
    for panel, (name, (x, y, along, up)) in zip(panels.flat, curves(taken).items(), strict=False):
        line = fit(x, y)
        panel.plot(x, y, "o", ms=4)
        panel.plot([0, x[-1]], [line["at_0"], line["at_0"] + line["slope"] * x[-1]], "-", lw=1)
        panel.set(title=name, xlabel=along, ylabel=up, xlim=(0, None), ylim=(0, 1.08 * y.max()))
    for panel, way in zip(panels.flat[6:], ("scalar", "lanes"), strict=True):
        whole = taken[f"depth, {way}"] / 1e3
        panel.plot(DEPTHS, whole, "o", ms=4)
        dense = np.linspace(0, DEPTHS[-1], 100)
        panel.plot(dense, np.polyval(np.polyfit(DEPTHS, whole, 2), dense), "-", lw=1)
        sets = f" ({BLOCK} sets)" if way == "lanes" else ""
        panel.set(title=f"insertion by depth, {way}", xlabel="depth, mm", ylabel=f"ms per insertion{sets}")
        panel.set(xlim=(0, None), ylim=(0, None))
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("svg", "png"):
        figure.savefig(folder / f"costs.{kind}", dpi=110, metadata={"Date": None} if kind == "svg" else None)
    plt.close(figure)


def main() -> None:
    """Print the fits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    taken = measure(arguments.rounds)
    found = figures(taken)
    if arguments.out:
        draw(taken, arguments.out)
    if arguments.json:
        print(json.dumps(found, indent=2))
        return
    for name, values in found.items():
        print(f"{name:30s}" + "".join(f"  {key} {value:.4g}" for key, value in values.items()))


if __name__ == "__main__":
    main()
