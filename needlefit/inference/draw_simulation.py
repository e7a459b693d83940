"""Predict one planned insertion, or a scene, with many draws of the parameters at once.

Each draw has layers of its own: its needle bends otherwise, and meets the surfaces elsewhere. The kernel
takes the boundaries of every set, so that draws with the same error of the entry are one batch. Where the
surfaces lie is tabulated along parallels to the entry axis, since draws deviate by millimetres.
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

PATH_POINTS = 31  #: points of a needle among which its crossings are looked for
TABLE_POINTS = 9  #: parallels to the entry axis along which the places of surfaces are tabulated
OUTERMOST = (0.002, 0.998)  #: quantiles of the points of all draws between which surfaces are tabulated
#: distance of the outermost parallels from the outermost draws, mm, and of surfaces that no tip reaches
TABLE_MARGIN_MM = 0.5
BEYOND_TIP_MM = 10.0  #: length of the parallels beyond the tip, mm
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
        # the needles bend alike through the layers of the straight path: next crossings move by 1e-3 mm
        stations, still = np.linspace(0.0, insertion.depth, PATH_POINTS), np.zeros_like(deep)
        depths, sequence = find_path_layers(np.outer(stations, (1.0, 0.0, 0.0)), insertion)
        met = [(every, np.tile(depths, (len(sets), 1)), sequence)]
        straight = _simulate(sets, medium, insertion, stations, met, still, np.zeros_like(wrong), jobs, False)
        met = _find_met_layers(straight.points, insertion, wrong, medium.layers)
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
    parts = []
    for rows, boundaries, sequence in met:
        if max(sequence) > medium.layers:  # the needle leaves the medium
            continue
        for error in np.unique(deep[rows]).tolist():
            alike = deep[rows] == error
            some = rows[alike]
            moved = enforce_order(boundaries[alike] + wrong[some, : boundaries.shape[1]] + error)
            depth = insertion.depth + error
            planned = replace(insertion, depth=depth, sequence=sequence, boundaries=moved[0])
            batch = make_batch([sets[n] for n in some.tolist()], medium, planned, moved)
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


def _find_met_layers(paths: Floats, insertion: Insertion, wrong: Floats, layers: int) -> list[MetLayers]:
    """Return the layers that paths (B, P, 3) in C meet, of which the medium has so many."""
    known = np.flatnonzero(np.isfinite(paths).all(axis=(1, 2)))
    if not len(known):
        return []
    low, high = np.quantile(paths[known, :, 1], OUTERMOST)
    table = _tabulate_surfaces(insertion, float(low), float(high))
    if table is not None:
        crossings = table.find_crossings(paths[known])
        deepest = insertion.depth + TABLE_MARGIN_MM - np.min(wrong[:, : crossings.shape[1]], axis=0)
        count = int(np.sum(np.cumprod(crossings.min(axis=0) < deepest)))
        if max(table.sequence[: count + 1]) <= layers:
            return [(known, crossings[:, :count], table.sequence[: count + 1])]
    # parallels disagree: a surface that some needles meet and others miss
    crossed = [(row, *find_path_layers(paths[row], insertion)) for row in known]
    groups = group_values((sequence, (row, depths)) for row, depths, sequence in crossed)
    return [
        (np.array([row for row, _ in some]), np.array([depths for _, depths in some]), sequence)
        for sequence, some in groups.items()
    ]


@dataclass(frozen=True)
class _SurfaceTable:
    """Depths (T, n - 1) at which T parallels to the entry axis, at `y` (T,), cross surfaces, and n layers."""

    y: Floats
    depths: Floats
    sequence: tuple[int, ...]

    def find_crossings(self, paths: Floats) -> Floats:
        """Return the depths (B, n - 1) at which paths (B, P, 3) cross; of the parallel if they end before."""
        x, y = paths[..., 0], paths[..., 1]
        crossings = np.empty((len(paths), self.depths.shape[1]))
        rows = np.arange(len(paths))
        for j, depths in enumerate(self.depths.T):
            ahead = np.interp(y, self.y, depths) - x  # (B, P), positive before the surface
            beyond = ahead <= 0
            # the first point beyond; without one the last
            after = np.where(beyond.any(axis=1), np.argmax(beyond, axis=1), x.shape[1] - 1)
            before = np.maximum(after - 1, 0)
            span = ahead[rows, before] - ahead[rows, after]
            part = np.clip(np.divide(ahead[rows, before], span, out=np.ones(len(x)), where=span > 0), 0, 1)
            depth = x[rows, before] + part * (x[rows, after] - x[rows, before])
            # of a needle that ends before it
            end = x[:, -1] + ahead[:, -1]
            crossings[:, j] = np.where(beyond.any(axis=1), depth, end)
        return crossings


def _tabulate_surfaces(insertion: Insertion, low: float, high: float) -> _SurfaceTable | None:
    """Return where parallels `low` to `high` mm beside the entry axis cross; None where they disagree."""
    y = np.linspace(low - TABLE_MARGIN_MM, high + TABLE_MARGIN_MM, TABLE_POINTS)
    tables = []
    for height in y:
        local = np.array([[0.0, height, 0.0], [insertion.depth + BEYOND_TIP_MM, height, 0.0]])
        tables.append(find_path_layers(local, insertion))
    count = min(len(depths) for depths, _ in tables)
    sequences = {sequence[: count + 1] for _, sequence in tables}
    # a further surface that some parallels do not meet must be one that no needle reaches
    near = any(np.any(depths[count:] < insertion.depth + TABLE_MARGIN_MM) for depths, _ in tables)
    if len(sequences) > 1 or near:
        return None
    return _SurfaceTable(y, np.array([depths[:count] for depths, _ in tables]), sequences.pop())
