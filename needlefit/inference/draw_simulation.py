"""Predict one planned insertion, or a scene, with many draws of the parameters at once.

Each draw has layers of its own: its needle bends otherwise, and meets the surfaces elsewhere. The kernel
takes the boundaries of every set, so that draws with the same error of the entry that meet the same layers
are one batch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from needlefit.arrays import Bools, Floats, Ints
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.grouping import group_values
from needlefit.inference.forward_model import (
    MAX_DRAWN_LAYERS,
    clip_layers,
    find_path_layers,
    make_batch,
    stack_values,
    tabulate_sets,
)
from needlefit.inference.likelihood.nodes import enforce_order
from needlefit.inference.parameter_names import BEVEL_PARAMETERS, BEVEL_SPREAD, find_bevel_factors
from needlefit.inference.parameters import make_tissue
from needlefit.mechanics.batch import (
    Batch,
    NeedleShapes,
    compute_batch_positions,
    read_batches,
    simulate_batches,
)
from needlefit.mechanics.scene import Scene
from needlefit.schemas.medium import MediumRecord

PATH_POINTS = 31  #: number of points of a needle among which its crossings are looked for
BEYOND_TIP_MM = 10.0  #: length (mm) of a path beyond the tip: farther than boundaries err
#: errors of the entry that draws have: the middles of equal parts of a normal distribution, of unit variance
ENTRY_ERRORS = ndtri((np.arange(8) + 0.5) / 8)
ENTRY_ERRORS /= ENTRY_ERRORS.std()

Sets = Sequence[Mapping[str, float]]  #: values of parameters (Pa, mm), a set for each draw
#: the layers of some draws (R,): the depths of their boundaries (R, n - 1), mm, and which n these part
MetLayers = tuple[Ints, Floats, tuple[int, ...]]


@dataclass(frozen=True)
class DrawnNeedles:
    """The needles of B draws: points (B, K, 3) in C, mm, NaN where the solve failed, and which are valid."""

    points: Floats
    valid: Bools

    @property
    def solved(self) -> Bools:
        """Which draws have a solution, (B,)."""
        return np.asarray(np.isfinite(self.points).all(axis=(1, 2)), dtype=np.bool_)


def draw_entry_errors(sd: float, count: int, rng: np.random.Generator) -> Floats:
    """Return errors of the entry (B,), mm, of a standard deviation: a few that many draws have in common."""
    parts = ndtr(rng.standard_normal(count)) * len(ENTRY_ERRORS)
    return np.asarray(sd * ENTRY_ERRORS[parts.astype(np.int64)])


def draw_depth_errors(insertion: Insertion, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return errors of the entry (B,), and of the boundaries in the order met (B, MAX_DRAWN_LAYERS), mm."""
    whole = float(np.hypot(*split_boundary_sd(insertion)))
    deep = draw_entry_errors(insertion.depth_sd, count, rng)
    return deep, whole * rng.standard_normal((count, MAX_DRAWN_LAYERS))


def vary_bevels(sets: Sets, sd: float, rng: np.random.Generator) -> list[dict[str, float]]:
    """Return sets of values with bevels that deviate with an SD of `sd` SDs between insertions."""
    return scale_bevels(sets, sd * rng.standard_normal(len(sets)))


def scale_bevels(sets: Sets, deviations: Floats) -> list[dict[str, float]]:
    """Return sets of values with bevels that deviate by so many SDs between insertions, (B,)."""
    spreads = np.array([values.get(BEVEL_SPREAD, 0.0) for values in sets])
    factors = find_bevel_factors(spreads, deviations)
    return [
        {name: value * factor if name in BEVEL_PARAMETERS else value for name, value in values.items()}
        for values, factor in zip(sets, factors.tolist(), strict=True)
    ]


def simulate_draws(
    sets: Sets,
    medium: MediumRecord,
    insertion: Insertion,
    s: Floats,
    deep: Floats,
    wrong: Floats,
    jobs: int = 1,
) -> DrawnNeedles:
    """Return the needles of B sets of values at beam coordinates `s` (K,), through the layers of each.

    `deep`, `wrong`: from `draw_depth_errors`. Nothing of the measured shape is used.
    """
    every = np.arange(len(sets))
    met = [(every, np.tile(insertion.boundaries, (len(sets), 1)), insertion.sequence)]
    if insertion.surfaces:
        # Needles bend almost alike through the layers of the straight path. Crossings that were found again
        # would move tips by at most 0.16 mm in the twin's surfaces, by nothing in sheets across the needle,
        # and by up to 0.7 and 1.1 mm in sheets inclined by 60 and 75 degrees.
        stations, still = np.linspace(0.0, insertion.depth, PATH_POINTS), np.zeros_like(deep)
        (depths,), (sequence,) = find_path_layers(np.outer(stations, (1.0, 0.0, 0.0))[None], insertion)
        met = [(every, np.tile(depths, (len(sets), 1)), clip_layers(sequence.tolist(), medium))]
        straight = _simulate(sets, medium, insertion, stations, met, still, np.zeros_like(wrong), jobs, False)
        met = _find_met_layers(straight.points, insertion, wrong)
    return _simulate(sets, medium, insertion, s, met, deep, wrong, jobs)


def _simulate(
    sets: Sets,
    medium: MediumRecord,
    insertion: Insertion,
    s: Floats,
    met: Sequence[MetLayers],
    deep: Floats,
    wrong: Floats,
    jobs: int,
    judged: bool = True,
) -> DrawnNeedles:
    parts, table = [], tabulate_sets(sets)
    for rows, boundaries, sequence in met:
        if max(sequence) > medium.layers:  # the needle leaves the medium
            continue
        for error in np.unique(deep[rows]).tolist():
            alike = deep[rows] == error
            some = rows[alike]
            moved = enforce_order(boundaries[alike] + wrong[some, : boundaries.shape[1]] + error)
            depth = insertion.depth + error
            planned = replace(insertion, depth=depth, sequence=sequence, boundaries=moved[0])
            values = {name: column[some] for name, column in table.items()}
            batch = make_batch(values, medium, planned, moved)
            parts.append((some, batch, s + error))
    return _read_needles(len(sets), len(s), parts, jobs, judged)


def _read_needles(
    count: int, width: int, parts: Sequence[tuple[Ints, Batch, Floats]], jobs: int, judged: bool = True
) -> DrawnNeedles:
    """Return the needles of so many draws at so many places.

    `parts`: some of the draws, their batch, and the places (K,) along it. Unless `judged`, every solution
    counts as valid.
    """

    def read(number: int, shapes: NeedleShapes, rows: slice) -> tuple[Floats, Bools]:
        valid = shapes.valid if judged else shapes.converged
        return compute_batch_positions(shapes, parts[number][2]), valid

    curves = read_batches([batch for _, batch, _ in parts], lambda some: simulate_batches(some, jobs), read)
    points, valid = np.full((count, width, 3), np.nan), np.zeros(count, dtype=np.bool_)
    for (rows, *_), (some, some_valid) in zip(parts, curves, strict=True):
        points[rows], valid[rows] = some, some_valid
    return DrawnNeedles(points, valid)


def simulate_scene_draws(
    sets: Sets, medium: MediumRecord, scene: Scene, s: Floats, deep: Floats, wrong: Floats
) -> DrawnNeedles:
    """Return the needles of B sets of values in a scene, at arc lengths `s` (K,), mm.

    `deep` (B,) are the errors of the entry, `wrong` (B, n - 1) those of the layers' depths, mm.
    """
    layers, parts = range(1, scene.tissue.layers + 1), []
    for error in np.unique(deep).tolist():
        rows = np.flatnonzero(deep == error)
        values = [sets[n] for n in rows.tolist()]
        tissue = make_tissue(values[0], layers, scene.tissue.boundaries, medium)
        steps = tuple(replace(step, depth=step.depth + error) for step in scene.steps)
        boundaries = enforce_order(scene.tissue.boundaries + wrong[rows] + error)
        given = stack_values(tabulate_sets(values), medium, layers)
        batch = Batch(scene.needle, tissue, steps, scene.rules, boundaries=boundaries, **given)
        parts.append((rows, batch, s + error))
    return _read_needles(len(sets), len(s), parts, 1)


def _find_met_layers(paths: Floats, insertion: Insertion, wrong: Floats) -> list[MetLayers]:
    """Return the layers that paths (B, P, 3) in C meet.

    A path goes on straight beyond its tip: with errors of the boundaries a needle may reach what lies there.
    """
    rows = np.flatnonzero(np.isfinite(paths).all(axis=(1, 2)))
    if not len(rows):
        return []
    steps = paths[rows, -1:] - paths[rows, -2:-1]
    beyond = paths[rows, -1:] + BEYOND_TIP_MM * steps / np.linalg.norm(steps, axis=2, keepdims=True)
    depths, numbers = find_path_layers(np.concatenate([paths[rows], beyond], axis=1), insertion)
    reached = depths + wrong[rows, : depths.shape[1]] < insertion.depth  # not where NaN: there is no further
    last = np.max(reached * np.arange(1, depths.shape[1] + 1), axis=1, initial=0)
    sequences = (tuple(met[: count + 1]) for met, count in zip(numbers.tolist(), last.tolist(), strict=True))
    groups = group_values(zip(sequences, range(len(rows)), strict=True))
    return [(rows[some], depths[some, : len(sequence) - 1], sequence) for sequence, some in groups.items()]
