"""The inputs of the interactive simulation, under the names that the page, recordings and replays use.

V-inputs act on the needle's shape (base, guides, a tracked tip), H-inputs on how far it is in and where it
cuts (depth, bevel). The moduli and a bevel strength throughout are no inputs of an insertion but parameters
of the model: with them the insertion so far is simulated again.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.laws import LAWS, list_shape_parameters
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.limits import MAX_NEEDLE_LENGTH_MM, MAX_NUMBER

Item = Literal["guide", "layer"]

INPUTS: dict[str, Item | None] = {
    "depth_mm": None,
    "bevel_side": None,
    "bevel_offset_mm": None,
    "cut_angle_deg": None,
    "base_y_mm": None,
    "base_slope": None,
    "guide_x_mm": "guide",
    "guide_y_mm": "guide",
    "guide_slope": "guide",
    "guide_turns_freely": "guide",
    "guide_engaged": "guide",
    "tip_y_mm": None,
    "tip_slope": None,
    "tip_held": None,
    "mu_pa": "layer",
    "offset_throughout_mm": None,
    "cut_angle_throughout_deg": None,
    "return_to": None,
}
"""Inputs, each with the object that its item number counts; shape parameters are further inputs of layers."""

_PARAMETERS = ("mu_pa", "offset_throughout_mm", "cut_angle_throughout_deg")

FLAGS = ("guide_turns_freely", "guide_engaged", "tip_held")

MAX_GUIDE_NUMBER = 32
"""Greatest number of a guide."""

MAX_CUT_ANGLE_DEG = 45.0

MAX_MU_PA = 1e15
"""Greatest mu, Pa: beyond it, rounding exceeds the needle's own stiffness."""


def is_parameter(name: str) -> bool:
    """Return whether an input is a parameter of the model, which applies to the whole insertion."""
    return name in _PARAMETERS or name not in INPUTS


def find_item(name: str) -> Item | None:
    """Return the object that the item number of an input counts; ModelError if there is no such input."""
    if name in INPUTS:
        return INPUTS[name]
    if any(one.name == name for one in list_shape_parameters()):
        return "layer"
    raise ModelError(f"there is no input `{name}`", expected=f"one of {', '.join(INPUTS)}")


@dataclass(frozen=True)
class Change:
    """One input and its new value.

    Attributes
    ----------
    name : str
        A key of `INPUTS`, with its unit, or a shape parameter of a law; slopes are dy/dx.
    item : int or None
        Number of the guide or layer, from 1.
    """

    name: str
    item: int | None
    value: float

    def __post_init__(self) -> None:
        kind = find_item(self.name)
        if (self.item is None) != (kind is None) or (self.item is not None and self.item < 1):
            wanted = f"the number of a {kind}, from 1" if kind else "no item"
            raise ModelError(f"{self.name} has item {self.item!s:.20}", expected=wanted)
        if kind == "guide" and self.item is not None and self.item > MAX_GUIDE_NUMBER:
            raise ModelError(
                f"guides have no number {self.item!s:.20}", expected=f"a number from 1 to {MAX_GUIDE_NUMBER}"
            )
        self._check_value()

    def _check_value(self) -> None:
        expected = ""
        most = MAX_NEEDLE_LENGTH_MM if self.name.endswith("_mm") else MAX_NUMBER
        if not abs(self.value) <= most:
            expected = f"a finite number, at most {most:g}"
        elif self.name in FLAGS and self.value not in (0, 1):
            expected = "0 or 1"
        elif self.name == "bevel_side" and self.value not in (1, -1):
            expected = "+1 (y > 0) or -1"
        elif self.name.endswith("slope") and abs(self.value) >= 1:
            expected = "between -45° and 45° (dy/dx between -1 and 1)"
        elif self.name == "mu_pa" and not 0 < self.value <= MAX_MU_PA:
            expected = f"above 0 MPa, up to {MAX_MU_PA / 1e6:g} MPa"
        elif self.name in ("bevel_offset_mm", "offset_throughout_mm", "depth_mm") and self.value < 0:
            expected = "0 mm or above"
        elif self.name.startswith("cut_angle") and not 0 <= self.value < MAX_CUT_ANGLE_DEG:
            expected = f"from 0 to {MAX_CUT_ANGLE_DEG:g}°"
        elif self.name == "return_to" and (self.value < 0 or self.value != int(self.value)):
            expected = "the number of a step"
        if expected:
            raise ModelError(f"{self._describe()} is {self._write_value()}", expected=expected)

    def _describe(self) -> str:
        """Return the name without its unit, and whose input it is."""
        words = self.name.removesuffix("_mm").removesuffix("_deg").removesuffix("_pa").replace("_", " ")
        return words if self.item is None else f"{words} of {find_item(self.name)} {self.item}"

    def _write_value(self) -> str:
        """Return the value in the unit of the page's fields."""
        if self.name == "mu_pa":
            return f"{self.value / 1e6:g} MPa"
        if self.name.endswith("slope"):
            return f"{math.degrees(math.atan(self.value)):.1f}°"
        unit = " mm" if self.name.endswith("_mm") else "°" if self.name.endswith("_deg") else ""
        return f"{self.value:g}{unit}"


def find_tissue_changes(tissue: Tissue, before: Tissue) -> tuple[Change, ...]:
    """Return the changes that lead from the moduli and shape parameters of one tissue to those of another.

    Both have the same law.
    """
    names = ["mu_pa", *LAWS[tissue.law].shape_names]
    rows, earlier = (np.vstack((one.mu * 1e6, one.shape)).T.tolist() for one in (tissue, before))
    pairs = enumerate(zip(rows, earlier, strict=True), start=1)
    changed = [(n, row) for n, (row, same) in pairs if row != same]
    return tuple(Change(name, n, value) for n, row in changed for name, value in zip(names, row, strict=True))


def apply_changes(step: Step, changes: Iterable[Change], names: Sequence[str], tip_y: float) -> Step:
    """Return the depth and inputs of `step` after some inputs were changed.

    Parameters
    ----------
    changes : iterable of Change
    names : sequence of str
        What the scene calls its guides, in the order of their numbers.
    tip_y : float
        Where the tip stands, mm: it is held there where nothing says another place.

    Raises
    ------
    ModelError
        If the model has no such inputs.
    """
    values = {(change.name, change.item): change.value for change in changes}

    def of(name: str, now: float) -> float:
        return values.get((name, None), now)

    held = step.controls
    controls = Controls(
        of("base_y_mm", held.base_y),
        of("base_slope", held.base_slope),
        held.stage_slope,
        _guides(held.guides, values, names),
        _tip(held.tip, values, tip_y),
    )
    bevel = Bevel(
        of("bevel_offset_mm", step.bevel.offset),
        int(of("bevel_side", step.bevel.side)),
        to_cut_angle(values.get(("cut_angle_deg", None)), step.bevel.cut_angle),
    )
    return Step(of("depth_mm", step.depth), bevel, controls)


def to_cut_angle(degrees: float | None, otherwise: float) -> float:
    """Return an angle of the cut, rad, given in degrees; one that is not given stays to the bit."""
    return otherwise if degrees is None else math.radians(degrees)


def find_changes(step: Step, now: Step, names: Sequence[str]) -> tuple[Change, ...]:
    """Return the changes that turn the inputs of `now` into those of `step`; the depth is not included."""
    wanted, held = step.controls, now.controls
    pairs = [
        ("bevel_side", float(step.bevel.side), float(now.bevel.side)),
        ("bevel_offset_mm", step.bevel.offset, now.bevel.offset),
        ("cut_angle_deg", math.degrees(step.bevel.cut_angle), math.degrees(now.bevel.cut_angle)),
        ("base_y_mm", wanted.base_y, held.base_y),
        ("base_slope", wanted.base_slope, held.base_slope),
    ]
    changes = [Change(name, None, value) for name, value, before in pairs if value != before]
    there = {guide.name: guide for guide in wanted.guides}
    for guide in held.guides:
        if guide.name not in there:
            changes.append(Change("guide_engaged", guide_number(guide, names), 0.0))
    for guide in wanted.guides:
        if guide not in held.guides:
            changes += _guide_changes(guide, guide_number(guide, names))
    if wanted.tip is None and held.tip is not None:
        changes.append(Change("tip_held", None, 0.0))
    elif wanted.tip is not None and wanted.tip != held.tip:
        changes.append(Change("tip_y_mm", None, wanted.tip.y))
        if wanted.tip.slope is not None:
            changes.append(Change("tip_slope", None, wanted.tip.slope))
    return tuple(changes)


def guide_name(item: int, names: Sequence[str]) -> str:
    """Return the name of the guide with this number."""
    return names[item - 1] if item <= len(names) else f"guide {item}"


def guide_number(guide: Guide, names: Sequence[str]) -> int:
    """Return the number of a guide, counted from 1."""
    return names.index(guide.name) + 1 if guide.name in names else int(guide.name.removeprefix("guide "))


def _guides(
    guides: Sequence[Guide], values: dict[tuple[str, int | None], float], names: Sequence[str]
) -> tuple[Guide, ...]:
    now = {guide.name: guide for guide in guides}
    for item in sorted({item for name, item in values if item is not None and INPUTS.get(name) == "guide"}):
        name = guide_name(item, names)
        keys = ("x_mm", "y_mm", "slope", "turns_freely", "engaged")
        moved = {key: values[(f"guide_{key}", item)] for key in keys if (f"guide_{key}", item) in values}
        if moved.get("engaged") == 0:
            now.pop(name, None)
        else:
            now[name] = _move_guide(now.get(name), moved, name)
    return tuple(now.values())


def _move_guide(guide: Guide | None, moved: dict[str, float], name: str) -> Guide:
    if guide is None:
        if not {"x_mm", "y_mm"} <= moved.keys():
            raise ModelError(
                f"there is no {name}",
                expected="guide_x_mm and guide_y_mm together, which make a guide",
                fix="add it before it is moved",
            )
        guide = Guide(moved["x_mm"], moved["y_mm"], 0.0, moved["x_mm"] >= 0, name)
    x, slope = moved.get("x_mm", guide.x), moved.get("slope", guide.slope)
    if "turns_freely" in moved:
        slope = None if moved["turns_freely"] else moved.get("slope", guide.slope or 0.0)
    return replace(guide, x=x, y=moved.get("y_mm", guide.y), slope=slope, in_tissue=x >= 0)


def _guide_changes(guide: Guide, item: int) -> list[Change]:
    place = [Change("guide_x_mm", item, guide.x), Change("guide_y_mm", item, guide.y)]
    if guide.slope is None:
        return [*place, Change("guide_turns_freely", item, 1.0)]
    return [*place, Change("guide_turns_freely", item, 0.0), Change("guide_slope", item, guide.slope)]


def _tip(
    tip: TrackedTip | None, values: dict[tuple[str, int | None], float], tip_y: float
) -> TrackedTip | None:
    if values.get(("tip_held", None)) == 0:
        return None
    if tip is None and not {("tip_held", None), ("tip_y_mm", None)} & values.keys():
        return None
    y, slope = (tip.y, tip.slope) if tip else (tip_y, None)
    return TrackedTip(values.get(("tip_y_mm", None), y), values.get(("tip_slope", None), slope))
