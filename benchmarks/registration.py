"""How well markers register a scan, whether the predicted error is right, and which faults are noticed.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/registration.py [--json] [--cases N] [--seed S]

Two kinds of cases, all synthetic points (no voxels). *The stated layout*: `LAYOUT`, six markers on a box of
80 mm, random pose, Gaussian noise of `FOUND_SD` in the scan and `KNOWN_SD` in the world, per direction; one
marker is missing in a fifth of the cases and one found is spurious in another fifth. Errors are those of the
entry and of the tip of a 75 mm needle, at the estimated against the true pose. *Random layouts* of 4 to 12
markers in that box, those with a symmetry left out and counted: missing and spurious markers, reflections,
wrong spacings. Shares stand with their 95 % Wilson intervals.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration import (
    Registration,
    align,
    list_pairings,
    predict_mean_target_error,
    register,
    target_covariance,
)

Floats = NDArray[np.float64]

LAYOUT = np.array(
    [[5, -40, -31], [22, 40, -18], [41, -40, 24], [58, 21, 40], [76, 40, 27], [80, -33, -38]], dtype=float
)
"""Markers on the faces of a box 0..80 x +-40 x +-40 mm; the needle enters at the origin, along x. mm."""

TARGETS = np.array([[0.0, 0.0, 0.0], [75.0, 4.0, 0.0]])
FOUND_SD, KNOWN_SD = 0.10, 0.10  # mm per direction: about a fifth of a voxel of 0.46 mm; a measuring arm
SD = float(np.hypot(FOUND_SD, KNOWN_SD))
HIDDEN_CHI2 = 45.0  # misfit below which noise hides in 1 % and more that a pairing is wrong
SCALES = (1.005, 1.01, 1.02, 1.05, 1.2, 0.5)


@dataclass(frozen=True)
class Case:
    """What was found (M, 3), where it should be (N, 3), the true partner of each (-1: none), the pose."""

    found: Floats
    known: Floats
    partner: NDArray[np.int64]
    pose: Frame


def draw(
    layout: Floats,
    rng: np.random.Generator,
    missing: int = 0,
    spurious: int = 0,
) -> Case:
    """Return a scan of the layout at a random pose, markers in random order."""
    pose = Frame(rng.normal(size=3) * 100, Rotation.random(rng=rng).as_matrix())
    kept = rng.permutation(len(layout))[missing:]
    ghosts = rng.uniform([0, -40, -40], [80, 40, 40], (spurious, 3))
    partner = np.concatenate([kept, -np.ones(spurious, dtype=np.int64)])
    found = pose.to_local(np.concatenate([layout[kept], ghosts])) + FOUND_SD * rng.normal(
        size=(len(partner), 3)
    )
    order = rng.permutation(len(partner))
    known = layout + KNOWN_SD * rng.normal(size=layout.shape)
    return Case(found[order], known, partner[order], pose)


def count_turns(layout: Floats) -> int:
    """Return how many turns map a layout onto itself so nearly that noise hides it; 1: none."""
    count, apart = len(layout), cdist(layout, layout)
    near = (apart[:, None, :, None] - apart[:, None]) ** 2 <= 2 * SD**2 * HIDDEN_CHI2
    variance = np.full(count, SD**2)
    pairings = list_pairings(near, count)
    return sum(align(layout, layout, variance, pairs).chi2 <= HIDDEN_CHI2 for pairs in pairings)


def asymmetric(rng: np.random.Generator, left_out: list[int]) -> Floats:
    """Return a random layout that has no symmetry under the noise; count in `left_out` those that have."""
    while True:
        layout = rng.uniform([0, -40, -40], [80, 40, 40], (int(rng.integers(4, 13)), 3))
        if count_turns(layout) == 1:
            return layout
        left_out[0] += 1


def tried(call: Callable[[], Registration]) -> Registration | str:
    """Return the registration, or the message of the refusal."""
    try:
        return call()
    except DataError as error:
        return str(error)


def right(registration: Registration, case: Case) -> bool:
    """Say whether every pair is true."""
    return bool((case.partner[registration.pairs[:, 0]] == registration.pairs[:, 1]).all())


def share(hits: int, of: int) -> dict[str, float]:
    """Return a share and its 95 % Wilson interval."""
    z = 1.959963984540054
    middle = (hits + z**2 / 2) / (of + z**2)
    half = z / (of + z**2) * np.sqrt(hits * (of - hits) / of + z**2 / 4)
    low, high = max(middle - half, 0.0), min(middle + half, 1.0)
    return {"share": hits / of, "low": low, "high": high, "hits": hits, "of": of}


def accuracy(cases: int, rng: np.random.Generator) -> dict[str, object]:
    """Return the target errors of the stated layout, against the prediction."""
    realised, predicted, squares, proper, wrong, refused, inside = [], [], [], [], 0, 0, []
    for _ in range(cases):
        kind = rng.uniform()
        case = draw(LAYOUT, rng, missing=int(kind < 0.2), spurious=int(kind > 0.8))
        result = tried(lambda case=case: register(case.found, case.known, FOUND_SD, KNOWN_SD))
        if isinstance(result, str):
            refused += 1
            continue
        wrong += not right(result, case)
        local = case.pose.to_local(TARGETS)
        realised.append(np.linalg.norm(result.frame.to_world(local) - TARGETS, axis=1))
        predicted.append(predict_mean_target_error(result, local))
        squares.append(np.trace(target_covariance(result, local), axis1=1, axis2=2))
        turn = result.frame.rotation
        proper.append([np.linalg.det(turn) - 1, np.abs(turn @ turn.T - np.eye(3)).max()])
        inside.append(result.fre / result.expected_fre)
    real, mean, square = np.array(realised), np.array(predicted), np.array(squares)
    ends = dict(zip(("entry", "tip"), range(2), strict=True))
    return {
        "mean target error, mm": {name: float(real[:, n].mean()) for name, n in ends.items()},
        "95 % of them below, mm": {name: float(np.quantile(real[:, n], 0.95)) for name, n in ends.items()},
        "predicted mean over realised": {
            n: float(mean[:, i].mean() / real[:, i].mean()) for n, i in ends.items()
        },
        "predicted rms over realised": {
            n: float(np.sqrt(square[:, i].mean() / (real[:, i] ** 2).mean())) for n, i in ends.items()
        },
        "residual (FRE) over expected, root mean square": float(np.sqrt(np.mean(np.square(inside)))),
        "largest |determinant - 1|, deviation from orthogonality": np.abs(proper).max(axis=0).tolist(),
        "wrong pairing accepted": share(wrong, cases),
        "refused": share(refused, cases),
    }


def search_pairs(cases: int, rng: np.random.Generator, left_out: list[int]) -> dict[str, object]:
    """Return what comes of pairing by oneself, with up to two missing and two spurious markers."""
    right_ones = wrong = refused = 0
    for _ in range(cases):
        layout = asymmetric(rng, left_out)
        missing = min(int(rng.integers(0, 3)), len(layout) - 3)
        case = draw(layout, rng, missing, int(rng.integers(0, 3)))
        result = tried(lambda case=case: register(case.found, case.known, FOUND_SD, KNOWN_SD))
        refused += isinstance(result, str)
        if not isinstance(result, str):
            right_ones += right(result, case)
            wrong += not right(result, case)
    answers = {"right": right_ones, "refused": refused, "wrong and accepted": wrong}
    return {name: share(count, cases) for name, count in answers.items()}


def nearly_symmetric(cases: int, rng: np.random.Generator) -> dict[str, object]:
    """Return what comes of twofold layouts with one marker moved so far that they count as asymmetric."""
    answers = {"wrong and accepted": 0, "refused": 0}
    for _ in range(cases):
        half = rng.uniform(-40, 40, (4, 3))
        layout = np.concatenate([half, half * [-1, -1, 1]])
        shift = rng.normal(size=3)
        shift /= 20 * np.linalg.norm(shift)  # mm a step
        while count_turns(layout) > 1:
            layout[0] += shift
        case = draw(layout, rng)
        result = tried(lambda case=case: register(case.found, case.known, FOUND_SD, KNOWN_SD))
        answers["wrong and accepted"] += not isinstance(result, str) and not right(result, case)
        answers["refused"] += isinstance(result, str)
    return {name: share(count, cases) for name, count in answers.items()}


def faults(cases: int, rng: np.random.Generator, left_out: list[int]) -> dict[str, object]:
    """Return how often reflections are named, and wrong spacings refused."""
    counts: dict[str, list[bool]] = {}
    for _ in range(cases):
        case = draw(asymmetric(rng, left_out), rng)

        def stretched(factors: object, case: Case = case) -> Registration | str:
            return tried(lambda: register(case.found * np.array(factors), case.known, FOUND_SD, KNOWN_SD))

        mirrored = stretched([1, 1, -1])
        counts.setdefault("mirrored", []).append(isinstance(mirrored, str) and "mirror" in mirrored)
        for factor in SCALES:
            for name, factors in (("spacing", [factor] * 3), ("slice spacing", [1, 1, factor])):
                refused = isinstance(stretched(factors), str)
                counts.setdefault(f"{name} wrong by {factor:g}", []).append(refused)
    return {name: share(sum(hits), len(hits)) for name, hits in counts.items()}


def figures(cases: int, seed: int) -> dict[str, object]:
    """Return all figures."""
    rngs = [np.random.default_rng([seed, n]) for n in range(9)]
    left_out = [0]
    found: dict[str, object] = {
        "stated layout": accuracy(5 * cases, rngs[0]),
        "pairing found by itself": search_pairs(2 * cases, rngs[2], left_out),
        "all but symmetric layouts": nearly_symmetric(cases, rngs[8]),
        "faults": faults(cases, rngs[3], left_out),
    }
    found["random layouts left out as symmetric"] = left_out[0]
    return found


def printed(name: str, value: object, indent: int = 0) -> None:
    """Print a figure, or a group of them."""
    pad = "  " * indent
    if isinstance(value, dict) and "share" in value:
        low, high = 100 * value["low"], 100 * value["high"]
        text = f"{100 * value['share']:.2f} % ({low:.2f} to {high:.2f}; {value['hits']} of {value['of']})"
        print(f"{pad}{name}: {text}")
    elif isinstance(value, dict):
        print(f"{pad}{name}")
        for key, inner in value.items():
            printed(key, inner, indent + 1)
    else:
        numbers = value if isinstance(value, list) else [value]
        print(f"{pad}{name}: " + ", ".join(f"{number:.4g}" for number in numbers))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--cases", type=int, default=250)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    found = figures(arguments.cases, arguments.seed)
    if arguments.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        printed(name, value)


if __name__ == "__main__":
    main()
