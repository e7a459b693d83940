"""Run the forward model: parameter values and an insertion give a simulated needle and its derivatives.

Derivatives by theta are the mechanics' own, chained through logarithms and ties.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.inference.parameters import Parameters, make_tissue
from needlefit.inference.simulated_points import (
    find_end,
    read_batch_deflections,
    read_derivatives,
    read_points,
    share_simulations,
)
from needlefit.mechanics.batch import Batch, NeedleShapes
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.linearize import Jacobian, linearize_steps
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.prepared import MAX_TOLERANCE_MM
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import (
    Advance,
    BevelRecord,
    ControlsRecord,
    LayerRecord,
    NeedleRecord,
    RulesRecord,
    SceneRecord,
    StepRecord,
)

MAX_ELEMENT_MM = 1.0
"""Mesh size aimed at, mm; the mesh size used divides the constraint spacing."""


def predict(
    values: Mapping[str, float],
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    boundaries: Floats | None = None,
    sequence: Sequence[int] | None = None,
) -> NeedleShape:
    """Return the needle shape that the model predicts for one insertion.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    medium : MediumRecord
        Law, thickness and constraint spacing.
    insertion : Insertion
        Its depth, bevel side and guide; nothing of its measured shape but the boundaries is used.
    boundaries, sequence : (n - 1,) array and n layer numbers, optional
        The layers met instead of the measured ones, e.g. along the planned path.

    Raises
    ------
    ModelError
        If the needle does not reach the depth; a solve that fails is a value, `converged`.
    """
    return simulate_steps(*make_simulation_inputs(values, medium, needle, insertion, boundaries, sequence))


def make_simulation_inputs(
    values: Mapping[str, float],
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    boundaries: Floats | None = None,
    sequence: Sequence[int] | None = None,
) -> tuple[Needle, Tissue, tuple[Step, ...], ModelOptions]:
    """Return the arguments of `simulate_steps` and `linearize_along` for one insertion.

    Both solve to `MAX_TOLERANCE_MM`, so that values and derivatives are of one state: searches compare them.
    """
    layers = insertion.sequence if sequence is None else sequence
    depths = insertion.boundaries if boundaries is None else boundaries
    return (
        needle,
        make_tissue(values, layers, depths, medium),
        _make_steps(values, insertion, medium),
        make_options(medium, MAX_TOLERANCE_MM),
    )


def make_batch(
    sets: Sequence[Mapping[str, float]], medium: MediumRecord, needle: Needle, insertion: Insertion
) -> Batch:
    """Return a batch of one insertion with many parameter sets, for `simulate_batches`; see `predict`."""
    return _make_batch(sets[0], _tabulate_sets(sets), medium, needle, insertion)


def _tabulate_sets(sets: Sequence[Mapping[str, float]]) -> dict[str, Floats]:
    """Return the values (B,) of each parameter."""
    return {name: np.array([values[name] for values in sets]) for name in sets[0]}


def _make_batch(
    first: Mapping[str, float],
    table: Mapping[str, Floats],
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
) -> Batch:
    guide = table.get("guide_distance_mm")
    angle = medium.advance == "path_angle"
    strength = insertion.bevel_factor * table[medium.bevel_parameter]
    return Batch(
        needle,
        make_tissue(first, insertion.sequence, insertion.boundaries, medium),
        _make_steps(first, insertion, medium),
        make_options(medium),
        # files and theta hold Pa, the mechanics N and mm: 1 Pa = 1e-6 MPa
        mu=np.column_stack([table[f"mu{layer}_pa"] * 1e-6 for layer in insertion.sequence]),
        alpha=np.column_stack([table[f"alpha{layer}"] for layer in insertion.sequence]),
        offset=None if angle else strength,
        cut_angle=np.radians(strength) if angle else None,
        # the lanes prefer one place for all
        guide_x=None if guide is None or np.ptp(guide) == 0 else -guide,
    )


def simulate_deflections(
    sets: Sequence[Mapping[str, float]],
    medium: MediumRecord,
    needle: Needle,
    insertions: Sequence[Insertion],
    s: Sequence[Floats],
    jobs: int = 1,
) -> tuple[Floats, ...]:
    """Return the simulated deflections (B, K) of every insertion at its `s` (K,), mm, for B sets of values.

    Of a tip track they are the tips at depths `s`. NaN where a solve failed.
    """
    sources = share_simulations(insertions, medium.constraint_spacing_mm)
    shapes = simulate_each(sets, medium, needle, sources, jobs)
    trios = zip(sources, shapes, s, strict=True)
    return tuple(read_batch_deflections(*trio) for trio in trios)


def simulate_each(
    sets: Sequence[Mapping[str, float]],
    medium: MediumRecord,
    needle: Needle,
    insertions: Sequence[Insertion],
    jobs: int,
) -> list[NeedleShapes]:
    """Return the shapes of B sets of values in each insertion; one that is listed twice is simulated once."""
    different = {id(insertion): insertion for insertion in insertions}
    table = _tabulate_sets(sets)
    batches = [_make_batch(sets[0], table, medium, needle, one) for one in different.values()]
    # all go into one call, so that threads stay busy
    shapes = dict(zip(different, simulate_batches(batches, jobs), strict=True))
    return [shapes[id(insertion)] for insertion in insertions]


def _make_steps(values: Mapping[str, float], insertion: Insertion, medium: MediumRecord) -> tuple[Step, ...]:
    """Return the insertion, and behind it the base's move, if there was one."""
    bevel = make_bevel(values, medium, insertion.side, insertion.bevel_factor)
    if isinstance(insertion, TipTrack):
        return _make_track_steps(insertion, bevel, values["guide_distance_mm"], medium.constraint_spacing_mm)
    controls = _make_controls(values.get("guide_distance_mm", insertion.guide_distance))
    inserted = Step(insertion.depth, bevel, controls)
    if not insertion.base_moved:
        return (inserted,)
    return inserted, replace(inserted, controls=replace(controls, base_y=insertion.base_moved))


def make_bevel(
    values: Mapping[str, float], medium: MediumRecord, side: int = 1, factor: float = 1.0
) -> Bevel:
    """Return the bevel that a medium's parameters describe, `factor` times as strong."""
    strength = factor * values[medium.bevel_parameter]
    if medium.advance == "path_angle":
        return Bevel(side=side, cut_angle=math.radians(strength))
    return Bevel(strength, side)


def _make_track_steps(
    track: TipTrack, bevel: Bevel, guide_distance: float, spacing: float
) -> tuple[Step, ...]:
    """Return the way to each reading under the guide's place then, the last one on to a constraint point."""
    end = find_end(track, spacing)
    if not track.guided:
        return (Step(end, bevel, _make_controls(guide_distance)),)
    ends = [*track.depths[1:-1].tolist(), end]
    return tuple(
        Step(depth, bevel, Controls(guides=(Guide(-guide_distance, float(y)),)))
        for depth, y in zip(ends, track.guide[1:], strict=True)
    )


def _make_controls(guide_distance: float | None) -> Controls:
    """Return the controls of a needle clamped by a guide on the insertion axis, or held by its base alone."""
    return Controls() if guide_distance is None else Controls(guides=(Guide(-guide_distance),))


def make_options(medium: MediumRecord, tolerance: float = ModelOptions.tolerance) -> ModelOptions:
    """Return a medium's model options, with a mesh size of at most 1 mm that divides its spacing."""
    spacing, switch, tangent = medium.constraint_spacing_mm, medium.constraint_switch, medium.tangent_part
    return _make_options(spacing, tolerance, switch, tangent, medium.first_cell_mm, medium.advance)


@lru_cache(maxsize=64)  # a fit asks for the same ones over and over
def _make_options(
    spacing: float,
    tolerance: float,
    switch: float,
    tangent: float,
    first_cell: float | None,
    advance: Advance,
) -> ModelOptions:
    # 1e-9: a spacing that is a whole number of mm must not get one more element by rounding
    element = spacing / math.ceil(spacing / MAX_ELEMENT_MM - 1e-9)
    return ModelOptions(
        spacing, element, tolerance, switch=switch, tangent=tangent, first_cell=first_cell, advance=advance
    )


def predict_with_derivatives(
    values: Mapping[str, float],
    parameters: Parameters,
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    s: Floats,
) -> tuple[Floats, Floats]:
    """Return the simulated points (K, 2), mm, and their derivatives (K, 2, P) by theta; see `read_points`.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    s : (K,) array
        Beam coordinates of the points, mm.

    Returns
    -------
    (K, 2) and (K, 2, P) arrays
        NaN where the solve fails.

    Raises
    ------
    ModelError
        If the needle does not reach the depth.
    """
    return linearize_insertion(values, parameters, medium, needle, insertion).read(s)


@dataclass(frozen=True)
class LinearizedInsertion:
    """A simulated insertion and its derivatives.

    Attributes
    ----------
    by_theta : (Q, P) array
        Derivatives by theta of the Q parameters that `jacobian` differentiates by.
    """

    insertion: Insertion
    shape: NeedleShape
    jacobian: Jacobian
    by_theta: Floats

    def read(self, s: Floats) -> tuple[Floats, Floats]:
        """Return the points (K, 2) at `s` and their derivatives (K, 2, P); see `read_points`."""
        points = read_points(self.insertion, self.shape, s)
        if not self.shape.converged:
            return points, np.full((len(s), 2, self.by_theta.shape[1]), np.nan)
        return points, read_derivatives(self.insertion, self.shape, self.jacobian, s) @ self.by_theta


def linearize_insertion(
    values: Mapping[str, float],
    parameters: Parameters,
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    slopes: Mapping[str, Floats] | None = None,
) -> LinearizedInsertion:
    """Return the simulated insertion and its derivatives; see `predict_with_derivatives`.

    Parameters
    ----------
    slopes : mapping, optional
        `parameters.slopes(values)`, where it is used for many insertions.
    """
    by_parameter = _chain_rule(parameters.slopes(values) if slopes is None else slopes, parameters, insertion)
    shape, jacobian = linearize_steps(
        *make_simulation_inputs(values, medium, needle, insertion), wrt=_select_kinds(parameters)
    )
    rows = [by_parameter[name] for name in jacobian.names]
    by_theta = np.array(rows).reshape(len(rows), len(parameters.free))  # also where nothing is free
    return LinearizedInsertion(insertion, shape, jacobian, by_theta)


def _select_kinds(parameters: Parameters) -> tuple[str, ...]:
    """Return the kinds of the mechanics' parameters that theta moves."""
    return _find_kinds(tuple(name for name in parameters.names if name not in parameters.fixed))


@lru_cache(maxsize=64)
def _find_kinds(moving: tuple[str, ...]) -> tuple[str, ...]:
    starts = (
        ("mu", "mu"),
        ("alpha", "alpha"),
        ("bevel", "offset"),
        ("cut", "cut_angle"),
        ("guide", "guides"),
    )
    return tuple(kind for start, kind in starts if any(name.startswith(start) for name in moving))


def _chain_rule(
    slopes: Mapping[str, Floats], parameters: Parameters, insertion: Insertion
) -> dict[str, Floats]:
    """Return the derivatives (P,) by theta of what the mechanics differentiate by, by its name there."""
    nothing = np.zeros(len(parameters.free))
    found = {"guide1_y": nothing, "guide1_slope": nothing}
    found["offset"] = insertion.bevel_factor * slopes.get("bevel_mm", nothing)
    found["cut_angle"] = insertion.bevel_factor * math.radians(1.0) * slopes.get("cut_angle_deg", nothing)
    # the guide stands before the entry, at x = -guide_distance, hence the sign
    found["guide1_x"] = -slopes.get("guide_distance_mm", nothing)
    # the mechanics number intervals along the path; a layer that is met twice gets both derivatives
    for interval, layer in enumerate(insertion.sequence, start=1):
        found[f"mu{interval}"] = 1e-6 * slopes[f"mu{layer}_pa"]
        found[f"alpha{interval}"] = slopes[f"alpha{layer}"]
    return found


def make_scene_record(
    values: Mapping[str, float], medium: MediumRecord, dataset: Dataset, insertion: Insertion, title: str = ""
) -> SceneRecord:
    """Return a scene file's content that reproduces the prediction of one insertion, in C.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    """
    guide = values.get("guide_distance_mm", insertion.guide_distance)
    moved = insertion.base_moved
    return SceneRecord(
        schema_=SceneRecord.SCHEMA,
        title=title,
        depth_mm=None if moved else insertion.depth,
        law=medium.law,
        needle=_make_needle_record(dataset),
        layers=tuple(
            LayerRecord(
                name=f"layer {layer}",
                top_mm=top,
                mu_pa=values[f"mu{layer}_pa"],
                alpha=values[f"alpha{layer}"],
                thickness_mm=medium.thickness_mm,
            )
            for top, layer in find_layers(insertion)
        ),
        bevel=BevelRecord.model_validate(
            {
                medium.bevel_parameter.replace("bevel_mm", "offset_mm"): insertion.bevel_factor
                * values[medium.bevel_parameter],
                "side": 1 if insertion.side > 0 else -1,
            }
        ),
        rules=RulesRecord(
            constraint_spacing_mm=medium.constraint_spacing_mm,
            constraint_switch=medium.constraint_switch,
            tangent_part=medium.tangent_part,
            first_cell_mm=medium.first_cell_mm,
            advance=medium.advance,
        ),
        controls=ControlsRecord(guide_distance_mm=guide),
        steps=_make_step_records(insertion) if moved else (),
    )


def find_layers(insertion: Insertion) -> tuple[tuple[float, int], ...]:
    """Return depth (mm) and number of each layer that an insertion meets, but those of zero thickness."""
    tops = [0.0, *insertion.boundaries.tolist()]
    ends = [*tops[1:], float("inf")]
    met = zip(tops, ends, insertion.sequence, strict=True)
    return tuple((top, layer) for top, end, layer in met if end > top)


def _make_step_records(insertion: Insertion) -> tuple[StepRecord, StepRecord]:
    """Return the insertion, and the move of its base behind it."""
    inserted = StepRecord(depth_mm=insertion.depth)
    return inserted, StepRecord(depth_mm=insertion.depth, base_y_mm=insertion.base_moved)


def _make_needle_record(dataset: Dataset) -> NeedleRecord:
    """Return the dataset's needle by its rigidity, whatever that was stated by."""
    needle = dataset.needle
    return NeedleRecord(
        name=f"needle of {dataset.name}",
        length_mm=needle.length,
        outer_diameter_mm=dataset.outer_diameter,
        flexural_rigidity_nmm2=needle.flexural_rigidity,
    )
