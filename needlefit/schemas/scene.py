"""A scene: a needle, its layers, guides and controls, and the steps of its insertion."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from needlefit.schemas.base import FileRecord, Name, Record, RigidRows, missing_key
from needlefit.schemas.limits import (
    MAX_CONSTRAINT_SPACING_MM,
    MAX_GUIDES,
    MAX_LAYERS,
    MAX_NEEDLE_DIAMETER_MM,
    MAX_NEEDLE_LENGTH_MM,
    MAX_STEPS,
    MIN_ELEMENT_MM,
)

#: pattern of a guide's name: a bare TOML key that is no number
GUIDE_NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_-]*$"


_TWO_BEVELS = "side and roll_deg both state where the bevel faces: give one of the two"
CUT_ANGLE_LIMIT_DEG = 45.0  #: angle (degrees) of the cut to the needle's tangent below which all angles are


class GuideRecord(Record):
    """A guide or template."""

    name: str = Field(pattern=GUIDE_NAME_PATTERN)
    """Name by which steps refer to the guide."""
    x_mm: float
    """Position in the world, along x."""
    y_mm: float
    """Position in the world, along y."""
    z_mm: float = 0.0
    """Position in the world, along z."""
    angle_deg: float | None = None
    """Direction of the guide's axis in the world; without it, that of the insertion."""
    elevation_deg: float = Field(default=0.0, gt=-45, lt=45)
    """Angle of the guide's axis to the plane z = 0, positive toward z."""
    turns_freely: bool = False
    """Whether the guide fixes only the position and leaves the slope free."""
    in_tissue: bool = False
    """Whether the guide stands behind the entry."""
    engaged: bool = True
    """Whether the guide is closed; an open one does nothing until a step closes it."""


class GuideMoveRecord(Record):
    """What a step changes of a guide; other keys keep their values."""

    x_mm: float | None = None
    """New position along x."""
    y_mm: float | None = None
    """New position along y."""
    z_mm: float | None = None
    """New position along z."""
    angle_deg: float | None = None
    """New direction of the axis."""
    elevation_deg: float | None = Field(default=None, gt=-45, lt=45)
    """New angle of the axis to the plane z = 0."""
    turns_freely: bool | None = None
    """Whether the slope is free from now on."""
    in_tissue: bool | None = None
    """Whether the guide stands behind the entry from now on."""
    engaged: bool | None = None
    """Whether the guide is closed from now on."""


class TrackedTipRecord(Record):
    """A tracked tip, in the constraint frame C."""

    tip_y_mm: float | None = None
    """Tracked position of the tip across."""
    tip_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    """Tracked slope of the tip; without it the slope is free."""
    tip_z_mm: float | None = None
    """Tracked position of the tip along z; without it 0."""
    tip_slope_z_deg: float | None = Field(default=None, gt=-45, lt=45)
    """Tracked slope of the tip toward z, beside `tip_slope_deg`; without it 0."""

    @model_validator(mode="after")
    def _placed(self) -> Self:
        if self.tip_slope_deg is not None and self.tip_y_mm is None:
            raise ValueError("tip_slope_deg needs tip_y_mm beside it: a tracked tip has a place first")
        for along_z, beside in (("tip_z_mm", "tip_y_mm"), ("tip_slope_z_deg", "tip_slope_deg")):
            if getattr(self, along_z) is not None and getattr(self, beside) is None:
                raise ValueError(f"{along_z} needs {beside} beside it: a tip is tracked in both planes")
        return self


class StepRecord(TrackedTipRecord):
    """Where the tip goes next, and what changes before; what is not given stays as it was."""

    depth_mm: float = Field(ge=0, le=MAX_NEEDLE_LENGTH_MM)
    """Depth of the tip at the end of the step."""
    offset_mm: float | None = Field(default=None, ge=0)
    """Bevel offset b from this step on."""
    cut_angle_deg: float | None = Field(default=None, ge=0, lt=CUT_ANGLE_LIMIT_DEG)
    """Cut angle from this step on."""
    side: Literal[1, -1] | None = None
    """Side of the bevel from this step on: 1 or -1."""
    roll_deg: float | None = None
    """Roll of the bevel from this step on, in place of a side."""
    base_y_mm: float | None = None
    """Position of the base across."""
    base_slope_deg: float | None = Field(default=None, gt=-45, lt=45)
    """Slope of the base."""
    base_z_mm: float | None = None
    """Position of the base along z."""
    base_slope_z_deg: float | None = Field(default=None, gt=-45, lt=45)
    """Slope of the base toward z."""
    tip_free: bool = False
    """Whether a tracked tip is released."""
    guides: dict[str, GuideMoveRecord] = {}
    """Changes of guides, by name: `guides.template.y_mm = 2.0`."""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if self.tip_free and self.tip_y_mm is not None:
            raise ValueError("tip_free = true contradicts tip_y_mm")
        if self.side is not None and self.roll_deg is not None:
            raise ValueError(_TWO_BEVELS)
        return self


class NeedleRecord(Record):
    """A needle: its length and either its tube (diameters, modulus) or its flexural rigidity."""

    name: Name = "needle"
    """Name of the needle in tables."""
    length_mm: float = Field(gt=0, le=MAX_NEEDLE_LENGTH_MM)
    """Length from the base to the tip."""
    outer_diameter_mm: float | None = Field(default=None, gt=0, le=MAX_NEEDLE_DIAMETER_MM)
    """Outer diameter."""
    inner_diameter_mm: float = Field(default=0.0, ge=0)
    """Inner diameter; 0 for a solid needle."""
    youngs_modulus_gpa: float | None = Field(default=None, gt=0)
    """Young's modulus."""
    flexural_rigidity_nmm2: float | None = Field(default=None, gt=0)
    """Flexural rigidity EI, in place of diameters and modulus."""
    note: str = ""
    """Free text."""

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
    """One tissue layer."""

    name: Name = ""
    """Name of the layer in tables and figures."""
    top_mm: float = Field(ge=0)
    """Depth of the layer's upper boundary; 0 for the first."""
    mu_pa: float = Field(gt=0)
    """Foundation modulus mu."""
    alpha: float | None = None
    """Shape parameter alpha of the laws ogden, two_term_ogden and fung."""
    shape: dict[str, float] = Field(default_factory=dict)
    """Other shape parameters of the law by name: `{ jm = 5.0 }` of gent."""
    thickness_mm: float = Field(default=40.0, gt=0)
    """Thickness h of the tissue that supports the needle on each side."""
    friction: float = Field(default=0.0, ge=0)
    """Coefficient of friction between needle and tissue."""

    @model_validator(mode="after")
    def _state_alpha_once(self) -> Self:
        if self.alpha is not None and "alpha" in self.shape:
            raise ValueError("alpha is stated twice, as a key of the layer and in shape: leave one out")
        return self

    @property
    def shape_values(self) -> dict[str, float]:
        """All shape parameters by name, `alpha` among them."""
        return self.shape if self.alpha is None else {"alpha": self.alpha, **self.shape}


Advance = Literal["tangent", "path_angle"]  #: rules by which the needle advances


class BevelRecord(Record):
    """The bevel: its offset, or with the path-angle rule its cut angle, and its side or roll."""

    offset_mm: float | None = Field(default=None, ge=0)
    """Bevel offset b: how far the cut is shifted per constraint spacing."""
    cut_angle_deg: float | None = Field(default=None, ge=0, lt=CUT_ANGLE_LIMIT_DEG)
    """Angle of the cut to the needle's tangent, with `rules.advance = "path_angle"`."""
    side: Literal[1, -1] = 1
    """Side that the bevel faces: 1 toward y > 0, -1 toward y < 0."""
    roll_deg: float | None = None
    """Roll of the hub in place of a side, right-handed about x: 0 turns the bevel to y > 0, 90 to z > 0."""

    @model_validator(mode="after")
    def _one_roll(self) -> Self:
        if self.roll_deg is not None and self.side != 1:
            raise ValueError(_TWO_BEVELS)
        return self


class AdvanceRecord(Record):
    """Rules of the model that scenes and tissue models share. The defaults are those of every result."""

    constraint_spacing_mm: float = Field(default=1.0, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    """Distance C_int between two constraint points along the needle."""
    constraint_switch: float = Field(default=0.5, ge=0, le=1)
    """Part of the way between two constraint points from which on the tissue is held by the next one; 0.5:
    by the nearest.
    """
    tangent_part: float = Field(default=1.0, ge=0, le=1)
    """Weight of the needle's tangent in the direction of advance; 0 keeps the direction of the cut."""
    first_cell_mm: float | None = Field(default=None, gt=0)
    """Depth of the first constraint point; without it, a whole cell."""
    advance: Advance = "tangent"
    """Rule of advance: along the tangent with offset b, or at a constant angle to it."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.advance == "path_angle" and (self.constraint_switch, self.tangent_part) != (0.5, 1.0):
            raise ValueError('constraint_switch and tangent_part need advance = "tangent": leave them out')
        if self.first_cell_mm is not None and self.first_cell_mm > self.constraint_spacing_mm:
            raise ValueError(
                f"first_cell_mm is {self.first_cell_mm:g}: at most constraint_spacing_mm, "
                f"{self.constraint_spacing_mm:g}"
            )
        return self


class RulesRecord(AdvanceRecord):
    """Rules of the model, and the element length."""

    element_mm: float | None = Field(default=None, ge=MIN_ELEMENT_MM)
    """Length of a beam element; without it, the spacing or the largest part of it up to 1 mm."""
    tolerance_mm: float | None = Field(default=None, gt=0, le=1e-3)
    """Motion of a node at which the solver stops; without it 1e-7."""

    @property
    def element(self) -> float:
        """`element_mm`; where it is not stated, the spacing or that part of it that is up to 1 mm."""
        spacing = self.constraint_spacing_mm
        return self.element_mm or spacing / max(1, math.ceil(spacing - 1e-9))


class ControlsRecord(TrackedTipRecord):
    """Initial boundary conditions: base, a guide before the tissue, a tracked tip."""

    base_y_mm: float = 0.0
    """Position of the base across, in the constraint frame C."""
    base_slope_deg: float = Field(default=0.0, gt=-45, lt=45)
    """Slope of the base, in C."""
    base_z_mm: float = 0.0
    """Position of the base along z."""
    base_slope_z_deg: float = Field(default=0.0, gt=-45, lt=45)
    """Slope of the base toward z."""
    stage_angle_deg: float | None = None
    """Direction in the world in which the stage moves the base; without it, that of the entry."""
    stage_elevation_deg: float = Field(default=0.0, gt=-45, lt=45)
    """Angle of that direction to the plane z = 0, positive toward z."""
    guide_distance_mm: float | None = Field(default=None, gt=0)
    """Distance before the tissue of a guide that fixes position and slope."""


class SceneEntryRecord(Record):
    """Pose of the tip in the world at first contact."""

    x_mm: float = 0.0
    """Position of the tip at first contact, along x of the world."""
    y_mm: float = 0.0
    """Position of the tip at first contact, along y of the world."""
    angle_deg: float = 0.0
    """Direction of the needle at first contact."""


class SceneRecord(FileRecord):
    """`configs/scenes/<name>.toml`: one insertion to `depth_mm`, or in `steps`."""

    SCHEMA: ClassVar[int] = 2

    title: str = ""
    """What the scene shows."""
    note: str = ""
    """Free text for readers of the file."""
    depth_mm: float | None = Field(default=None, gt=0, le=MAX_NEEDLE_LENGTH_MM)
    """Insertion depth, where there are no `[[steps]]`."""
    law: str = "ogden"
    """Tissue law: ogden, another of docs/model.md, or one of a plugin."""
    torsional_friction_n: float = Field(default=0.0, ge=0)
    """Torque per length (N mm / mm) that a turning shaft overcomes: the tip's roll stays behind the hub's."""
    needle: NeedleRecord
    """The needle."""
    layers: tuple[LayerRecord, ...] = Field(min_length=1, max_length=MAX_LAYERS)
    """Layers from the entry on."""
    bevel: BevelRecord
    """The bevel at first."""
    rules: RulesRecord = RulesRecord()
    """Rules of the model and element length."""
    controls: ControlsRecord = ControlsRecord()
    """Base, guide and tip at first."""
    entry: SceneEntryRecord = SceneEntryRecord()
    """Pose of the tip at first contact."""
    guides: tuple[GuideRecord, ...] = Field(default=(), max_length=MAX_GUIDES)
    """Guides and templates."""
    steps: tuple[StepRecord, ...] = Field(default=(), max_length=MAX_STEPS)
    """Steps of the insertion; a step keeps what it does not give."""

    @model_validator(mode="after")
    def _one_way_down(self) -> Self:
        tops = [layer.top_mm for layer in self.layers]
        if tops[0] != 0:
            raise ValueError(f"layers.1.top_mm is {tops[0]}: the first layer begins at the entry, top_mm = 0")
        if any(b <= a for a, b in pairwise(tops)):
            raise ValueError(f"layers must lie one below the other: top_mm must increase, got {tops}")
        if self.steps and self.depth_mm is not None:
            raise ValueError(
                f"key `depth_mm` stands beside steps: delete it, or set steps.{len(self.steps)}.depth_mm"
            )
        if not self.steps and self.depth_mm is None:
            raise ValueError("key `depth_mm` is missing: give it, or [[steps]] with a depth_mm each")
        return self

    @model_validator(mode="after")
    def _one_bevel(self) -> Self:
        wanted, other = "offset_mm", "cut_angle_deg"
        if self.rules.advance == "path_angle":
            wanted, other = other, wanted
        if getattr(self.bevel, wanted) is None:
            raise missing_key("bevel", wanted)
        keyed = [("bevel", self.bevel), *((f"steps.{n}", step) for n, step in enumerate(self.steps, start=1))]
        for key, record in keyed:
            if getattr(record, other) is not None:
                raise ValueError(
                    f'key `{key}.{other}`: rules.advance is "{self.rules.advance}", give {wanted} instead'
                )
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
                    expected = f"only {', '.join(names) or 'none'}"
                    raise ValueError(f"key `steps.{n}.guides.{name}`: there is no such guide, {expected}")
        return self


@dataclass(frozen=True)
class ResolvedStep:
    """One step with all of its inputs."""

    depth_mm: float
    bevel: BevelRecord
    controls: ControlsRecord
    guides: tuple[tuple[str, GuideRecord], ...]  #: each with the key of the file that put it where it is
    key: str  #: the key of the file that states the depth


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
        turned: dict[str, Any] = {} if step.side is None else {"side": step.side, "roll_deg": None}
        turned |= {} if step.roll_deg is None else {"side": 1, "roll_deg": step.roll_deg}
        bevel = bevel.model_copy(update=_given_values(step, "offset_mm", "cut_angle_deg") | turned)
        given = _given_values(step, "base_y_mm", "base_slope_deg", "base_z_mm", "base_slope_z_deg")
        if step.tip_y_mm is not None or step.tip_free:  # a new place of the tip, or that it is free
            names = ("tip_y_mm", "tip_slope_deg", "tip_z_mm", "tip_slope_z_deg")
            given |= {name: getattr(step, name) for name in names}
        controls = controls.model_copy(update=given)
        for name, move in step.guides.items():
            moved = guides[name][1].model_copy(update=move.model_dump(exclude_none=True))
            guides[name] = (f"steps.{n}.guides.{name}", moved)
        key = f"steps.{n}.depth_mm"
        whole.append(ResolvedStep(step.depth_mm, bevel, controls, tuple(guides.values()), key))
    return tuple(whole)


def _given_values(step: StepRecord, *names: str) -> dict[str, Any]:
    return {name: getattr(step, name) for name in names if getattr(step, name) is not None}


# ---- recordings


class PlacementRecord(Record):
    """Where a measured needle lies: rigid motions to the world of its dataset.

    `entry_to_world` is that of the constraint frame C, `lps_to_world` that of the patient coordinates (LPS)
    of its scan.
    """

    entry_to_world: RigidRows
    lps_to_world: RigidRows


class RecordingRecord(FileRecord):
    """A scene, whole, and where its first constraint point lies.

    `needlefit` is the version that recorded it, `target` what was opened (see `needlefit view`). Without a
    `placement` the scene states where the needle lies: in the plane z = 0 of its own world.
    """

    SCHEMA: ClassVar[int] = 2

    needlefit: str
    target: str
    first_cell_mm: float = Field(gt=0)
    placement: PlacementRecord | None = None
    scene: SceneRecord


class ObstacleRecord(Record):
    """A circle in the plane, or a sphere in space, that the needle must avoid."""

    name: Name
    """Name of the obstacle in tables."""
    centre_mm: tuple[float, float] | tuple[float, float, float]
    """Centre: x and y in the plane, in space z too."""
    radius_mm: float = Field(gt=0)
    """Radius."""
