"""Run the forward model: parameter values and an insertion give a simulated needle and its derivatives.

Derivatives by theta are the mechanics' own, chained through logarithms and ties.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from needlefit.arrays import Bools, Floats, Ints
from needlefit.datasets.insertion import GUIDE_STILL_MM, Insertion, InsertionInputs
from needlefit.datasets.layers import compute_depths, find_layers
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.crossings import find_path_crossings
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.parameter_names import BEVEL_PARAMETERS, dimension, is_shape_parameter
from needlefit.inference.parameters import Parameters, make_tissue
from needlefit.mechanics.batch import (
    Batch,
    Jacobians,
    NeedleShapes,
    compute_batch_positions,
    linearize_batches,
    read_batches,
    simulate_batches,
)
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import MAX_TOLERANCE_MM
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.mechanics.simulate import find_last_shape
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import RulesRecord

if TYPE_CHECKING:
    import pandas as pd


def predict(values: Mapping[str, float], medium: MediumRecord, insertion: Insertion) -> NeedleShape:
    """Return the needle shape that the model predicts for one insertion, of which only needle, depth, bevel,
    guide and layers count.

    `values` are all parameters of the medium, ties resolved (Pa, mm).

    Raises ModelError if the needle does not reach the depth; a solve that fails is a value, `converged`.
    """
    return find_last_shape(*make_simulation_inputs(values, medium, insertion))


def make_simulation_inputs(
    values: Mapping[str, float], medium: MediumRecord, insertion: InsertionInputs
) -> tuple[Needle, Tissue, tuple[Step, ...], ModelOptions]:
    """Return the arguments of `simulate_steps` and `linearize_along` for one insertion.

    Both solve to `MAX_TOLERANCE_MM`, so that values and derivatives are of one state: searches compare them.
    """
    tissue = make_tissue(values, insertion.sequence, insertion.boundaries, medium)
    steps = _make_steps(values, insertion, medium)
    return insertion.needle, tissue, steps, make_options(medium, MAX_TOLERANCE_MM)


def stack_shape(table: Mapping[str, Any], law: str, sequence: Sequence[int]) -> Floats:
    """Return the shape parameters (B, p, n) of layers, from the values (B,) of each parameter."""
    rows = [[np.asarray(table[name]) for name in row] for row in LAWS[law].name_shape(sequence)]
    count = len(next(iter(table.values())))
    stacked = np.array(rows, dtype=np.float64).reshape(-1, len(sequence), count)
    return np.ascontiguousarray(np.moveaxis(stacked, -1, 0))


def tabulate_sets(sets: Sequence[Mapping[str, float]]) -> dict[str, Floats]:
    """Return the values (B,) of each parameter."""
    return {name: np.array([values[name] for values in sets]) for name in sets[0]}


def stack_values(
    table: Mapping[str, Floats], medium: MediumRecord, sequence: Sequence[int]
) -> dict[str, Floats]:
    """Return what sets of values, (B,) each, give a `Batch` into layers `sequence`."""
    drawn = select_layer_draws(table, sequence, medium.law)
    return drawn.stack(path_angle=medium.advance == "path_angle")


DEPTH_TOLERANCE_MM = 1e-9  #: difference (mm) below which two depths are one
#: smallest number of constraint points of a moved guide between two readings: they show where the tip stood
MIN_CONSTRAINT_POINTS = 2


def find_end(depth: float, spacing: float) -> float:
    """Return how deep an insertion is simulated, mm: to the constraint point at or beyond its last reading.

    Constraint points lie at whole multiples of their spacing, whatever the depths of the readings.
    """
    # the tolerance keeps rounding from adding one
    return spacing * math.ceil(depth / spacing - DEPTH_TOLERANCE_MM)


def share_simulations(insertions: Sequence[Insertion], spacing: float) -> tuple[Insertion, ...]:
    """Return of each insertion the one whose simulation it is read from.

    Those that are read on the way, of one needle into the same layers under a guide at rest, are one
    insertion, the deepest, that is read at different depths. Everything else is simulated for itself.

    Raises DataError if a moved guide's readings are too close: the tip is known at constraint points only.
    """
    deepest: dict[tuple[object, ...], Insertion] = {}
    keys = []
    for insertion in insertions:
        key = None
        if OBSERVATIONS[insertion.observation].on_the_way:
            if insertion.guided or any(depth for depth, _ in insertion.turns):
                _require_distance(insertion, MIN_CONSTRAINT_POINTS * spacing)
            else:
                layers = insertion.sequence, tuple(insertion.boundaries.tolist())
                key = insertion.needle, insertion.side, insertion.turns, insertion.bevel_factor, layers
                if insertion.depth > deepest.setdefault(key, insertion).depth:
                    deepest[key] = insertion
        keys.append(key)
    return tuple(
        insertion if key is None else deepest[key] for insertion, key in zip(insertions, keys, strict=True)
    )


def _require_distance(insertion: Insertion, least: float) -> None:
    nearest = float(np.diff(insertion.points[:, 0]).min())
    if nearest < least:
        raise DataError(
            f"run {insertion.id} has readings {nearest:.3g} mm apart while guide or bevel moves",
            expected=f"{least:g} mm or more, {MIN_CONSTRAINT_POINTS} times the model's constraint spacing",
            fix="leave readings out, or lessen constraint_spacing_mm of the medium (b is then another)",
        )


_Known = TypeVar("_Known")  #: shapes, or shapes and their derivatives


class PreparedModel:
    """The forward model of some insertions, of which what does not depend on the values is computed once.

    What B sets of values give does not depend on their number, nor on the number of threads. Insertions that
    are read from the same simulation are simulated once, and those that differ in their bevel alone together.

    Raises DataError if a moved guide's readings are too close: see `share_simulations`.
    """

    def __init__(self, medium: MediumRecord, insertions: Sequence[Insertion]) -> None:
        self._medium = medium
        self._places: list[tuple[_Simulation, int]] = []  # of each insertion, and the number of its bevel
        simulations: dict[tuple[int, ...], _Simulation] = {}
        for shared in share_simulations(insertions, medium.constraint_spacing_mm):
            # the parts of an insertion that was changed in its bevel alone are the same objects
            parts = (part.name for part in fields(shared) if part.name != "bevel_factor")
            key = tuple(id(getattr(shared, name)) for name in parts)
            if key not in simulations:
                simulations[key] = _Simulation(replace(shared, bevel_factor=1.0), [])
            factors = simulations[key].factors
            if shared.bevel_factor not in factors:
                factors.append(shared.bevel_factor)
            self._places.append((simulations[key], factors.index(shared.bevel_factor)))
        self._simulations = tuple(simulations.values())

    def simulate(self, sets: Sequence[Mapping[str, float]], jobs: int = 1) -> list[NeedleShapes]:
        """Return the shapes of B sets of values in each insertion."""
        # all go into one call, so that threads stay busy
        shapes = dict(zip(self._simulations, simulate_batches(self._make_batches(sets), jobs), strict=True))
        return [
            shapes[number].take(slice(row * len(sets), (row + 1) * len(sets))) for number, row in self._places
        ]

    def read_points(
        self, sets: Sequence[Mapping[str, float]], s: Sequence[Floats], jobs: int = 1
    ) -> Iterator[Floats]:
        """Return, one by one, `read_points` (B, K, 2) of each insertion at its `s` (K,), mm."""

        def read(simulation: _Simulation, shapes: NeedleShapes, places: Floats, rows: slice) -> tuple[Floats]:
            return (OBSERVATIONS[simulation.insertion.observation].read_batch_points(shapes, places),)

        read_values = self._read(sets, s, lambda batches: simulate_batches(batches, jobs), read)
        return (points for (points,) in read_values)

    def read_needles(
        self, sets: Sequence[Mapping[str, float]], s: Sequence[Floats], jobs: int = 1
    ) -> Iterator[tuple[Floats, Bools]]:
        """Return, one by one, the points (B, K, 3) in C of the needles in each insertion at its `s` (K,), mm.

        And which of the needles (B,) are outside the model's validity. Where the solve failed points are NaN.
        """

        def read(
            simulation: _Simulation, shapes: NeedleShapes, places: Floats, rows: slice
        ) -> tuple[Floats, Bools]:
            return compute_batch_positions(shapes, places), shapes.converged & ~shapes.validity.ok

        needles = self._read(sets, s, lambda batches: simulate_batches(batches, jobs), read)
        return ((points, outside) for points, outside in needles)

    def differentiate(
        self, sets: Sequence[Mapping[str, float]], parameters: Parameters, s: Sequence[Floats], jobs: int = 1
    ) -> Iterator[tuple[Floats, Floats]]:
        """Return, one by one, `read_points` of each insertion, and the derivatives (B, K, 2, P) by theta."""
        moving = [name for name in parameters.names if name not in parameters.fixed]
        starts = (("mu", "mu"), ("bevel", "offset"), ("cut", "cut_angle"), ("guide", "guides"))
        kinds = [kind for start, kind in starts if any(name.startswith(start) for name in moving)]
        kinds += ["shape"] * any(map(is_shape_parameter, moving))
        tracked = any(
            OBSERVATIONS[simulation.insertion.observation].on_the_way for simulation in self._simulations
        )
        slopes_of_sets = [parameters.slopes(values) for values in sets]
        slopes = {
            name: np.array([slopes_of_set[name] for slopes_of_set in slopes_of_sets])
            for name in slopes_of_sets[0]
        }  # (B, P) each
        chained: dict[object, Floats] = {}

        def read(
            simulation: _Simulation, solved: tuple[NeedleShapes, Jacobians], places: Floats, rows: slice
        ) -> tuple[Floats, Floats]:
            (shapes, jacobians), kind = solved, OBSERVATIONS[simulation.insertion.observation]
            by = kind.read_batch_derivatives(shapes, jacobians, places)  # (some of F B, K, 2 or 3, Q)
            key = simulation.layers, jacobians.names
            if key not in chained:
                chained[key] = simulation.chain(slopes, parameters, jacobians.names)
            by_theta = chained[key][rows]
            moves = by.reshape(len(by), math.prod(by.shape[1:3]), by.shape[-1]) @ by_theta
            moves[~shapes.converged] = np.nan
            moves = moves.reshape(*by.shape[:3], by_theta.shape[-1])
            return kind.read_batch_points(shapes, places), moves

        def run(batches: list[Batch]) -> tuple[tuple[NeedleShapes, Jacobians], ...]:
            return linearize_batches(batches, kinds, jobs, tracked=tracked)

        return ((points, moves) for points, moves in self._read(sets, s, run, read))

    def _make_batches(self, sets: Sequence[Mapping[str, float]]) -> list[Batch]:
        table = tabulate_sets(sets)
        # the same arrays serve all insertions that meet the same layers: the mechanics pack them once
        different = {simulation.layers: simulation for simulation in self._simulations}
        stacked = {key: difference.stack_sets(table, self._medium) for key, difference in different.items()}
        return [
            simulation.make_batch(sets[0], stacked[simulation.layers], self._medium)
            for simulation in self._simulations
        ]

    def _read(
        self,
        sets: Sequence[Mapping[str, float]],
        s: Sequence[Floats],
        run: Callable[[list[Batch]], tuple[_Known, ...]],
        read: "Callable[[_Simulation, _Known, Floats, slice], tuple[np.ndarray, ...]]",
    ) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield what `read` gives of every insertion, (B, ...) each, from what `run` gives of its needles.

        Equal ones are read once. `read` is given some of the needles of a simulation at a time.
        """
        keys = [(number, places.tobytes()) for (number, _), places in zip(self._places, s, strict=True)]
        wanted: dict[_Simulation, dict[bytes, Floats]] = {simulation: {} for simulation in self._simulations}
        for (insertion, place), places in zip(keys, s, strict=True):
            wanted[insertion][place] = places
        left, kept = Counter(keys), dict[tuple[_Simulation, bytes], tuple[np.ndarray, ...]]()
        count = len(sets)

        def read_places(number: int, solved: _Known, rows: slice) -> tuple[np.ndarray, ...]:
            simulation = self._simulations[number]
            return tuple(
                part
                for place in wanted[simulation].values()
                for part in read(simulation, solved, place, rows)
            )

        read_values = zip(
            self._simulations, read_batches(self._make_batches(sets), run, read_places), strict=True
        )
        for key, (_, row) in zip(keys, self._places, strict=True):
            while key not in kept:  # simulations stand in the order in which they are first read
                insertion, parts = next(read_values)
                size = len(parts) // len(wanted[insertion])
                for n, place in enumerate(wanted[insertion]):
                    kept[insertion, place] = parts[n * size : (n + 1) * size]
            yield tuple(part[row * count : (row + 1) * count] for part in kept[key])
            left[key] -= 1
            if not left[key]:
                del kept[key]


def make_batch(
    table: Mapping[str, Floats], medium: MediumRecord, insertion: Insertion, boundaries: Floats
) -> Batch:
    """Return an insertion with B values of each parameter, (B,), and boundaries (B, n - 1), mm.

    It is solved to the usual tolerance: nothing is differentiated.
    """
    simulation = _Simulation(replace(insertion, bevel_factor=1.0), [insertion.bevel_factor])
    stacked = simulation.stack_sets(table, medium)
    first = {name: float(column[0]) for name, column in table.items()}
    needle, tissue, steps, _ = make_simulation_inputs(first, medium, simulation.insertion)
    return Batch(needle, tissue, steps, make_options(medium), boundaries=boundaries, **stacked)


#: fraction of the guide's moves by which they are changed to simulate their effect, which is linear
GAIN_STEP = 0.1


def scale_moves(insertion: Insertion, factor: float) -> Iterator[Insertion]:
    """Yield an insertion with each move of its guide, from one depth to the next, `factor` times as far."""
    guide = insertion.guide
    assert guide is not None
    for step in np.flatnonzero(np.hypot(np.diff(guide.y), np.diff(guide.z)) > GUIDE_STILL_MM):
        after = (factor - 1) * (np.arange(len(guide.depths)) > step)
        y, z = (moves + after * (moves[step + 1] - moves[step]) for moves in (guide.y, guide.z))
        yield replace(insertion, guide=replace(guide, y=y, z=z))


def respond_to_moves(
    values: Mapping[str, float], medium: MediumRecord, insertion: Insertion, s: Floats
) -> Floats:
    """Return how the points read at `s` (K,) change with the gain of each of M moves: (M, K, 3), mm.

    Raises ConfigError where the model has no needle.
    """
    moved = [insertion, *scale_moves(insertion, 1 + GAIN_STEP)]
    points = np.concatenate([*PreparedModel(medium, moved).read_points([values], [s] * len(moved))])
    responses: Floats = (points[1:] - points[0]) / GAIN_STEP
    if not np.isfinite(responses).all():
        raise ConfigError(
            f"the expected parameters have no needle in {insertion.id}",
            fix="state a prior, or narrow the bounds",
            key="parameters",
        )
    return responses


@dataclass(eq=False)
class _Simulation:
    """One insertion with F bevels: a batch of F B sets, bevel by bevel."""

    insertion: Insertion
    factors: list[float]
    _batch: Batch | None = None

    @cached_property
    def layers(self) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """The layers that it meets and the factors of its bevels: all that its sets depend on."""
        return self.insertion.sequence, tuple(self.factors)

    def stack_sets(self, table: Mapping[str, Floats], medium: MediumRecord) -> dict[str, Floats]:
        """Return what B sets of values, given as (B,) of each parameter, give a `Batch` of F B sets."""
        name, count = medium.bevel_parameter, len(self.factors)
        values = {key: np.tile(array, count) for key, array in table.items()} if count > 1 else dict(table)
        values[name] = np.concatenate([factor * table[name] for factor in self.factors])
        guide = values.get("guide_distance_mm")
        stacked = stack_values(values, medium, self.insertion.sequence)
        return stacked if guide is None else stacked | {"guide_x": -guide}

    def make_batch(self, first: Mapping[str, float], sets: dict[str, Any], medium: MediumRecord) -> Batch:
        """Return the batch of what `stack_sets` gave; `first` are the values of one set."""
        if self._batch is None:
            self._batch = Batch(*make_simulation_inputs(first, medium, self.insertion), **sets)
            return self._batch
        return self._batch.with_sets(**sets)

    def chain(self, slopes: Mapping[str, Floats], parameters: Parameters, names: Sequence[str]) -> Floats:
        """Return the derivatives (F B, Q, P) by theta of the Q parameters that mechanics differentiate by.

        `slopes` (B, P) are those of the values.
        """
        sets, free = next(iter(slopes.values())).shape
        bevels = {
            name: np.multiply.outer(self.factors, slopes[name]) for name in BEVEL_PARAMETERS if name in slopes
        }
        slopes = {**slopes, **bevels}
        nothing = np.zeros(free)
        rows = dict.fromkeys(("guide1_y", "guide1_slope", "guide1_z", "guide1_slope_z"), nothing)
        rows["offset"] = slopes.get("bevel_mm", nothing)
        rows["cut_angle"] = math.radians(1.0) * slopes.get("cut_angle_deg", nothing)
        # the guide stands before the entry, at x = -guide_distance, hence the sign
        rows["guide1_x"] = -slopes.get("guide_distance_mm", nothing)
        # the mechanics number intervals along the path; a layer that is met twice gets both derivatives
        shape = {dimension(name) for name in parameters.names if is_shape_parameter(name)}
        for interval, layer in enumerate(self.insertion.sequence, start=1):
            rows[f"mu{interval}"] = 1e-6 * slopes[f"mu{layer}_pa"]
            rows |= {f"{kind}{interval}": slopes[f"{kind}{layer}"] for kind in shape}
        chained = np.empty((len(self.factors), sets, len(names), free))
        for q, name in enumerate(names):
            chained[:, :, q] = rows[name]
        return chained.reshape(len(self.factors) * sets, len(names), free)


def _make_steps(
    values: Mapping[str, float], insertion: InsertionInputs, medium: MediumRecord
) -> tuple[Step, ...]:
    """Return the insertion, and behind it the base's move, if there was one.

    Under a guide that may move they are the way to each of its places, the last one on to a constraint
    point. Without a guide on the insertion axis the needle is held by its base alone.
    """
    strength, bevel = insertion.bevel_factor * values[medium.bevel_parameter], Bevel(side=insertion.side)
    if medium.advance == "path_angle":
        bevel = replace(bevel, cut_angle=math.radians(strength))
    else:
        bevel = replace(bevel, offset=strength)
    distance = values.get("guide_distance_mm", insertion.guide_distance)
    controls = Controls() if distance is None else Controls(guides=(Guide(-distance),))
    if (guide := insertion.guide) is not None:
        end = find_end(insertion.depth, medium.constraint_spacing_mm)
        starts = guide.depths[:-1].tolist()
        bevels = [replace(bevel, roll_deg=_find_roll(insertion.turns, depth)) for depth in starts]
        if not guide.moved and len({bevel.roll_deg for bevel in bevels}) == 1:
            return (Step(end, bevels[0], controls),)
        held = [controls] * len(bevels)
        if guide.moved:
            places = zip(guide.y[1:].tolist(), guide.z[1:].tolist(), strict=True)
            held = [Controls(guides=(Guide(-values["guide_distance_mm"], y, z=z),)) for y, z in places]
        return tuple(map(Step, [*starts[1:], end], bevels, held))
    turned = [(0.0, 0.0), *(turn for turn in insertion.turns if turn[0] < insertion.depth)]
    stops = [*(depth for depth, _ in turned[1:]), insertion.depth]
    steps = [
        Step(end, replace(bevel, roll_deg=roll), controls)
        for end, (_, roll) in zip(stops, turned, strict=True)
    ]
    if insertion.base_moved:
        steps.append(replace(steps[-1], controls=replace(controls, base_y=insertion.base_moved)))
    return tuple(steps)


def _find_roll(turns: Sequence[tuple[float, float]], depth: float) -> float:
    """Return the roll of the bevel behind a depth (mm), degrees from that at first contact."""
    return next((roll for start, roll in reversed(turns) if start <= depth), 0.0)


def make_options(medium: MediumRecord, tolerance: float = ModelOptions.tolerance) -> ModelOptions:
    """Return a medium's model options, with a mesh size of at most 1 mm that divides its spacing."""
    return replace(ModelOptions.from_record(make_rules(medium)), tolerance=tolerance)


def make_rules(medium: MediumRecord, tolerance_mm: float | None = None) -> RulesRecord:
    """Return the rules of a scene that a medium states."""
    return RulesRecord(
        tolerance_mm=tolerance_mm,
        constraint_spacing_mm=medium.constraint_spacing_mm,
        constraint_switch=medium.constraint_switch,
        tangent_part=medium.tangent_part,
        first_cell_mm=medium.first_cell_mm,
        advance=medium.advance,
    )


@dataclass(frozen=True)
class ParameterDraws:
    """Posterior draws of the parameters of the layers that one insertion meets."""

    mu: Floats  #: (B, n) of the n layers that it meets, MPa
    shape: Floats  #: (B, p, n) shape parameters of the law
    bevel: Floats  #: (B,) b, mm; of an advance by the path angle theta, rad
    # of this insertion:
    gain: Floats | None = None  #: (B,) part of each move of the base that reaches the needle; None: 1
    carried: Floats | None = None  #: (B,) share of the base's displacement that the tissue follows; None: 0
    slope: Floats | None = None  #: (B,) dy/dx of the axis in C; None: 0

    def __len__(self) -> int:
        return len(self.bevel)

    @classmethod
    def exact(cls, tissue: Tissue, bevel: Bevel, rules: ModelOptions) -> Self:
        """Return the one draw of parameters that are taken as exact."""
        strength, _ = rules.bevel_strength(bevel)
        return cls(tissue.mu[None], tissue.shape[None], np.array([strength]))

    def only(self, rows: Ints) -> Self:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: part[rows] for name, part in given.items() if part is not None})

    @property
    def bending(self) -> Floats:
        """The part (B,) of each move of the base that bends the needle: less where the tissue follows."""
        gain = np.ones(len(self)) if self.gain is None else self.gain
        return gain if self.carried is None else gain - self.carried

    def find_points(self, shapes: NeedleShapes, s: Floats, steps: Sequence[Step]) -> Floats:
        """Return points (B, K, 3) of needles at beam coordinates `s` (K,), mm, at the end of steps, in C."""
        points = compute_batch_positions(shapes, s)
        if self.slope is not None:
            points[..., 1] += self.slope[:, None] * points[..., 0]
        if self.carried is not None:
            moved = steps[-1].controls.base_y - steps[0].controls.base_y
            points[..., 1] += moved * self.carried[:, None]
        return points

    def stack(self, *, path_angle: bool) -> dict[str, Floats]:
        """Return moduli, shape parameters and bevels by their names in a `Batch`."""
        return {"mu": self.mu, "shape": self.shape, "cut_angle" if path_angle else "offset": self.bevel}

    def make_batch(
        self, needle: Needle, tissue: Tissue, steps: tuple[Step, ...], rules: ModelOptions
    ) -> Batch:
        """Return the insertion of every draw, with its moduli, shape parameters, bevels and gains."""
        given = self.stack(path_angle=rules.path_angle)
        return Batch(needle, tissue, steps, rules, gain=self.bending, **given)


def select_layer_draws(
    draws: "Mapping[str, Floats] | pd.DataFrame", layers: Sequence[int], law: str
) -> ParameterDraws:
    """Return draws (one column per parameter; Pa, mm) of a law, arranged by the layers that a needle meets.

    `layers` are their numbers, from 1, in the order in which they are met.
    """
    angles = draws.get("cut_angle_deg")
    return ParameterDraws(
        # files and theta hold Pa, the mechanics N and mm: 1 Pa = 1e-6 MPa
        mu=np.column_stack([draws[f"mu{layer}_pa"] * 1e-6 for layer in layers]),
        shape=stack_shape({str(name): column for name, column in draws.items()}, law, layers),
        bevel=np.asarray(draws["bevel_mm"] if angles is None else np.radians(angles), dtype=np.float64),
    )


# ---- the layers that a planned insertion meets
#
# The measured crossings of a held-out insertion already contain its outcome. A prediction starts from the
# straight planned path instead, and repeats the simulation with the crossings of the predicted, bent needle
# until they converge.

Layers = tuple[Floats, tuple[int, ...]]

CROSSING_TOLERANCE_MM = 1e-3  #: movement (mm) of crossings below which they stand still
MAX_ROUNDS = 30  #: largest number of rounds until crossings stand still
HALVED_ROUNDS = 10  #: number of rounds after which each moves crossings only half way
#: number of errors drawn for an insertion, so that a draw does not depend on the number of layers
MAX_DRAWN_LAYERS = 32


def with_planned_layers(
    insertion: Insertion, values: Mapping[str, float], medium: MediumRecord
) -> Insertion | None:
    """Return an insertion with the layers that `values` (Pa, mm) predict, not the measured ones.

    Of the insertion its depth, surfaces and frame are used. The frame is the entry pose and the bending
    plane, which comes from the bevel where the dataset states it, else from the shape. Layers that are stated
    as depths stay as they are.

    None where a solve fails, the crossings do not come to rest, or the needle leaves the medium.
    """
    if not insertion.surfaces:
        return insertion
    # the straight planned path; it uses nothing of the measured shape
    path = np.outer(np.linspace(0.0, insertion.depth, 101), (1.0, 0.0, 0.0))
    depths, sequence = _find_layers(path, insertion)
    for round_ in range(MAX_ROUNDS):
        inside = clip_layers(sequence, medium)
        shape = predict(values, medium, replace(insertion, boundaries=depths, sequence=inside))
        if not shape.converged:
            return None
        before = depths, sequence
        depths, sequence = _find_layers(sample_inserted_points(shape), insertion)
        if sequence != before[1]:
            continue
        if np.all(np.abs(depths - before[0]) < CROSSING_TOLERANCE_MM):
            return replace(insertion, boundaries=depths, sequence=sequence) if sequence == inside else None
        if round_ >= HALVED_ROUNDS:  # crossings can alternate between two states; half steps damp that
            depths = 0.5 * (depths + before[0])
    return None


def clip_layers(sequence: Iterable[int], medium: MediumRecord) -> tuple[int, ...]:
    """Return layers met on the way to those of a needle: beyond the medium its last one goes on."""
    return tuple(min(layer, medium.layers) for layer in sequence)


def _find_layers(curve: Floats, insertion: Insertion) -> Layers:
    """Return the layers that a curve (K, 3) in C meets."""
    return find_layers(insertion.frame.to_world(curve), insertion.frame, insertion.surfaces)


def find_path_layers(curves: Floats, insertion: Insertion) -> tuple[Floats, Ints]:
    """Return the depths (B, M), mm, at which curves (B, K, 3) in C cross surfaces, NaN behind the last.

    And the layers (B, M + 1) that they meet, 0 behind the last.
    """
    crossed = find_path_crossings(insertion.frame.to_world(curves), insertion.surfaces)
    return compute_depths(crossed.points, insertion.frame), crossed.layers
