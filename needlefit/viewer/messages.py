"""The messages between a needle and its page, as values for JSON; lengths in mm, frame C."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.laws import LAWS, ShapeParameter
from needlefit.mechanics.load import Loads, compute_loads
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points
from needlefit.mechanics.tissue import Tissue
from needlefit.metrics import list_metrics
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.viewer.opening import ViewedScene
from needlefit.viewer.overlays import NeedleBand, compute_live_errors
from needlefit.viewer.steering import Change, SteeredNeedle, guide_number

LENGTH_DIGITS = 4
"""Decimals of drawn lengths in mm."""

POINTS_BEFORE_TISSUE = 25
"""Points of the needle drawn before the tissue."""

SLIDER_FACTOR = 100.0
"""How far beyond the softest and the stiffest layer the sliders of all moduli reach, a factor."""


def encode_scene(viewed_scene: ViewedScene, steering: SteeredNeedle) -> dict[str, Any]:
    """Return all that stays constant: the needle, the layers, the overlays."""
    scene = steering.scene
    tissue = scene.tissue
    first = scene.steps[0].bevel
    measured = viewed_scene.measured
    return {
        "kind": "scene",
        "title": viewed_scene.title,
        "note": viewed_scene.note,
        "target": viewed_scene.name,
        "synthetic": viewed_scene.synthetic,
        "length_mm": scene.needle.length,
        "diameter_mm": viewed_scene.diameter,
        "depth_mm": scene.depth,
        "steps": len(scene.steps),
        "layer_names": list(scene.layer_names),
        "guide_names": list(steering.names),
        "boundaries_mm": tissue.boundaries.tolist(),
        "spacing_mm": scene.rules.spacing,
        "first_cell_mm": steering.first_cell,
        "shape_parameters": [
            {"name": one.name, "symbol": one.symbol, "unit": one.unit, "explanation": one.explanation}
            for one in LAWS[tissue.law].parameters
        ],
        "fitted": _encode_parameters(tissue) | _encode_strength(first, scene.rules),
        "limits": _encode_limits(scene),
        "measured": measured and {
            "id": measured.id,
            "x": round_lengths(measured.points[:, 0]),
            "y": round_lengths(measured.points[:, 1]),
            "depth_mm": measured.depth,
            "metrics": [[one.name, one.label, one.unit, one.explanation] for one in list_metrics()],
        },
        "band": viewed_scene.spread is not None,
        "fit": _count_insertions(viewed_scene),
        "slice": viewed_scene.scanned is not None,
        "choices": list(viewed_scene.choices),
    }  # fmt: skip


def _count_insertions(viewed_scene: ViewedScene) -> dict[str, int] | None:
    """Return how many insertions a live fit can take; None where nothing is measured."""
    shown = viewed_scene.shown
    if shown is None or viewed_scene.record.rules.advance != "tangent":
        return None
    same = [one for one in shown.dataset.insertions if one.medium == shown.insertion.medium]
    of_specimen = [one for one in same if one.specimen == shown.insertion.specimen]
    return {"insertion": 1, "specimen": len(of_specimen), "dataset": len(same)}


def encode_state(viewed_scene: ViewedScene, steering: SteeredNeedle) -> dict[str, Any]:
    """Return all that changes from step to step."""
    now = steering.now
    shape, step, controls = now.shape, now.step, now.step.controls
    start = float(shape.x[0])
    before = np.linspace(start, min(0.0, shape.depth), POINTS_BEFORE_TISSUE)
    needle = compute_positions(shape, np.unique(np.concatenate([before, shape.x])))  # (K, 2)
    load = compute_loads(shape, now.tissue, steering.scene.needle, controls, steering.scene.rules)
    return {
        "kind": "state",
        "step": steering.number,
        "depth_mm": step.depth,
        "x": round_lengths(needle[:, 0]),
        "y": round_lengths(needle[:, 1]),
        "constraints": [round_lengths(column) for column in map_beam_points(shape, shape.constraints).T],
        "tip_path": [round_lengths(column) for column in map_beam_points(shape, shape.tip_path).T],
        "load": _encode_load(load, shape),
        "forces": _encode_forces(load, steering),
        "base": _encode_end(needle[0], shape.slope[0])
        | {"input_y": controls.base_y, "input_slope": controls.base_slope},
        "guides": [_encode_guide(guide, steering) for guide in controls.guides],
        "tip": _encode_end(needle[-1], shape.slope[-1])
        | {"lateral_mm": shape.tip_lateral, "held": controls.tip is not None}
        | {"input_y": float(shape.u[-1])},
        "bevel": {"side": step.bevel.side, **_encode_strength(step.bevel, steering.scene.rules)},
        **_encode_parameters(now.tissue),
        "max_slope": float(shape.validity.max_slope),
        "faults": list(shape.validity.faults),
        "errors": _encode_errors(viewed_scene, shape),
    }


def encode_band(step: int, band: NeedleBand | None) -> dict[str, Any]:
    """Return the needle's band after a step; without points if there is no band."""
    edges = (band.x, band.low, band.high) if band else (np.empty(0),) * 3
    x, low, high = (round_lengths(values) for values in edges)
    failed = band.failed if band else 0
    return {"kind": "band", "step": step, "x": x, "low": low, "high": high, "failed": failed}


def round_lengths(values: Floats) -> list[float]:
    """Return drawn lengths, mm, as numbers for JSON."""
    found: list[float] = np.round(values, LENGTH_DIGITS).tolist()
    return found


def _encode_end(place: Floats, slope: float) -> dict[str, float]:
    """Return where an end of the needle stands, and its rotation u', rad."""
    x, y = np.round(place, LENGTH_DIGITS).tolist()
    return {"x": x, "y": y, "rotation": float(slope)}


def _encode_parameters(tissue: Tissue) -> dict[str, Any]:
    names = ["mu_pa", *LAWS[tissue.law].shape_names]
    rows = np.vstack((tissue.mu * 1e6, tissue.shape))
    return {"layers": [dict(zip(names, layer, strict=True)) for layer in rows.T.tolist()]}


def _encode_strength(bevel: Bevel, rules: ModelOptions) -> dict[str, float]:
    """Return how strongly a bevel turns the cut, under the key of the rule of advance."""
    if rules.path_angle:
        return {"cut_angle_deg": math.degrees(bevel.cut_angle)}
    return {"offset_mm": bevel.offset}


def _encode_limits(scene: Scene) -> dict[str, Any]:
    """Return how far the page's sliders go; its number fields take what the model takes."""
    mu, bevel = scene.tissue.mu * 1e6, scene.steps[0].bevel
    shape = zip(LAWS[scene.tissue.law].parameters, scene.tissue.shape.tolist(), strict=True)
    angle = math.degrees(bevel.cut_angle)
    return {
        "mu_pa": [float(mu.min()) / SLIDER_FACTOR, float(mu.max()) * SLIDER_FACTOR],
        **{one.name: _encode_shape_limits(one, values) for one, values in shape},
        **(
            {"cut_angle_deg": [0.0, min(max(10.0, 3 * angle), 44.0)]}
            if scene.rules.path_angle
            else {"offset_mm": [0.0, max(0.3, 3 * bevel.offset)]}
        ),
        "base_y_mm": [-30.0, 30.0],
        "speed_mm_s": 100.0,
        "depth_mm": scene.needle.length,
    }


def _encode_shape_limits(parameter: ShapeParameter, values: Sequence[float]) -> list[float]:
    low, high = parameter.tested
    (least, most), reach = parameter.bounds, 0.25 * (high - low)
    return [max(least, min(low, min(values) - reach)), min(most, max(high, max(values) + reach))]


def _encode_load(load: Loads, shape: NeedleShape) -> dict[str, list[float]]:
    if not len(load.s):
        return {"x": [], "y": [], "n_per_mm": []}
    at = compute_positions(shape, load.s)
    return {
        "x": round_lengths(at[:, 0]),
        "y": round_lengths(at[:, 1]),
        "n_per_mm": np.round(load.load, 6).tolist(),
    }


def _encode_forces(load: Loads, steering: SteeredNeedle) -> dict[str, Any]:
    guides = zip(steering.now.step.controls.guides, load.guides, strict=True)
    return {
        "tip_n": load.tip_force,
        "base_n": load.base.force,
        "base_nmm": load.base.moment,
        "guides_n": {str(guide_number(guide, steering.names)): hold.force for guide, hold in guides},
    }


def _encode_guide(guide: Guide, steering: SteeredNeedle) -> dict[str, Any]:
    return {
        "item": guide_number(guide, steering.names),
        "name": guide.name,
        "x": guide.x,
        "y": guide.y,
        "slope": guide.slope or 0.0,
        "turns_freely": guide.slope is None,
        "in_tissue": guide.in_tissue,
    }


def _encode_errors(viewed_scene: ViewedScene, shape: NeedleShape) -> dict[str, Any] | None:
    measured = viewed_scene.measured
    found = None if measured is None else compute_live_errors(measured, shape)
    if measured is None or found is None:
        return None
    return {**found.values, "upto_mm": found.upto, "whole": found.whole, "floor_mm": measured.floor}


ACTIONS = frozenset(
    (
        *("hello", "change", "move", "halt", "frame", "undo", "redo", "reset", "play", "replay", "show"),
        *("aim", "markups", "plan", "run", "challenge", "fit", "points", "align"),
        *("release_tracker", "forget_estimate"),
    )
)

MAX_CHANGES = 64
"""Number of inputs that one message may set."""

MAX_SPEED_MM_S = 1000.0
"""mm/s."""

MAX_REPLAY_SPEED = 1000.0
"""Greatest speed of a replay, as a multiple of the recorded speed."""


@dataclass(frozen=True)
class Message:
    """One message from the page.

    Attributes
    ----------
    do : str
        One of `ACTIONS`.
    id : int
        The page's own number of it; answers name it.
    content : dict
        All other keys of the message.
    fault : ModelError or None
        Why it cannot be carried out.
    """

    do: str
    id: int = 0
    changes: tuple[Change, ...] = ()
    content: dict[str, Any] = field(default_factory=dict)
    fault: ModelError | None = None

    def number(self, key: str, default: float | None = None, most: float = math.inf, unit: str = "") -> float:
        """Return a finite number of the message; without a default it is required."""
        value = self.content.get(key, default)
        found = _read_finite(value)
        if found is None or abs(found) > most:
            upto = f", at most {most:g} {unit}".rstrip() if math.isfinite(most) else ""
            raise ModelError(f"{key} is {value!r:.40} {unit}".rstrip(), expected=f"a finite number{upto}")
        return found

    def text(self, key: str) -> str:
        """Return a text of the message; empty if there is none."""
        value = self.content.get(key)
        return value if isinstance(value, str) else ""

    @property
    def gesture(self) -> int | None:
        """The gesture to which the message belongs, if any."""
        value = self.content.get("gesture")
        return value if isinstance(value, int) and not isinstance(value, bool) else None


def parse_json(text: str | bytes) -> Any:  # noqa: ANN401 - JSON
    """Return the value in a JSON text.

    Raises
    ------
    ValueError
        If it is none, nests too deeply, or has half of a pair of surrogates, which no text can be made of.
    """
    try:
        content = json.loads(text)
        json.dumps(content, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return content


def read_message(text: str) -> Message:
    """Return the message that a text contains.

    It has a fault if it is no JSON, or asks for an unknown action, an input that does not exist, or one that
    is not finite; the reply names its number where it can be read.
    """
    try:
        content = parse_json(text)
    except ValueError:
        content = None
    if not isinstance(content, dict):
        fault = ModelError("the message is no JSON", expected="an object with `do` and `id`")
        return Message("", fault=fault)
    number, action, rows = content.get("id"), content.get("do"), content.get("set", [])
    known = number if type(number) is int else 0
    try:
        if not isinstance(action, str) or action not in ACTIONS or type(number) is not int:
            expected = f"`id`, and `do`: {', '.join(sorted(ACTIONS))}"
            raise ModelError("the message names no action", expected=expected)
        if not isinstance(rows, list) or len(rows) > MAX_CHANGES:
            expected = f"up to {MAX_CHANGES} of [input, item, value]"
            raise ModelError("`set` holds no inputs", expected=expected)
        return Message(action, known, tuple(map(_read_change, rows)), content)
    except ModelError as error:
        return Message("", known, fault=error)


def _read_change(row: object) -> Change:
    if not (isinstance(row, list) and len(row) == 3):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    name, item, value = row
    number = _read_finite(value, math.inf)  # a `Change` names its own limit, in the unit of its field
    if number is None:
        raise ModelError(f"{name!r:.40} is {value!r:.40}", expected="a finite number")
    if not isinstance(name, str) or not (item is None or type(item) is int):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    return Change(name[:40], item, number)


def _read_finite(value: object, most: float = MAX_NUMBER) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if abs(number) <= most else None
