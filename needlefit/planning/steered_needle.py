"""The needle that a user controls: its inputs (`mechanics.inputs`), one change of them, and what it does.

V-inputs act on the needle's shape (base, guides, a tracked tip), H-inputs on how far it is in and where it
cuts (depth, bevel). The moduli and a bevel strength throughout are no inputs of an insertion but parameters
of the model: with them the insertion so far is simulated again.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from needlefit.errors import ConfigError, ModelError
from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.inputs import MAX_GUIDE_NUMBER, find_input
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.scene import Scene, begin_session
from needlefit.mechanics.session import NeedleState, Session
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import find_roll
from needlefit.schemas.limits import MAX_NEEDLE_LENGTH_MM, MAX_NUMBER
from needlefit.schemas.scene import SceneRecord


def make_steered_scene(record: SceneRecord, where: str) -> Scene:
    """Return the scene of a needle to steer; `where` is named in errors.

    ConfigError if the model does not take it, or its needle leaves the plane z = 0 by other inputs than the
    roll of the bevel.
    """
    scene = Scene.from_record(record, where)
    if scene.tissue.torsional_friction or any(step.controls.act_along_z for step in scene.steps):
        raise ConfigError(
            "its tip lags behind the hub, or its base, guides or tip have inputs along z",
            expected="a needle that its bevel alone leads out of the plane",
            fix="`needlefit simulate` computes it",
            where=where,
        )
    return scene


def name_guides(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Return a scene all of whose guides have a name, and the names in the order of their numbers."""
    steps = []
    for step in scene.steps:
        guides = tuple(replace(guide, name=guide.name or "guide") for guide in step.controls.guides)
        steps.append(replace(step, controls=replace(step.controls, guides=guides)))
    names = tuple(dict.fromkeys(guide.name for step in steps for guide in step.controls.guides))
    return replace(scene, steps=tuple(steps)), names


@dataclass(frozen=True)
class Change:
    """One input and its new value; ModelError if it is no such input or value."""

    name: str  #: a key of `INPUTS`, with its unit, or a shape parameter of a law; slopes are dy/dx
    item: int | None  #: number of the guide or layer, from 1
    value: float

    def __post_init__(self) -> None:
        input_ = find_input(self.name)
        if (self.item is None) != (input_.item is None) or (self.item is not None and self.item < 1):
            wanted = f"the number of a {input_.item}, from 1" if input_.item else "no item"
            raise ModelError(f"{self.name} has item {self.item!s:.20}", expected=wanted)
        if input_.item == "guide" and self.item is not None and self.item > MAX_GUIDE_NUMBER:
            raise ModelError(
                f"guides have no number {self.item!s:.20}", expected=f"a number from 1 to {MAX_GUIDE_NUMBER}"
            )
        most = MAX_NEEDLE_LENGTH_MM if self.name.endswith("_mm") else MAX_NUMBER
        finite = abs(self.value) <= most
        whole = self.name != "return_to" or float(self.value).is_integer()
        if not finite or not input_.allows(self.value) or not whole:
            largest = f"a finite number, at most {most:g}"
            where = "" if self.item is None else f" of {input_.item} {self.item}"
            expected = input_.expected if finite and input_.expected else largest
            raise ModelError(f"{self.name}{where} is {self.value:g}", expected=expected)

    @property
    def is_parameter(self) -> bool:
        """Whether it is a parameter of the model, which applies to the whole insertion."""
        return find_input(self.name).parameter


Values = dict[tuple[str, int | None], float]


def apply_changes(
    step: Step, changes: Iterable[Change], names: Sequence[str], stands: tuple[float, float]
) -> Step:
    """Return the depth and inputs of `step` after some inputs were changed.

    ModelError if the model has no such inputs.

    Parameters
    ----------
    changes : iterable of Change
    names : sequence of str
        What the scene calls its guides, in the order of their numbers.
    stands : (y, z)
        Where the tip stands, mm: it is held there where nothing says another place.
    """
    values: Values = {(change.name, change.item): change.value for change in changes}

    def of(name: str, now: float) -> float:
        return values.get((name, None), now)

    held, tip, angle = step.controls, step.controls.tip, values.get(("cut_angle_deg", None))
    if of("tip_held", 1.0) == 0:
        tip = None
    elif tip is not None or {("tip_held", None), ("tip_y_mm", None)} & values.keys():
        y, slope, z = (tip.y, tip.slope, tip.z) if tip else (stands[0], None, stands[1])
        tip = TrackedTip(of("tip_y_mm", y), values.get(("tip_slope", None), slope), z)
    controls = Controls(
        of("base_y_mm", held.base_y),
        of("base_slope", held.base_slope),
        held.stage_slope,
        _apply_to_guides(held.guides, values, names),
        tip,
    )
    side = values.get(("bevel_side", None))
    roll = find_roll(step.bevel) if side is None else 0.0 if side > 0 else 180.0
    bevel = Bevel.turn(
        of("bevel_roll_deg", roll),
        of("bevel_offset_mm", step.bevel.offset),
        step.bevel.cut_angle if angle is None else math.radians(angle),  # stays to the bit
    )
    return Step(of("depth_mm", step.depth), bevel, controls)


def find_changes(step: Step, now: Step, names: Sequence[str]) -> tuple[Change, ...]:
    """Return the changes that turn the inputs of `now` into those of `step`; the depth is not included."""
    wanted, held = step.controls, now.controls
    turned = ("bevel_side", float(step.bevel.side), float(now.bevel.side))
    if step.bevel.roll_deg or now.bevel.roll_deg:
        turned = ("bevel_roll_deg", find_roll(step.bevel), find_roll(now.bevel))
    pairs = [
        turned,
        ("bevel_offset_mm", step.bevel.offset, now.bevel.offset),
        ("cut_angle_deg", math.degrees(step.bevel.cut_angle), math.degrees(now.bevel.cut_angle)),
        ("base_y_mm", wanted.base_y, held.base_y),
        ("base_slope", wanted.base_slope, held.base_slope),
    ]
    changes = [Change(name, None, value) for name, value, before in pairs if value != before]
    there = {guide.name for guide in wanted.guides}
    for guide in held.guides:
        if guide.name not in there:
            changes.append(Change("guide_engaged", guide_number(guide, names), 0.0))
    for guide in wanted.guides:
        if guide not in held.guides:
            item = guide_number(guide, names)
            changes += [Change("guide_x_mm", item, guide.x), Change("guide_y_mm", item, guide.y)]
            changes.append(Change("guide_turns_freely", item, float(guide.slope is None)))
            if guide.slope is not None:
                changes.append(Change("guide_slope", item, guide.slope))
    if wanted.tip is None and held.tip is not None:
        changes.append(Change("tip_held", None, 0.0))
    elif wanted.tip is not None and wanted.tip != held.tip:
        changes.append(Change("tip_y_mm", None, wanted.tip.y))
        if wanted.tip.slope is not None:
            changes.append(Change("tip_slope", None, wanted.tip.slope))
    return tuple(changes)


def list_scene_changes(
    steps: Sequence[Step], names: Sequence[str]
) -> list[list[tuple[str, int | None, float]]]:
    """Return the changes of each step of a scene, which lead its needle from first contact to its end."""
    before = (steps[0], *steps)
    return [
        [
            *((one.name, one.item, one.value) for one in find_changes(step, now, names)),
            ("depth_mm", None, step.depth),
        ]
        for step, now in zip(steps, before, strict=False)
    ]


def guide_number(guide: Guide, names: Sequence[str]) -> int:
    """Return the number of a guide, counted from 1."""
    return names.index(guide.name) + 1 if guide.name in names else int(guide.name.removeprefix("guide "))


def _apply_to_guides(guides: Sequence[Guide], values: Values, names: Sequence[str]) -> tuple[Guide, ...]:
    now, moves = {guide.name: guide for guide in guides}, dict[int, dict[str, float]]()
    for (input_name, item), value in values.items():
        if item is not None and input_name.startswith("guide_"):
            moves.setdefault(item, {})[input_name.removeprefix("guide_")] = value
    for item, moved in sorted(moves.items()):
        name = names[item - 1] if item <= len(names) else f"guide {item}"
        if moved.get("engaged") == 0:
            now.pop(name, None)
            continue
        if (guide := now.get(name)) is None:
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
        now[name] = replace(guide, x=x, y=moved.get("y_mm", guide.y), slope=slope, in_tissue=x >= 0)
    return tuple(now.values())


class SteeredNeedle:
    """The needle of a scene, simulated step by step from first contact on.

    The same changes in the same order find the same bits, here and in the page (`page/model/steered.js`).
    `first_cell` is the depth of the first constraint point, mm.
    """

    def __init__(self, scene: Scene, first_cell: float) -> None:
        self.scene, self.names = name_guides(scene)
        self.number = 0  #: steps so far
        self._session = begin_session(self.scene, first_cell)
        self._saved: dict[int, Session] = {}
        self.keep()

    @property
    def now(self) -> NeedleState:
        return self._session.now

    @property
    def first_cell(self) -> float:
        """Depth of the first constraint point, mm."""
        return self._session.lattice.first_cell

    def input_path(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead to the present state."""
        return self._session.input_path()

    def apply(self, changes: Sequence[Change]) -> NeedleState:
        """Carry out one step: all changes at once.

        ModelError if the model does not take them, or finds no needle that does; then nothing has happened.
        """
        inputs = [(change.name, change.item) for change in changes]
        for name, item in inputs:
            if inputs.count((name, item)) > 1:
                raise ModelError(f"{name} has two values in one step", expected="one value for each input")
            if name == "return_to" and len(inputs) > 1:
                raise ModelError("return_to stands beside other inputs", expected="a step of its own")
        if changes and changes[0].name == "return_to":
            number = int(changes[0].value)
            if number not in self._saved:
                raise ModelError(f"nothing was kept of step {number}", expected="a step to return to")
            # A copy: the stored state must survive further steps, for another return.
            self._session = self._saved[number].copy()
        else:
            self._session = self._advance(changes)
        self.number += 1
        return self.now

    def keep(self) -> None:
        self._saved[self.number] = self._session.copy()

    def forget(self, number: int) -> None:
        """Delete the state stored at a step; the initial state stays."""
        if number:
            self._saved.pop(number, None)

    def _advance(self, changes: Sequence[Change]) -> Session:
        """Return the session after a step; the one there is stays as it was if that fails."""
        session = self._session
        parameters = [change for change in changes if change.is_parameter]
        if parameters:
            given = {change.name: change.value for change in parameters}
            angle = given.get("cut_angle_throughout_deg")
            session = session.simulate_again(
                _with_parameters(session.tissue, parameters),
                given.get("offset_throughout_mm"),
                None if angle is None else math.radians(angle),
            )
            _require_found(
                not session.failures,
                f"with these parameters the insertion so far fails {session.depth:.1f} mm deep",
                "change them less, or retract the needle first",
            )
        moved = [change for change in changes if not change.is_parameter]
        shape = session.now.shape
        stands = float(shape.u[-1]), float(shape.w[-1])
        step = apply_changes(session.last, moved, self.names, stands)
        if step != session.last:
            shape = session.go(step)
            problem = f"the model finds no needle there ({shape.status})"
            _require_found(shape.converged, problem, "move less at a time")
        return session


def _require_found(is_found: bool, problem: str, fix: str) -> None:
    if not is_found:
        raise ModelError(problem, fix=fix)


def _with_parameters(tissue: Tissue, parameters: Sequence[Change]) -> Tissue:
    """Return the tissue with other moduli (Pa in the changes, MPa in the tissue) and shape parameters."""
    mu, shape = tissue.mu.copy(), tissue.shape.copy()
    names = LAWS[tissue.law].shape_names
    for change in parameters:
        if change.item is None:
            continue
        if change.item > tissue.layers:
            raise ModelError(
                f"there is no layer {change.item!s:.20}", expected=f"one of {tissue.layers} layers"
            )
        if change.name == "mu_pa":
            mu[change.item - 1] = change.value * 1e-6
        elif change.name in names:
            shape[names.index(change.name), change.item - 1] = change.value
        else:
            raise ModelError(
                f"the tissue law `{tissue.law}` has no {change.name}", expected=", ".join(["mu_pa", *names])
            )
    return replace(tissue, mu=mu, shape=shape, is_checked=True)
