"""From parameter values and one insertion's conditions to the simulated needle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.inference.parameters import tissue
from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.linearize import MAX_TOLERANCE_MM
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]

LONGEST_ELEMENT = 1.0
"""Mesh size aimed at, mm; the mesh size used divides the constraint spacing."""


def predict(
    values: Mapping[str, float],
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    boundaries: Floats | None = None,
    sequence: Sequence[int] | None = None,
) -> NeedleShape:
    """Return the shape that the model gives one insertion.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    medium : MediumRecord
        Law, thickness and constraint spacing.
    needle : Needle
    insertion : Insertion
        Its depth, bevel side and guide; nothing of its measured shape but the boundaries is used.
    boundaries, sequence : (n - 1,) array and n layer numbers, optional
        The layers met instead of the measured ones, e.g. along the planned path.

    Raises
    ------
    ModelError
        If the needle does not reach the depth; a solve that fails is a value, `converged`.
    """
    return simulate_steps(*conditions(values, medium, needle, insertion, boundaries, sequence))


def conditions(
    values: Mapping[str, float],
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    boundaries: Floats | None = None,
    sequence: Sequence[int] | None = None,
) -> tuple[Needle, Tissue, tuple[Step, ...], ModelOptions]:
    """Return what `predict` simulates, as `simulate_steps` and `linearize_along` take it.

    Both solve to `MAX_TOLERANCE_MM`, so that values and derivatives are of one state: searches compare them.
    """
    met = insertion.sequence if sequence is None else sequence
    depths = insertion.boundaries if boundaries is None else boundaries
    return (
        needle,
        tissue(values, met, depths, medium),
        _steps(values, insertion),
        replace(rules(medium), tolerance=MAX_TOLERANCE_MM),
    )


def predict_each(
    sets: Sequence[Mapping[str, float]], medium: MediumRecord, needle: Needle, insertion: Insertion
) -> Batch:
    """Return one insertion with many parameter sets, for `lanes.simulate_batches`; else as `predict`."""
    first = sets[0]
    guide = np.array([values.get("guide_distance_mm", insertion.guide_distance or 0.0) for values in sets])
    return Batch(
        needle,
        tissue(first, insertion.sequence, insertion.boundaries, medium),
        _steps(first, insertion),
        rules(medium),
        mu=np.array([[values[f"mu{layer}_pa"] * 1e-6 for layer in insertion.sequence] for values in sets]),
        alpha=np.array([[values[f"alpha{layer}"] for layer in insertion.sequence] for values in sets]),
        offset=np.array([values["bevel_mm"] for values in sets]),
        guide_x=-guide if np.ptp(guide) > 0 else None,  # the lanes prefer one place for all
    )


def _steps(values: Mapping[str, float], insertion: Insertion) -> tuple[Step, ...]:
    """Return the insertion, and behind it the base's move, if there was one."""
    bevel = Bevel(values["bevel_mm"], insertion.side)
    controls = _clamped(values.get("guide_distance_mm", insertion.guide_distance))
    inserted = Step(insertion.depth, bevel, controls)
    if not insertion.base_shift:
        return (inserted,)
    return inserted, replace(inserted, controls=replace(controls, base_y=insertion.base_shift))


def _clamped(guide_distance: float | None) -> Controls:
    """Return the controls of a needle clamped by a guide on the insertion axis, or held by its base alone."""
    return Controls() if guide_distance is None else Controls(guides=(Guide(-guide_distance),))


def rules(medium: MediumRecord) -> ModelOptions:
    """Return the rules of a medium, and the longest mesh size up to 1 mm in its constraint spacing."""
    spacing = medium.constraint_spacing_mm
    return ModelOptions(
        spacing,
        spacing / math.ceil(spacing / LONGEST_ELEMENT - 1e-9),
        switch=medium.constraint_switch,
        tangent=medium.tangent_part,
        first_cell=medium.first_cell_mm,
    )
