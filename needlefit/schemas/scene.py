"""A scene: a needle, its layers, guides and controls, and the steps of its insertion."""

import difflib
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record
from needlefit.schemas.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_GUIDES,
    MAX_LAYERS,
    MAX_NEEDLE_DIAMETER_MM,
    MAX_NEEDLE_LENGTH_MM,
    MAX_STEPS,
    MIN_ELEMENT_MM,
)

GUIDE_NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_-]*$"
"""What a guide may be called: a bare TOML key that is no number."""


class GuideRecord(Record):
    """A guide or template: its place in the world, the direction of its axis, and whether that holds.

    Without `angle_deg` its axis is the insertion axis. `in_tissue` says that it stands behind the entry;
    `engaged = false` that it is there but open, until a step closes it.
    """

    name: str = Field(pattern=GUIDE_NAME_PATTERN)
    x_mm: float
    y_mm: float
    angle_deg: float | None = None
    turns_freely: bool = False
    in_tissue: bool = False
    engaged: bool = True


class GuideMoveRecord(Record):
    """What a step changes of a guide."""

    x_mm: float | None = None
    y_mm: float | None = None
    angle_deg: float | None = None
    turns_freely: bool | None = None
    in_tissue: bool | None = None
    engaged: bool | None = None


class StepRecord(Record):
    """Where the tip goes next, and what changes before it does; what is not said stays as it was.

    A tracked tip is replaced as a whole: `tip_y_mm` without `tip_slope_deg` leaves its slope free.
    """

    depth_mm: float = Field(ge=0, le=MAX_NEEDLE_LENGTH_MM)
    offset_mm: float | None = Field(default=None, ge=0)
    side: Literal[1, -1] | None = None
    base_y_mm: float | None = None
    base_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    tip_y_mm: float | None = None
    tip_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    tip_free: bool = False
    guides: dict[str, GuideMoveRecord] = {}

    @model_validator(mode="after")
    def _one_tip(self) -> Self:
        check_tip(self.tip_y_mm, self.tip_slope_deg)
        if self.tip_free and self.tip_y_mm is not None:
            raise ValueError("tip_free = true lets go of the tip that tip_y_mm holds: give one of the two")
        return self


def check_tip(y_mm: float | None, slope_deg: float | None) -> None:
    """Raise ValueError if a tracked tip has a slope but no place."""
    if slope_deg is not None and y_mm is None:
        raise ValueError("tip_slope_deg needs tip_y_mm beside it: a tracked tip has a place first")


class NeedleRecord(Record):
    """A needle: its length and either its tube (diameters, modulus) or its flexural rigidity."""

    name: Name = "needle"
    length_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    outer_diameter_mm: float | None = Field(default=None, gt=0, le=MAX_NEEDLE_DIAMETER_MM)
    inner_diameter_mm: float = Field(default=0.0, ge=0)
    youngs_modulus_gpa: float | None = Field(default=None, gt=0)
    flexural_rigidity_nmm2: float | None = Field(default=None, gt=0)
    note: str = ""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        tube = self.outer_diameter_mm is not None and self.youngs_modulus_gpa is not None
        if tube == (self.flexural_rigidity_nmm2 is not None):
            raise ValueError(
                "give either outer_diameter_mm and youngs_modulus_gpa, or flexural_rigidity_nmm2 (not both)"
            )
        if self.outer_diameter_mm is not None and self.inner_diameter_mm >= self.outer_diameter_mm:
            raise ValueError("inner_diameter_mm must be smaller than outer_diameter_mm")
        return self


class LayerRecord(Record):
    """One tissue layer; `top_mm` is the depth of its upper boundary along C's x axis (first layer: 0)."""

    name: Name = ""
    top_mm: float = Field(ge=0)
    mu_pa: float = Field(gt=0)
    alpha: float
    thickness_mm: float = Field(default=40.0, gt=0)
    friction: float = Field(default=0.0, ge=0)


class BevelRecord(Record):
    """The cut's offset per constraint spacing, and the side that the bevel faces (+1: left, y > 0)."""

    offset_mm: float = Field(ge=0)
    side: Literal[1, -1] = 1


class RulesRecord(Record):
    """What is part of the model, and what is numerical (`element_mm`).

    `constraint_switch`, `tangent_part` and `first_cell_mm` are decided, as in a medium; other values let a
    scene carry a needle that was fitted under them.
    """

    constraint_spacing_mm: float = Field(default=1.0, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    element_mm: float | None = Field(default=None, ge=MIN_ELEMENT_MM)
    constraint_switch: float = Field(default=0.5, ge=0, le=1)
    tangent_part: float = Field(default=1.0, ge=0, le=1)
    first_cell_mm: float | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _within_a_cell(self) -> Self:
        if self.first_cell_mm is not None and self.first_cell_mm > self.constraint_spacing_mm:
            raise ValueError(
                f"first_cell_mm is {self.first_cell_mm:g}: at most constraint_spacing_mm, "
                f"{self.constraint_spacing_mm:g}"
            )
        return self

    @property
    def element(self) -> float:
        """`element_mm`; where the file does not say, the spacing or that part of it that is up to 1 mm."""
        spacing = self.constraint_spacing_mm
        return self.element_mm or spacing / max(1, math.ceil(spacing - 1e-9))


class ControlsRecord(Record):
    """How the needle is held at first: the base, a clamping guide before the tissue, a tracked tip.

    All of it in C, but for `stage_angle_deg`: the direction in the world in which the stage carries the
    base (default: the entry's).
    """

    base_y_mm: float = 0.0
    base_slope_deg: float = Field(default=0.0, gt=-45, lt=45)
    stage_angle_deg: float | None = None
    guide_distance_mm: float | None = Field(default=None, gt=0)
    tip_y_mm: float | None = None
    tip_slope_deg: float | None = Field(default=None, gt=-45, lt=45)

    @model_validator(mode="after")
    def _placed(self) -> Self:
        check_tip(self.tip_y_mm, self.tip_slope_deg)
        return self


class SceneEntryRecord(Record):
    """The tip's pose in the world at first contact."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0


class SceneRecord(FileRecord):
    """`configs/scenes/<name>.toml`: one insertion to `depth_mm`, or `steps`.

    What a step does not say carries over from the step before, the first one's from `bevel`, `controls`
    and `guides`.
    """

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    note: str = ""
    depth_mm: float | None = Field(default=None, gt=0, le=MAX_NEEDLE_LENGTH_MM)
    law: str = "ogden"
    needle: NeedleRecord
    layers: tuple[LayerRecord, ...] = Field(min_length=1, max_length=MAX_LAYERS)
    bevel: BevelRecord
    rules: RulesRecord = RulesRecord()
    controls: ControlsRecord = ControlsRecord()
    entry: SceneEntryRecord = SceneEntryRecord()
    guides: tuple[GuideRecord, ...] = Field(default=(), max_length=MAX_GUIDES)
    steps: tuple[StepRecord, ...] = Field(default=(), max_length=MAX_STEPS)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        tops = [layer.top_mm for layer in self.layers]
        if tops[0] != 0:
            raise ValueError(f"layers.1.top_mm is {tops[0]}: the first layer begins at the entry, top_mm = 0")
        if any(b <= a for a, b in pairwise(tops)):
            raise ValueError(f"layers must lie one below the other: top_mm must increase, got {tops}")
        return self

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.steps and self.depth_mm is not None:
            raise ValueError(
                f"key `depth_mm` stands beside steps, each of which has its own: delete it, or set "
                f"steps.{len(self.steps)}.depth_mm"
            )
        if not self.steps and self.depth_mm is None:
            raise ValueError("key `depth_mm` is missing: give it, or [[steps]] with a depth_mm each")
        return self

    @model_validator(mode="after")
    def _known_guides(self) -> Self:
        names = [guide.name for guide in self.guides]
        for n, name in enumerate(names, start=1):
            if name in names[: n - 1]:
                raise ValueError(f"key `guides.{n}.name`: `{name}` names another guide already")
        for n, step in enumerate(self.steps, start=1):
            for name in step.guides:
                if name not in names:
                    near = difflib.get_close_matches(name, names, n=1) or names
                    known = f"did you mean `{', '.join(near)}`?" if near else "the scene has no guides"
                    raise ValueError(f"key `steps.{n}.guides.{name}`: there is no such guide; {known}")
        return self


@dataclass(frozen=True)
class ResolvedStep:
    """One step with all of its inputs.

    Attributes
    ----------
    depth_mm : float
    bevel : BevelRecord
    controls : ControlsRecord
    guides : tuple of (str, GuideRecord)
        Each with the key of the file that put it where it is.
    key : str
        The key of the file that says the depth.
    """

    depth_mm: float
    bevel: BevelRecord
    controls: ControlsRecord
    guides: tuple[tuple[str, GuideRecord], ...]
    key: str


def resolve_steps(scene: SceneRecord) -> tuple[ResolvedStep, ...]:
    """Return the scene's steps, at least one; a scene that has none is one step to its `depth_mm`."""
    guides = {guide.name: (f"guides.{n}", guide) for n, guide in enumerate(scene.guides, start=1)}
    if scene.depth_mm is not None:
        return (
            ResolvedStep(scene.depth_mm, scene.bevel, scene.controls, tuple(guides.values()), "depth_mm"),
        )
    whole = []
    bevel, controls = scene.bevel, scene.controls
    for n, step in enumerate(scene.steps, start=1):
        bevel = bevel.model_copy(update=_given_values(step, "offset_mm", "side"))
        controls = controls.model_copy(
            update=_given_values(step, "base_y_mm", "base_slope_deg") | _given_tip(step)
        )
        for name, move in step.guides.items():
            moved = guides[name][1].model_copy(update=move.model_dump(exclude_none=True))
            guides[name] = (f"steps.{n}.guides.{name}", moved)
        key = f"steps.{n}.depth_mm"
        whole.append(ResolvedStep(step.depth_mm, bevel, controls, tuple(guides.values()), key))
    return tuple(whole)


def _given_values(step: StepRecord, *names: str) -> dict[str, Any]:
    """Return those of the named keys that the step gives."""
    return {name: getattr(step, name) for name in names if getattr(step, name) is not None}


def _given_tip(step: StepRecord) -> dict[str, float | None]:
    """Return what the step says of the tip: a new place, or that it is free."""
    if step.tip_y_mm is None and not step.tip_free:
        return {}
    return {"tip_y_mm": step.tip_y_mm, "tip_slope_deg": step.tip_slope_deg}
