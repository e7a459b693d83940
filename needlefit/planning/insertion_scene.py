"""The scene that repeats a measured insertion: its needle, layers and inputs, with given parameters."""

from collections.abc import Mapping
from typing import Any

from needlefit.datasets.first_study import record_steps
from needlefit.datasets.insertion import InsertionInputs
from needlefit.inference.forward_model import make_rules
from needlefit.mechanics.laws import LAWS
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import BevelRecord, ControlsRecord, LayerRecord, NeedleRecord, SceneRecord


def make_scene_record(
    values: Mapping[str, float],
    medium: MediumRecord,
    dataset: str,
    insertion: InsertionInputs,
    title: str = "",
    tolerance_mm: float | None = None,
) -> SceneRecord:
    """Return a scene file's content that reproduces the prediction of one insertion, in C.

    `values` are all parameters of the medium, ties resolved (Pa, mm); `dataset` is the name of its dataset.
    `tolerance_mm` is that of the solver, by default that of scenes.
    """
    guide = values.get("guide_distance_mm", insertion.guide_distance)
    moved = insertion.base_moved

    layers = tuple(
        LayerRecord(
            name=f"layer {layer}",
            top_mm=top,
            thickness_mm=medium.thickness_mm,
            **name_layer_values(values, layer, medium),
        )
        for top, layer in find_layers(insertion)
    )
    bevel = {
        name_bevel_key(medium): insertion.bevel_factor * values[medium.bevel_parameter],
        "side": 1 if insertion.side > 0 else -1,
    }
    return SceneRecord(
        schema_=SceneRecord.SCHEMA,
        title=title,
        depth_mm=None if moved or insertion.turns else insertion.depth,
        law=medium.law,
        torsional_friction_n=medium.torsional_friction_n,
        needle=NeedleRecord(  # by its rigidity, whatever that was stated by
            name=f"needle of {dataset}",
            length_mm=insertion.needle.length,
            outer_diameter_mm=insertion.needle.outer_diameter,
            flexural_rigidity_nmm2=insertion.needle.flexural_rigidity,
        ),
        layers=layers,
        bevel=BevelRecord.model_validate(bevel),
        rules=make_rules(medium, tolerance_mm),
        controls=ControlsRecord(guide_distance_mm=guide),
        steps=record_steps(insertion) if moved or insertion.turns else (),
    )


def name_layer_values(values: Mapping[str, float], layer: int, medium: MediumRecord) -> dict[str, Any]:
    """Return the keys of a scene's layer that hold the parameters of a layer of the medium."""
    shape = {kind: values[f"{kind}{layer}"] for kind in LAWS[medium.law].shape_names}
    return {"mu_pa": values[f"mu{layer}_pa"], "alpha": shape.pop("alpha", None), "shape": shape}


def name_bevel_key(medium: MediumRecord) -> str:
    """Return the key of a scene's bevel that holds its strength."""
    return medium.bevel_parameter.replace("bevel_mm", "offset_mm")


def find_layers(insertion: InsertionInputs) -> tuple[tuple[float, int], ...]:
    """Return depth (mm) and number of each layer that an insertion meets, but those of zero thickness."""
    tops = [0.0, *insertion.boundaries.tolist()]
    ends = [*tops[1:], float("inf")]
    met = zip(tops, ends, insertion.sequence, strict=True)
    return tuple((top, layer) for top, end, layer in met if end > top)
