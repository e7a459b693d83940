"""A scene: one needle, one stack of layers, and the steps in which it is inserted."""

import difflib
import math
from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_GUIDES,
    MAX_LAYERS,
    MAX_NEEDLE_DIAMETER_MM,
    MAX_NEEDLE_LENGTH_MM,
    MAX_STEPS,
    MIN_ELEMENT_MM,
)
from needlefit.project.records.record import FileRecord, Name, Record
from needlefit.project.records.steps import GuideRecord, StepRecord, check_tip


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


class EntryRecord(Record):
    """The tip's pose in the world at first contact."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0


class SceneRecord(FileRecord):
    """`configs/scenes/<name>.toml`: one insertion to `depth_mm`, or `steps`.

    What a step does not say carries over from the step before, the first one's from `bevel`, `controls`
    and `guides`.
    """

    title: str = ""
    note: str = ""
    depth_mm: float | None = Field(default=None, gt=0, le=MAX_NEEDLE_LENGTH_MM)
    law: str = "ogden"
    needle: NeedleRecord
    layers: tuple[LayerRecord, ...] = Field(min_length=1, max_length=MAX_LAYERS)
    bevel: BevelRecord
    rules: RulesRecord = RulesRecord()
    controls: ControlsRecord = ControlsRecord()
    entry: EntryRecord = EntryRecord()
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
