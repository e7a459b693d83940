"""A scene: everything that one insertion needs, its pose in the world, and its simulation step by step."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from needlefit.errors import ConfigError, ModelError
from needlefit.geometry.frames import Frame, Placement
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import compile_law
from needlefit.mechanics.plan import SAME_DEPTH_MM, Lattice, check_reach, check_size, make_lattice
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import turn_tip
from needlefit.schemas.scene import ResolvedStep, SceneEntryRecord, SceneRecord, resolve_steps

MAX_AXIS_ANGLE_RAD = math.radians(45)  #: greatest angle between C's x axis and a guide's or the stage's


@dataclass(frozen=True)
class Entry:
    """The tip's pose in the world at first contact: origin of C (mm) and angle of C's x axis (rad)."""

    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0

    @classmethod
    def from_record(cls, record: SceneEntryRecord) -> Self:
        """Return the pose that a validated record describes."""
        return cls(record.x_mm, record.y_mm, math.radians(record.angle_deg))

    @property
    def placement(self) -> Placement:
        """The pose of C in the plane z = 0 of the world, whose coordinates are read as the patient's."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Placement(Frame(np.array([self.x, self.y, 0.0]), rotation))

    def slope_of(self, angle: float) -> float:
        """Return the slope in C of an axis with direction `angle` (rad) in the world.

        Raises ModelError if the axis lies 45 degrees or more off C's x: the needle need not meet its normal
        line.
        """
        turn = math.remainder(angle - self.angle, math.pi)  # an axis has no front
        if abs(turn) >= MAX_AXIS_ANGLE_RAD:
            raise ModelError(
                f"an axis at {math.degrees(angle):g} degrees in the world lies "
                f"{math.degrees(abs(turn)):g} degrees off the insertion axis",
                expected=f"less than 45 degrees off the entry's {math.degrees(self.angle):g} degrees",
                fix="give the direction in which the needle slides",
            )
        return math.tan(turn)


@dataclass(frozen=True)
class Scene:
    """One insertion to simulate: the arguments of `simulate_steps`, and the pose of the entry."""

    needle: Needle
    tissue: Tissue
    steps: tuple[Step, ...]  #: from first contact on; guides and stage in C
    rules: ModelOptions = ModelOptions()
    entry: Entry = Entry()  #: C in the world
    #: what pictures call the layers; none, or one each, empty where a layer has no name
    layer_names: tuple[str, ...] = ()

    @property
    def depth(self) -> float:
        """Inserted arc length at the end of the last step, mm."""
        return self.steps[-1].depth

    @property
    def lattice(self) -> Lattice:
        """The constraint points of the whole insertion."""
        return make_lattice(self.steps, self.rules)

    @property
    def tip_steps(self) -> tuple[Step, ...]:
        """The steps with the roll of the tip in place of the hub's."""
        return turn_tip(self.needle, self.tissue, self.steps)

    @classmethod
    def from_record(cls, record: SceneRecord, where: str = "") -> Self:
        """Return the scene that a validated record describes; `where` is named in errors.

        Raises ConfigError if the model does not take one of its values; the key is named where there is one.
        """
        entry = Entry.from_record(record.entry)
        with _name_keys(where, "law"):
            law = LAWS[record.law].name
        with _name_keys(where):
            needle = Needle.from_record(record.needle)
            tissue = Tissue.from_records(record.layers, law, record.torsional_friction_n)
            rules = ModelOptions.from_record(record.rules)
        with _name_keys(where, "law"):
            compile_law(tissue.law, tissue.shape)  # refused here, where the key is known
        steps = tuple(_make_step(whole, needle, entry, where) for whole in resolve_steps(record))
        deepest = "steps" if record.steps else "depth_mm"
        with _name_keys(where, deepest, "rules.constraint_spacing_mm", "rules.element_mm"):
            check_size(tuple(step.depth for step in steps), rules)
        names = tuple(layer.name for layer in record.layers)
        return cls(needle, tissue, steps, rules, entry, names)


def simulate_scene(scene: Scene) -> tuple[NeedleShape, ...]:
    """Return the needle's shape after each step in C, up to the first step that fails.

    All of them have the constraint points of the whole insertion, so that each one is the next one's past.
    Their iterations are counted from first contact.
    """
    session = begin_session(scene, scene.lattice.first_cell)
    shapes: list[NeedleShape] = []
    iterations = session.now.shape.iterations
    for step in scene.steps:
        shape = session.go(step)
        iterations += shape.iterations
        shapes.append(replace(shape, iterations=iterations))
        if not shape.converged:
            break
    return tuple(shapes)


def begin_session(scene: Scene, first_cell: float) -> Session:
    """Return a session at first contact, under the inputs of the scene's first step.

    `first_cell` (mm) is that of `scene.lattice` for who wants the needle that `simulate_scene` finds.
    """
    first = scene.steps[0]
    return Session(
        scene.needle, scene.tissue, first.bevel, first_cell, first.controls, scene.rules, planned=scene.steps
    )


def _make_step(whole: ResolvedStep, needle: Needle, entry: Entry, where: str) -> Step:
    """Return a step whose guides and stage, given in the world, are seen from C."""
    inputs = whole.controls
    with _name_keys(where, "controls.stage_angle_deg"):
        stage = (
            0.0 if inputs.stage_angle_deg is None else entry.slope_of(math.radians(inputs.stage_angle_deg))
        )
        stage_z = _raise_axis(stage, inputs.stage_elevation_deg)
    guides = []
    for key, guide in ((key, guide) for key, guide in whole.guides if guide.engaged):
        with _name_keys(where, key):
            (x, y, _), slope = entry.placement.frame.to_local([guide.x_mm, guide.y_mm, 0.0]), 0.0
            if guide.angle_deg is not None and not guide.turns_freely:
                slope = entry.slope_of(math.radians(guide.angle_deg))
            position = (
                0.0 if abs(x) < SAME_DEPTH_MM else float(x)
            )  # rounding must not push it out of the tissue
            axis, slope_z = None if guide.turns_freely else slope, _raise_axis(slope, guide.elevation_deg)
            guides.append(
                (key, Guide(position, float(y), axis, guide.in_tissue, guide.name, guide.z_mm, slope_z))
            )
    if inputs.guide_distance_mm is not None:
        guides.append(("controls.guide_distance_mm", Guide(-inputs.guide_distance_mm)))
    tip = None
    if inputs.tip_y_mm is not None:
        tip = TrackedTip(
            inputs.tip_y_mm,
            None if inputs.tip_slope_deg is None else _to_slope(inputs.tip_slope_deg),
            inputs.tip_z_mm or 0.0,
            _to_slope(inputs.tip_slope_z_deg or 0.0),
        )
    repeated = [key for key, guide in guides if sum(guide.x == other.x for _, other in guides) > 1]
    with _name_keys(where, *repeated):
        ordered_guides = tuple(guide for _, guide in guides)
        controls = Controls(
            inputs.base_y_mm, _to_slope(inputs.base_slope_deg), stage, ordered_guides, tip,
            inputs.base_z_mm, _to_slope(inputs.base_slope_z_deg), stage_z,
        )  # fmt: skip
    # the keys that decide whether the needle is long enough
    key, first = min(guides, key=lambda keyed: keyed[1].x, default=("", None))
    deciding = [whole.key]
    if first is not None and not first.in_tissue:
        deciding = [whole.key if -first.x < needle.length else "needle.length_mm", key]
    with _name_keys(where, *deciding):
        check_reach(needle.length, whole.depth_mm, controls)
        return Step(whole.depth_mm, Bevel.from_record(whole.bevel), controls)


def _to_slope(degrees: float) -> float:
    return math.tan(math.radians(degrees))


def _raise_axis(slope: float, elevation_deg: float) -> float:
    """Return dz/dx of an axis whose dy/dx is `slope`, raised by an angle out of the plane z = 0."""
    return math.hypot(1.0, slope) * _to_slope(elevation_deg)


@contextmanager
def _name_keys(where: str, *keys: str) -> Iterator[None]:
    """Turn what the model refuses into a fault of the file, at those keys."""
    try:
        yield
    except (ModelError, ConfigError) as error:
        named = (
            f"key{'s' if len(keys) > 1 else ''} {' and '.join(f'`{key}`' for key in keys)}: " if keys else ""
        )
        raise ConfigError(
            f"{named}{error.what}", where=where, expected=error.expected, fix=error.fix
        ) from error
