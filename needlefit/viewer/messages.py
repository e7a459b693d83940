"""The messages between a needle and its page, as values for JSON; lengths in mm, frame C."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from needlefit.arrays import Floats, are_bounded
from needlefit.errors import ModelError, NeedlefitError
from needlefit.mechanics.laws import LAWS, PowerLaw
from needlefit.mechanics.packing import compile_law
from needlefit.mechanics.tissue import Tissue
from needlefit.planning.recording import RecordedStep
from needlefit.planning.steered_needle import Change, SteeredNeedle
from needlefit.project.json_values import parse_json_text
from needlefit.reporting import needle_page
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.viewer.overlays import MeasuredOverlay, choose_band_draws
from needlefit.viewer.viewed_scene import ViewedScene

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws

LENGTH_DIGITS = 4  #: decimals of drawn lengths in mm


def encode_scene(viewed_scene: ViewedScene, steering: SteeredNeedle) -> dict[str, Any]:
    """Return all that stays constant: the needle, the layers, the overlays."""
    scene = steering.scene
    measured = viewed_scene.measured
    return {
        **needle_page.encode_scene(scene, steering.first_cell, steering.names),
        "title": viewed_scene.title,
        "note": viewed_scene.note,
        "target": viewed_scene.name,
        "origin_mark": viewed_scene.origin_mark,
        "diameter_mm": viewed_scene.diameter,
        "measured": measured and {
            "id": measured.id,
            "depth_mm": measured.depth,
            **encode_measured(measured),
        },
        "draws": None if viewed_scene.spread is None else encode_draws(viewed_scene.spread, scene.tissue.law),
        "choices": list(viewed_scene.choices.items()),
    }  # fmt: skip


def encode_measured(measured: MeasuredOverlay) -> dict[str, Any]:
    """Return a measured needle as the page draws and compares it."""
    target = measured.target
    points, compared = (
        dict(zip("xyz", one.T.tolist(), strict=True)) for one in (measured.points, target.measured)
    )
    return {
        "metrics": needle_page.encode_metrics(),
        "compared": target.compared,
        **points,
        "s": measured.s.tolist(),
        "floor_mm": measured.floor,
        "prediction": measured.prediction,
        "target": {"pose": target.pose, "s": target.s.tolist(), **compared},
    }


def encode_recorded(step: RecordedStep) -> list[Any]:
    """Return a step that the page is to carry out."""
    changes = [[change.name, change.item, change.value] for change in step.changes]
    return [step.number, step.time, step.gesture, changes, step.tip_lateral]


def encode_law(law: str, shape: Floats) -> list[float]:
    """Return the law of all layers at shape parameters (..., p, n) as the kernel has it, or a ModelError."""
    return np.concatenate(compile_law(law, shape), axis=-1).ravel().tolist()


def compile_asked_law(tissue: Tissue, rows: object) -> list[float]:
    """Return the law of all layers at shape parameters that a page sent; ModelError if they are none."""
    try:
        shape = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError):
        shape = np.empty(0)
    if shape.shape != tissue.shape.shape or not are_bounded(shape, MAX_NUMBER):
        raise ModelError("these are no shape parameters", expected="a number for each layer")
    return encode_law(tissue.law, shape)


def encode_tables(tissue: Tissue, steps: Sequence[RecordedStep]) -> list[Any]:
    """Return shape parameters and law for all that occur in steps; none where the page computes the law."""
    names = LAWS[tissue.law].shape_names
    if isinstance(LAWS[tissue.law], PowerLaw):
        return []
    after, found = {0: tissue.shape}, dict[str, Any]()
    for number, step in enumerate(steps, start=1):
        first, shape = step.changes[0], after[number - 1]
        if first.name == "return_to":
            shape = after.get(int(first.value), shape)
        for change in step.changes:
            if change.name in names and change.item is not None and change.item <= tissue.layers:
                shape = shape.copy()
                shape[names.index(change.name), change.item - 1] = change.value
        after[number] = shape
        if shape is not tissue.shape:
            found.setdefault(str(shape.tolist()), [shape.tolist(), encode_law(tissue.law, shape)])
    return list(found.values())


def encode_draws(spread: "ParameterDraws", law: str) -> dict[str, Any]:
    """Return the draws of a band: of each, mu and law of every layer, and the strength of the bevel."""
    drawn = spread.only(choose_band_draws(spread))
    return {
        "sets": len(drawn),
        "mu": drawn.mu.ravel().tolist(),
        "law": encode_law(law, drawn.shape),
        "strength": drawn.bevel.tolist(),
    }


def encode_fault(error: NeedlefitError) -> dict[str, str]:
    """Return the parts of an error that a page shows."""
    return {name: getattr(error, name) for name in ("what", "expected", "fix")}


def round_lengths(values: Floats) -> list[float]:
    """Return drawn lengths, mm, as numbers for JSON."""
    return np.round(values, LENGTH_DIGITS).tolist()


ACTIONS = {"hello", "steps", "show", "plan"}
MAX_CHANGES = 64  #: number of inputs that one step may set
MAX_MESSAGE_STEPS = 16  #: number of steps of one message


@dataclass(frozen=True)
class Message:
    """One message from the page."""

    do: str  #: one of `ACTIONS`
    id: int = 0  #: the page's own number of it; answers name it
    steps: tuple[RecordedStep, ...] = ()  #: that a page has carried out
    content: dict[str, Any] = field(default_factory=dict)  #: all other keys of the message
    fault: ModelError | None = None  #: why it cannot be carried out

    def text(self, key: str) -> str:
        """Return a text of the message; empty if there is none."""
        value = self.content.get(key)
        return value if isinstance(value, str) else ""


def read_message(text: str) -> Message:
    """Return the message that a text contains.

    It has a fault if it is no JSON, or asks for an unknown action, an input that does not exist, or one that
    is not finite; the reply names its number where it can be read.
    """
    try:
        content = parse_json_text(text)
    except ValueError:
        content = None
    if not isinstance(content, dict):
        fault = ModelError("the message is no JSON", expected="an object with `do` and `id`")
        return Message("", fault=fault)
    number, action = content.get("id"), content.get("do")
    known = number if type(number) is int else 0
    try:
        if not isinstance(action, str) or action not in ACTIONS or type(number) is not int:
            expected = f"`id`, and `do`: {', '.join(sorted(ACTIONS))}"
            raise ModelError("the message names no action", expected=expected)
        steps = content.get("steps", [])
        if not isinstance(steps, list) or len(steps) > MAX_MESSAGE_STEPS:
            raise ModelError("`steps` holds no steps", expected=f"up to {MAX_MESSAGE_STEPS} of them")
        return Message(action, known, tuple(map(_read_step, steps)), content)
    except ModelError as error:
        return Message("", known, fault=error)


def _read_step(row: Any) -> RecordedStep:  # noqa: ANN401 - whatever a page sent
    """Return a step: its number, time, gesture, changes, and the tip's lateral displacement after it."""
    try:
        number, time, gesture, changes, tip = row
        # a sum refuses what is no number; a `Change` names its own limit, in the unit of its field
        made = tuple(Change(name[:40], item, value + 0.0) for name, item, value in changes)
        time, tip = time + 0.0, tip + 0.0
        fits = type(number) is int and are_bounded([time, tip]) and time >= 0 and 0 < len(made) <= MAX_CHANGES
        fits = fits and all(one.item is None or type(one.item) is int for one in made)
    except (OverflowError, TypeError, ValueError):
        fits = False
    if not fits:
        expected = f"[number, time, gesture, changes, tip], with up to {MAX_CHANGES} of [input, item, value]"
        raise ModelError(f"{row!r:.60} is no step", expected=expected)
    known = type(gesture) is int or gesture in ("undo", "redo")
    return RecordedStep(number, time, made, tip, gesture=gesture if known else None)
