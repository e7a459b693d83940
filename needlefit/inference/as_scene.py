"""One insertion with parameter values, said as a scene: the needle that `predict` simulates."""

from collections.abc import Mapping

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import (
    BevelRecord,
    ControlsRecord,
    LayerRecord,
    NeedleRecord,
    RulesRecord,
    SceneRecord,
    StepRecord,
)


def as_scene(
    values: Mapping[str, float], medium: MediumRecord, dataset: Dataset, insertion: Insertion, title: str = ""
) -> SceneRecord:
    """Return the scene whose needle is that of `predict.conditions`, in C: the world is the needle's own.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    """
    guide = values.get("guide_distance_mm", insertion.guide_distance)
    moved = insertion.base_shift
    return SceneRecord(
        schema_=1,
        title=title,
        depth_mm=None if moved else insertion.depth,
        law=medium.law,
        needle=_needle(dataset),
        layers=tuple(
            LayerRecord(
                name=f"layer {layer}",
                top_mm=top,
                mu_pa=values[f"mu{layer}_pa"],
                alpha=values[f"alpha{layer}"],
                thickness_mm=medium.thickness_mm,
            )
            for top, layer in layers_met(insertion)
        ),
        bevel=BevelRecord(offset_mm=values["bevel_mm"], side=1 if insertion.side > 0 else -1),
        rules=RulesRecord(
            constraint_spacing_mm=medium.constraint_spacing_mm,
            constraint_switch=medium.constraint_switch,
            tangent_part=medium.tangent_part,
            first_cell_mm=medium.first_cell_mm,
        ),
        controls=ControlsRecord(guide_distance_mm=guide),
        steps=_in_two(insertion) if moved else (),
    )


def layers_met(insertion: Insertion) -> tuple[tuple[float, int], ...]:
    """Return depth (mm) and number of each layer that an insertion meets; those of no thickness left out."""
    tops = [0.0, *insertion.boundaries.tolist()]
    ends = [*tops[1:], float("inf")]
    met = zip(tops, ends, insertion.sequence, strict=True)
    return tuple((top, layer) for top, end, layer in met if end > top)


def _in_two(insertion: Insertion) -> tuple[StepRecord, StepRecord]:
    """Return the insertion, and the move of its base behind it."""
    inserted = StepRecord(depth_mm=insertion.depth)
    return inserted, StepRecord(depth_mm=insertion.depth, base_y_mm=insertion.base_shift)


def _needle(dataset: Dataset) -> NeedleRecord:
    """Return the dataset's needle by its rigidity, whatever that was stated by."""
    needle = dataset.needle
    return NeedleRecord(
        name=f"needle of {dataset.name}",
        length_mm=needle.length,
        outer_diameter_mm=dataset.outer_diameter,
        flexural_rigidity_nmm2=needle.flexural_rigidity,
    )
