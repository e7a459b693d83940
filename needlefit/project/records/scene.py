"""A scene: one needle, one stack of layers, one bevel, one depth."""

from itertools import pairwise
from typing import Literal, Self

from pydantic import Field, model_validator

from needlefit.project.records.record import FileRecord, Record


class NeedleRecord(Record):
    """A needle: its length and either its tube (diameters, modulus) or its flexural rigidity."""

    name: str = "needle"
    length_mm: float = Field(gt=0)
    outer_diameter_mm: float | None = Field(default=None, gt=0)
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

    name: str = ""
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
    """What is part of the model (`constraint_spacing_mm`) and what is numerical (`element_mm`)."""

    constraint_spacing_mm: float = Field(default=1.0, gt=0)
    element_mm: float = Field(default=1.0, gt=0)


class ControlsRecord(Record):
    """Where the needle is held: the base in C, or a clamping guide before the tissue."""

    base_y_mm: float = 0.0
    base_slope_deg: float = Field(default=0.0, gt=-45, lt=45)
    guide_distance_mm: float | None = Field(default=None, gt=0)


class EntryRecord(Record):
    """The tip's pose in the world at first contact."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0


class SceneRecord(FileRecord):
    """`configs/scenes/<name>.toml`."""

    title: str = ""
    note: str = ""
    depth_mm: float = Field(gt=0)
    law: str = "ogden"
    needle: NeedleRecord
    layers: tuple[LayerRecord, ...] = Field(min_length=1)
    bevel: BevelRecord
    rules: RulesRecord = RulesRecord()
    controls: ControlsRecord = ControlsRecord()
    entry: EntryRecord = EntryRecord()

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        tops = [layer.top_mm for layer in self.layers]
        if tops[0] != 0:
            raise ValueError(f"layers.1.top_mm is {tops[0]}: the first layer begins at the entry, top_mm = 0")
        if any(b <= a for a, b in pairwise(tops)):
            raise ValueError(f"layers must lie one below the other: top_mm must increase, got {tops}")
        return self

    @model_validator(mode="after")
    def _reachable(self) -> Self:
        reach = self.needle.length_mm - (self.controls.guide_distance_mm or 0.0)
        if self.depth_mm >= reach:
            behind = "the guide" if self.controls.guide_distance_mm else "the tissue"
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} drives the needle's base into {behind}: "
                f"expected less than {reach:g} mm"
            )
        return self
