"""Predict one planned insertion, or a scene, with many draws of the parameters at once.

Each draw has layers of its own: its needle bends otherwise, and meets the surfaces elsewhere. All draws are
simulated together (`mechanics.batch`) with the same layer depths, and some of them with other depths too. The
effect of the depths on these is interpolated over the parameters, and by a spline in each depth. Where the
surfaces lie is tabulated along parallels to the entry axis, since draws deviate by millimetres from each
other. Draws whose depths lie far beyond those that were simulated are simulated one by one, and some others,
to be compared. What cannot be interpolated (a surface that some draws meet and others miss), and tips that
err by more than `MAX_INTERPOLATION_ERROR`, are simulated draw by draw.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.distance import cdist

from needlefit.arrays import Bools, Floats, Ints
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.datasets.layers import find_layers
from needlefit.inference.forward_model import PreparedModel, predict, stack_values, tabulate_sets
from needlefit.inference.likelihood.nodes import enforce_order, shift_depths
from needlefit.inference.likelihood.observations import read_points
from needlefit.inference.parameter_names import BEVEL_PARAMETERS, BEVEL_SPREAD, find_bevel_factors
from needlefit.inference.parameters import make_tissue
from needlefit.inference.planned_layers import MAX_DRAWN_LAYERS, with_planned_layers
from needlefit.inference.radial_basis import interpolate_points
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
#: where each depth is simulated besides its middle, in units of so many deviations over the draws
NODE_PLACES, NODE_SD = (-1.0, 1.0), 1.2
#: a depth farther from its middle, in units of that of the nodes, is simulated: interpolated tips of
#: study 3 err by up to 1 mm within, and by up to 8.7 mm beyond
MAX_NODE_DISTANCE = 2.0
MIN_NODE_MM = 0.05  #: least distance of the depths at which needles are simulated, mm
NODE_DRAWS = 96  #: draws, at most, that are simulated with other depths than the middle
#: draws of these that are chosen because they lie farthest from the others: nothing is extrapolated far
FAR_DRAWS = 32
SAME_DRAW = 1e-6  #: deviations of parameters (ln of positive ones) below which draws do not differ
#: rounds in which the crossings of interpolated needles converge; each changes them by a slope less
CROSSING_ROUNDS = 6

CHECKED_DRAWS = 12  #: draws, at most, that are also simulated at their own depths
#: largest rms error of their interpolated tips, as a part of the standard deviation of a predicted tip
MAX_INTERPOLATION_ERROR = 0.1

Sets = Sequence[Mapping[str, float]]  #: values of parameters (Pa, mm), a set for each draw
#: returns the points (m, B, K, 3) of B sets with boundaries shifted by (n - 1,) and the tip by a number, mm,
#: for m such moves, and the validity (B,) with the first
Move = Callable[[Sets, Sequence[tuple[Floats, float]]], tuple[Floats, Bools]]


@dataclass(frozen=True)
class DrawnNeedles:
    """The needles of B draws: points (B, K, 3) in C, mm, and which are valid.

    Points are NaN where the solve at the middle depths failed; validity is of these depths too.
    """

    points: Floats
    valid: Bools

    @property
    def solved(self) -> Bools:
        """Which draws have a solution, (B,)."""
        return np.asarray(np.isfinite(self.points).all(axis=(1, 2)), dtype=np.bool_)

    def simulate_some(self, rows: Ints, simulate: "Callable[[Ints], DrawnNeedles]") -> "DrawnNeedles":
        """Return these needles, some draws (M,) of which are simulated."""
        if not len(rows):
            return self
        simulated, points, valid = simulate(rows), self.points.copy(), self.valid.copy()
        points[rows], valid[rows] = simulated.points, simulated.valid
        return DrawnNeedles(points, valid)

    def check(
        self, interpolated: Ints, simulate: "Callable[[Ints], DrawnNeedles]", tip: int, sd: float
    ) -> "DrawnNeedles":
        """Return these needles; those that were interpolated simulated too where some are far from these.

        `interpolated` (M,) are draws with a solution. `simulate` gives the needles of some draws, `tip` is
        the place of the tip among the points.
        """
        if not len(interpolated):
            return self
        last = len(interpolated) - 1
        some = interpolated[np.unique(np.linspace(0, last, CHECKED_DRAWS).round().astype(np.int64))]
        errors = simulate(some).points[:, tip, 1:] - self.points[some, tip, 1:]
        errors = errors[np.isfinite(errors).all(axis=1)]
        spread = math.hypot(sd, math.sqrt(self.points[interpolated, tip, 1:].var(axis=0).sum()))
        if math.sqrt(np.sum(errors**2) / max(1, len(errors))) <= MAX_INTERPOLATION_ERROR * spread:
            return self
        return self.simulate_some(interpolated, simulate)


def draw_depth_errors(insertion: Insertion, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return errors of the entry (B,), and of the boundaries in the order met (B, MAX_DRAWN_LAYERS), mm."""
    whole = float(np.hypot(*split_boundary_sd(insertion)))
    deep = insertion.depth_sd * rng.standard_normal(count)
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


class DrawSimulation:
    """The needles of B sets of values at beam coordinates `s` (K,), through the layers that each meets.

    `deep`, `wrong`: from `draw_depth_errors`. Nothing of the measured shape is used. What all sets have in
    common is computed once, the needle of a set when it is first asked for. Between sets that differ in
    `hidden` parameters alone, which hardly move a needle, nothing is interpolated.
    """

    def __init__(
        self,
        sets: Sets,
        medium: MediumRecord,
        insertion: Insertion,
        s: Floats,
        deep: Floats,
        wrong: Floats,
        jobs: int = 1,
        hidden: Collection[str] = (),
    ) -> None:
        self._coordinates = make_coordinates(sets, hidden)
        self._sets, self._medium, self._insertion = sets, medium, insertion
        self._s, self._deep, self._wrong, self._jobs = s, deep, wrong, jobs
        self._table: _SurfaceTable | None = None
        self._draws: _InterpolatedDraws | None = None  # None where each draw is simulated by itself
        self._prepare()

    def _prepare(self) -> None:
        insertion, sets = self._insertion, self._sets
        stations = np.concatenate([np.linspace(0.0, insertion.depth, PATH_POINTS), self._s])
        some: Sets = [sets[n] for n in choose_draws(self._coordinates)]
        table = _tabulate_surfaces(insertion, 0.0, 0.0)
        if table is None or max(table.sequence) > self._medium.layers:
            return
        straight = replace(insertion, boundaries=table.depths[len(table.y) // 2], sequence=table.sequence)
        (paths,), _ = self._simulate(some, [(straight, stations)])
        if insertion.surfaces:
            # the few draws beyond are taken to cross where the outermost parallel does
            low, high = np.nanquantile(paths[..., 1], OUTERMOST)
            table = _tabulate_surfaces(insertion, float(low), float(high))
            count = 0 if table is None else min(len(table.sequence), len(straight.sequence))
            if table is None or table.sequence[:count] != straight.sequence[:count]:
                return
        crossed = table.find_crossings(paths[:, :PATH_POINTS])  # (C, n - 1) of the chosen draws
        errors = self._wrong[:, : crossed.shape[1]]
        met = np.nanmin(crossed, axis=0) + np.min(errors, axis=0) < insertion.depth + TABLE_MARGIN_MM
        self._table = table.keep(met)
        sequence = self._table.sequence
        crossed, errors = (part[:, : len(sequence) - 1] for part in (crossed, errors))
        centre = replace(straight, boundaries=np.nanmedian(crossed, axis=0), sequence=sequence)
        spread = np.hypot(np.nanstd(crossed, axis=0), np.std(errors, axis=0))
        self._reach, self._centre = np.maximum(NODE_SD * spread, MIN_NODE_MM), centre

        def move(which: Sets, moves: Sequence[tuple[Floats, float]]) -> tuple[Floats, Bools]:
            return self._simulate(which, [shift_depths(centre, stations, *move) for move in moves])

        self._draws = _InterpolatedDraws(sets, self._coordinates, move, self._reach, insertion.depth_sd)

    def _simulate(self, which: Sets, nodes: Sequence[tuple[Insertion, Floats]]) -> tuple[Floats, Bools]:
        """Return the points (m, B, K, 2) at some nodes, and the validity (B,) at the first."""
        shapes = PreparedModel(self._medium, [insertion for insertion, _ in nodes]).simulate(
            which, self._jobs
        )
        pairs = zip(nodes, shapes, strict=True)
        return np.array([compute_batch_positions(shape, s) for (_, s), shape in pairs]), shapes[0].valid

    def simulate(self, sd: float = 0.0) -> DrawnNeedles:
        """Return the needles of all sets; `sd` is the deviation of a measured tip from one, mm."""
        if self._draws is None or self._draws.needles is None or self._table is None:
            return self.simulate_each(np.arange(len(self._sets)))
        whole, deep = self._draws.needles, self._deep
        shifts, still = np.zeros((len(deep), len(self._reach))), np.zeros(len(deep))
        path = whole.take(slice(None, PATH_POINTS))
        for _ in range(CROSSING_ROUNDS if self._insertion.surfaces else 0):
            shifts = self._table.find_crossings(path.at(shifts, still)) - self._centre.boundaries
        shifts = shifts + self._wrong[:, : len(self._reach)]

        def simulate(rows: Ints) -> DrawnNeedles:
            moved = [shift_depths(self._centre, self._s, shifts[n] + deep[n], deep[n]) for n in rows]
            return _join(
                [self._simulate_one(n, *placed) for n, placed in zip(rows.tolist(), moved, strict=True)]
            )

        points = slice(PATH_POINTS, None)
        return self._draws.read(points, shifts, deep, simulate, int(np.argmax(self._s)), sd)

    def simulate_each(self, rows: Ints) -> DrawnNeedles:
        """Return the needles of some sets, each simulated by itself through its own layers."""
        needles: list[tuple[Floats, bool]] = []
        for row in rows:
            values, entry = self._sets[row], float(self._deep[row])
            met = with_planned_layers(self._insertion, values, self._medium)
            if met is None:
                needles.append((np.full((len(self._s), 3), np.nan), False))
            else:
                wrong = entry + self._wrong[row, : len(met.boundaries)]
                needles.append(self._simulate_one(row, *shift_depths(met, self._s, wrong, entry)))
        return _join(needles)

    def _simulate_one(self, row: int, insertion: Insertion, s: Floats) -> tuple[Floats, bool]:
        """Return the points (K, 3) of the needle of a set at beam coordinates (K,), and its validity."""
        shape = predict(self._sets[row], self._medium, insertion)
        return read_points(insertion, shape, s), shape.valid


def _join(needles: Sequence[tuple[Floats, bool]]) -> DrawnNeedles:
    points, valid = zip(*needles, strict=True)
    return DrawnNeedles(np.array(points), np.array(valid))


def simulate_scene_draws(
    sets: Sets,
    medium: MediumRecord,
    scene: Scene,
    s: Floats,
    deep: Floats,
    wrong: Floats,
    hidden: Collection[str] = (),
) -> DrawnNeedles:
    """Return the needles of B sets of values in a scene, at arc lengths `s` (K,), mm.

    `deep` (B,) are the errors of the entry, `wrong` (B, n - 1) those of the layers' depths, mm; `hidden` as
    of `DrawSimulation`.
    """
    layers = range(1, scene.tissue.layers + 1)

    def move(which: Sets, moves: Sequence[tuple[Floats, float]]) -> tuple[Floats, Bools]:
        given, batches = stack_values(tabulate_sets(which), medium, layers), []
        for shifts, deeper in moves:
            boundaries = enforce_order(scene.tissue.boundaries + shifts)
            tissue = make_tissue(which[0], layers, boundaries, medium)
            steps = tuple(replace(step, depth=step.depth + deeper) for step in scene.steps)
            batches.append(Batch(scene.needle, tissue, steps, scene.rules, **given))

        def read(number: int, shapes: NeedleShapes, rows: slice) -> tuple[Floats, Bools]:
            return compute_batch_positions(shapes, s + moves[number][1]), shapes.valid

        curves = read_batches(batches, lambda some: simulate_batches(some, 1), read)
        points, valid = zip(*curves, strict=True)
        return np.array(points), valid[0]

    reach = np.maximum(NODE_SD * np.std(wrong, axis=0), MIN_NODE_MM)
    draws = _InterpolatedDraws(sets, make_coordinates(sets, hidden), move, reach, float(np.std(deep)))

    def simulate(some: Ints) -> DrawnNeedles:
        needles = [move([sets[n]], [(wrong[n] + deep[n], float(deep[n]))]) for n in some]
        points, valid = zip(*needles, strict=True)
        return DrawnNeedles(np.concatenate([point[0] for point in points]), np.concatenate(valid))

    if draws.needles is None:
        return simulate(np.arange(len(sets)))
    return draws.read(slice(None), wrong, deep, simulate, len(s) - 1, 0.0)


class _InterpolatedDraws:
    """The needles of B sets of values at the middle of all depths, and how they change with these.

    `coordinates` are those of `make_coordinates`, `reach` (n - 1,) typical shifts of the boundaries, mm, and
    `depth_sd` the deviation of the entry.
    """

    def __init__(self, sets: Sets, coordinates: Floats, move: Move, reach: Floats, depth_sd: float) -> None:
        entry = max(NODE_SD * depth_sd, MIN_NODE_MM) if depth_sd > 0 else 0.0
        chosen, middle = choose_draws(coordinates), (np.zeros(len(reach)), 0.0)
        moves = [(row, 0.0) for row in np.diag(reach)]
        moves += [(np.full(len(reach), entry), entry)] if entry else []
        nodes = [(place * shifts, place * deep) for shifts, deep in moves for place in NODE_PLACES]
        at_nodes, valid = move([sets[n] for n in chosen], [middle, *nodes])  # (1 + 2 d, C, K, 3)
        steps = (at_nodes[1:] - at_nodes[0]).swapaxes(0, 1).reshape(len(chosen), -1)
        interpolate = interpolate_draws(coordinates, chosen, steps)
        #: the needles of all sets; None if too few have a solution at the nodes
        self.needles: _Interpolation | None = None
        self.valid = np.zeros(len(sets), dtype=np.bool_)
        if interpolate is None:
            return
        points = np.empty((len(sets), *at_nodes.shape[2:]))
        points[chosen], self.valid[chosen] = at_nodes[0], valid
        others = np.delete(np.arange(len(sets)), chosen)
        if len(others):
            (points[others],), self.valid[others] = move([sets[n] for n in others.tolist()], [middle])
        steps = interpolate(coordinates).reshape(len(sets), -1, *points.shape[1:])
        self.needles = _Interpolation(points, steps, np.append(reach, entry) if entry else reach)

    def read(
        self,
        points: slice,
        shifts: Floats,
        deep: Floats,
        simulate: Callable[[Ints], DrawnNeedles],
        tip: int,
        sd: float,
    ) -> DrawnNeedles:
        """Return some points of all needles, boundaries shifted by (B, n - 1) and the entry by (B,), mm.

        Those whose depths lie beyond the nodes are simulated; `simulate`, `tip`, `sd` as of
        `DrawnNeedles.check`.
        """
        assert self.needles is not None
        part = self.needles.take(points)
        needles = DrawnNeedles(part.at(shifts, deep), self.valid)
        near, solved = part.is_near(shifts, deep), needles.solved
        needles = needles.simulate_some(np.flatnonzero(solved & ~near), simulate)
        return needles.check(np.flatnonzero(solved & near), simulate, tip, sd)


def make_coordinates(sets: Sets, hidden: Collection[str] = ()) -> Floats:
    """Return what differs between sets of values, (B, P): ln of positive parameters, on principal axes.

    Without `hidden` parameters.
    """
    table = np.array([[value for name, value in values.items() if name not in hidden] for values in sets])
    finite = np.isfinite(table).all(axis=1)
    if not finite.any():
        return np.empty((len(table), 0))
    table[~finite] = table[finite][0]  # their needles have no solution, whatever their depths
    positive = (table > 0).all(axis=0)
    table[:, positive] = np.log(table[:, positive])
    left, sizes, _ = np.linalg.svd(table - table.mean(axis=0), full_matrices=False)
    return (left * sizes)[:, sizes > SAME_DRAW * np.sqrt(len(table))]


def choose_draws(coordinates: Floats) -> Ints:
    """Return up to `NODE_DRAWS` draws that differ, (C,): evenly spaced in their order, then the farthest."""
    _, first = np.unique((coordinates / SAME_DRAW).round(), axis=0, return_index=True)
    different = np.sort(first)
    if len(different) <= NODE_DRAWS:
        return different
    evenly = np.linspace(0, len(different) - 1, NODE_DRAWS - FAR_DRAWS).round().astype(np.int64)
    chosen = list(different[evenly])
    nearest = cdist(coordinates, coordinates[chosen]).min(axis=1)
    for _ in range(FAR_DRAWS):
        chosen.append(np.argmax(nearest))
        nearest = np.minimum(nearest, np.linalg.norm(coordinates - coordinates[chosen[-1]], axis=1))
    return np.sort(chosen)


def interpolate_draws(coordinates: Floats, chosen: Ints, points: Floats) -> Callable[[Floats], Floats] | None:
    """Return a function of coordinates (N, P) that gives values (N, F), known (C, F) at chosen draws.

    None if too few are finite.
    """
    solved = np.isfinite(points).all(axis=1)
    if np.sum(solved) <= coordinates.shape[1]:  # not even a plane through them
        return None
    if not (coordinates.shape[1] and points.shape[1]):
        return lambda places: np.broadcast_to(points[solved][:1], (len(places), points.shape[1]))
    # cubic: with 96 of 1000 draws it errs less than a thin plate, or a quadratic regression
    return interpolate_points(coordinates[chosen[solved]], points[solved], 3)


@dataclass(frozen=True)
class _SurfaceTable:
    """Depths (T, n - 1) at which T parallels to the entry axis, at `y` (T,), cross surfaces, and n layers."""

    y: Floats
    depths: Floats
    sequence: tuple[int, ...]

    def keep(self, met: Bools) -> "_SurfaceTable":
        """Return the table of the first surfaces alone, those that are met (n - 1,)."""
        count = int(np.sum(np.cumprod(met)))
        return _SurfaceTable(self.y, self.depths[:, :count], self.sequence[: count + 1])

    def find_crossings(self, paths: Floats) -> Floats:
        """Return the depths (B, n - 1) at which paths (B, P, 2) cross; of the parallel if they end before."""
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
    if not insertion.surfaces:
        return _SurfaceTable(np.zeros(1), insertion.boundaries[None], insertion.sequence)
    y = np.linspace(low - TABLE_MARGIN_MM, high + TABLE_MARGIN_MM, TABLE_POINTS)
    tables = []
    for height in y:
        local = np.array([[0.0, height, 0.0], [insertion.depth + BEYOND_TIP_MM, height, 0.0]])
        tables.append(find_layers(insertion.frame.to_world(local), insertion.frame, insertion.surfaces))
    count = min(len(depths) for depths, _ in tables)
    sequences = {sequence[: count + 1] for _, sequence in tables}
    # a further surface that some parallels do not meet must be one that no needle reaches
    near = any(np.any(depths[count:] < insertion.depth + TABLE_MARGIN_MM) for depths, _ in tables)
    if len(sequences) > 1 or near:
        return None
    return _SurfaceTable(y, np.array([depths[:count] for depths, _ in tables]), sequences.pop())


@dataclass(frozen=True)
class _Interpolation:
    """Needles (B, K, 2) at the middle of all depths, and between the nodes about it.

    `steps` (B, 2 d, K, 2) lead to the needles at `NODE_PLACES` of each of d axes, whose units are `reach`
    (d,), mm.
    """

    points: Floats
    steps: Floats
    reach: Floats

    def take(self, points: slice) -> "_Interpolation":
        steps = np.ascontiguousarray(self.steps[:, :, points])
        return replace(self, points=self.points[:, points], steps=steps)

    def at(self, shifts: Floats, deep: Floats) -> Floats:
        """Return the points (B, K, 2) with boundaries shifted by (B, n - 1) and the entry by (B,), mm.

        Between the nodes of each depth is a natural cubic spline, beyond them a line: its cubic would run
        away.
        """
        t = self._measure(shifts, deep).ravel()  # (B d,)
        low, high = NODE_PLACES
        spline = CubicSpline((low, 0.0, high), np.eye(3), bc_type="natural")
        held = np.clip(t, low, high)
        weights = (spline(held) + spline(held, 1) * (t - held)[:, None])[:, [0, 2]]  # the middle's step is 0
        count, nodes = self.steps.shape[:2]  # no nodes where no depth is open
        steps = weights.reshape(count, 1, nodes) @ self.steps.reshape(count, nodes, self.points[0].size)
        return self.points + steps.reshape(self.points.shape)

    def is_near(self, shifts: Floats, deep: Floats) -> Bools:
        """Return which draws (B,) have no depth far beyond the nodes."""
        return np.asarray(np.abs(self._measure(shifts, deep)).max(axis=1, initial=0.0) <= MAX_NODE_DISTANCE)

    def _measure(self, shifts: Floats, deep: Floats) -> Floats:
        """Return the distances (B, d) of depths from their middle, in units of the nodes'."""
        return np.asarray(np.column_stack([shifts, deep])[:, : len(self.reach)] / self.reach)
