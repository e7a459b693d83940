"""Encode a trial as messages for the page: computed values in mm and frame C, ready for JSON."""

import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.load import Loads, compute_loads
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points
from needlefit.metrics import list_metrics
from needlefit.viewer.interaction.inputs import Change, guide_number
from needlefit.viewer.overlay.band import NeedleBand
from needlefit.viewer.overlay.measured import compute_live_errors
from needlefit.viewer.serving.trials import InteractiveTrial

LENGTH_DIGITS = 4
"""Decimals of drawn lengths in mm."""

POINTS_BEFORE_TISSUE = 25
"""Points of the needle drawn before the tissue."""

SLIDER_FACTOR = 100.0
"""How far beyond the softest and the stiffest layer the sliders of all moduli reach, a factor."""


def scene_message(trial: InteractiveTrial) -> dict[str, Any]:
    """Return the message of all that stays constant: the needle, the layers, the overlays."""
    viewed_scene, scene = trial.viewed_scene, trial.scene
    tissue = scene.tissue
    first = scene.steps[0].bevel
    measured = viewed_scene.measured
    return {
        "kind": "scene",
        "needle": trial.name,
        "title": viewed_scene.title,
        "note": viewed_scene.note,
        "target": viewed_scene.name,
        "synthetic": viewed_scene.synthetic,
        "recording": trial.recorder.path.name,
        "recorded": len(trial.source.steps) if trial.source else 0,
        "length_mm": scene.needle.length,
        "diameter_mm": viewed_scene.diameter,
        "depth_mm": scene.depth,
        "steps": len(scene.steps),
        "layer_names": list(scene.layer_names),
        "guide_names": list(trial.steering.names),
        "boundaries_mm": tissue.boundaries.tolist(),
        "spacing_mm": scene.rules.spacing,
        "fitted": _encode_parameters(tissue.mu, tissue.alpha) | _encode_strength(first, scene.rules),
        "limits": _encode_limits(scene),
        "measured": measured and {
            "id": measured.id,
            "x": _round_lengths(measured.points[:, 0]),
            "y": _round_lengths(measured.points[:, 1]),
            "depth_mm": measured.depth,
            "metrics": [[one.name, one.label, one.unit, one.explanation] for one in list_metrics()],
        },
        "band": viewed_scene.spread is not None,
        "slice": viewed_scene.scanned is not None,
        "choices": list(viewed_scene.choices),
    }  # fmt: skip


def state_message(trial: InteractiveTrial) -> dict[str, Any]:
    """Return the message of all that changes from step to step."""
    steering, now = trial.steering, trial.steering.now
    shape, step, controls = now.shape, now.step, now.step.controls
    s = _stations(shape)
    needle = compute_positions(shape, s)  # (K, 2)
    load = compute_loads(shape, now.tissue, trial.scene.needle, controls, trial.scene.rules)
    return {
        "kind": "state",
        "step": steering.number,
        "time_s": trial.time() if steering.number else 0.0,
        "depth_mm": step.depth,
        "x": _round_lengths(needle[:, 0]),
        "y": _round_lengths(needle[:, 1]),
        "constraints": [_round_lengths(column) for column in map_beam_points(shape, shape.constraints).T],
        "tip_path": [_round_lengths(column) for column in map_beam_points(shape, shape.tip_path).T],
        "load": _encode_load(load, shape),
        "forces": _encode_forces(load, trial),
        "base": _encode_end(needle[0], shape.slope[0])
        | {"input_y": controls.base_y, "input_slope": controls.base_slope},
        "guides": [_encode_guide(guide, trial) for guide in controls.guides],
        "tip": _encode_end(needle[-1], shape.slope[-1])
        | {"deflection_mm": shape.deflection, "held": controls.tip is not None}
        | {"input_y": float(shape.u[-1])},
        "bevel": {"side": step.bevel.side, **_encode_strength(step.bevel, trial.scene.rules)},
        **_encode_parameters(now.tissue.mu, now.tissue.alpha),
        "max_slope": float(shape.validity.max_slope),
        "faults": list(shape.validity.faults),
        "undo": trial.can_undo,
        "redo": trial.can_redo,
        "errors": _encode_errors(trial, shape),
        "solver": {"steps": steering.solved, "rate_per_s": trial.speed, "failed": steering.failed},
    }


def band_message(step: int, band: NeedleBand | None) -> dict[str, Any]:
    """Return the message of the needle's band after a step; without points if there is no band."""
    edges = (band.x, band.low, band.high) if band else (np.empty(0),) * 3
    x, low, high = (_round_lengths(values) for values in edges)
    failed = band.failed if band else 0
    return {"kind": "band", "step": step, "x": x, "low": low, "high": high, "failed": failed}


def _round_lengths(values: Floats) -> list[float]:
    found: list[float] = np.round(values, LENGTH_DIGITS).tolist()
    return found


def _encode_end(place: Floats, slope: float) -> dict[str, float]:
    """Return where an end of the needle stands, and its rotation u', rad."""
    x, y = np.round(place, LENGTH_DIGITS).tolist()
    return {"x": x, "y": y, "rotation": float(slope)}


def _stations(shape: NeedleShape) -> Floats:
    """Return where the needle is drawn: evenly before the tissue, at its nodes within."""
    start = float(shape.x[0])
    return np.unique(
        np.concatenate([np.linspace(start, min(0.0, shape.depth), POINTS_BEFORE_TISSUE), shape.x])
    )


def _encode_parameters(mu: Floats, alpha: Floats) -> dict[str, Any]:
    layers = [{"mu_pa": m * 1e6, "alpha": a} for m, a in zip(mu.tolist(), alpha.tolist(), strict=True)]
    return {"layers": layers}


def _encode_strength(bevel: Bevel, rules: ModelOptions) -> dict[str, float]:
    """Return how strongly a bevel turns the cut, under the key of the rule of advance."""
    if rules.path_angle:
        return {"cut_angle_deg": math.degrees(bevel.cut_angle)}
    return {"offset_mm": bevel.offset}


def _encode_limits(scene: Scene) -> dict[str, Any]:
    """Return how far the page's sliders go; its number fields take what the model takes."""
    mu, alpha, bevel = scene.tissue.mu * 1e6, scene.tissue.alpha, scene.steps[0].bevel
    angle = math.degrees(bevel.cut_angle)
    return {
        "mu_pa": [float(mu.min()) / SLIDER_FACTOR, float(mu.max()) * SLIDER_FACTOR],
        "alpha": [min(-10.0, float(alpha.min()) - 5), max(10.0, float(alpha.max()) + 5)],
        **(
            {"cut_angle_deg": [0.0, min(max(10.0, 3 * angle), 44.0)]}
            if scene.rules.path_angle
            else {"offset_mm": [0.0, max(0.3, 3 * bevel.offset)]}
        ),
        "base_y_mm": [-30.0, 30.0],
        "speed_mm_s": 100.0,
        "depth_mm": scene.needle.length,
    }


def _encode_load(load: Loads, shape: NeedleShape) -> dict[str, list[float]]:
    if not len(load.s):
        return {"x": [], "y": [], "n_per_mm": []}
    at = compute_positions(shape, load.s)
    return {
        "x": _round_lengths(at[:, 0]),
        "y": _round_lengths(at[:, 1]),
        "n_per_mm": np.round(load.load, 6).tolist(),
    }


def _encode_forces(load: Loads, trial: InteractiveTrial) -> dict[str, Any]:
    guides = zip(trial.steering.now.step.controls.guides, load.guides, strict=True)
    return {
        "tip_n": load.tip_force,
        "base_n": load.base.force,
        "base_nmm": load.base.moment,
        "guides_n": {str(guide_number(guide, trial.steering.names)): hold.force for guide, hold in guides},
    }


def _encode_guide(guide: Guide, trial: InteractiveTrial) -> dict[str, Any]:
    return {
        "item": guide_number(guide, trial.steering.names),
        "name": guide.name,
        "x": guide.x,
        "y": guide.y,
        "slope": guide.slope or 0.0,
        "turns_freely": guide.slope is None,
        "in_tissue": guide.in_tissue,
    }


def _encode_errors(trial: InteractiveTrial, shape: NeedleShape) -> dict[str, Any] | None:
    measured = trial.viewed_scene.measured
    found = compute_live_errors(measured, shape) if measured else None
    if found is None:
        return None
    return {
        **found.values,
        "upto_mm": found.upto,
        "whole": found.whole,
        "floor_mm": found.floor,
    }


ACTIONS = frozenset(
    (
        *("hello", "change", "move", "halt", "frame", "undo", "redo", "reset", "play", "replay", "show"),
        *("aim", "markups", "plan", "run", "challenge"),
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

    def number(self, key: str, default: float | None = None, most: float = math.inf) -> float:
        """Return a finite number of the message; without a default it is required."""
        value = self.content.get(key, default)
        found = _finite(value)
        if found is None or abs(found) > most:
            upto = f", at most {most:g}" if math.isfinite(most) else ""
            raise ModelError(f"{key} is {value!r:.40}", expected=f"a finite number{upto}")
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


def read_message(text: str) -> Message:
    """Return the message that a text contains.

    It has a fault if it is no JSON, or asks for an unknown action, an input that does not exist, or one that
    is not finite; the reply names its number where it can be read.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        return Message(
            "", fault=ModelError("the message is no JSON", expected="an object with `do` and `id`")
        )
    identity = content.get("id")
    number = identity if type(identity) is int else 0
    try:
        if (
            not isinstance(content.get("do"), str)
            or content["do"] not in ACTIONS
            or type(identity) is not int
        ):
            raise ModelError(
                "the message names no action", expected=f"`id`, and `do`: {', '.join(sorted(ACTIONS))}"
            )
        return Message(content["do"], number, _changes(content.get("set", [])), content)
    except ModelError as error:
        return Message("", number, fault=error)


def _changes(rows: object) -> tuple[Change, ...]:
    if not isinstance(rows, list) or len(rows) > MAX_CHANGES:
        raise ModelError("`set` holds no inputs", expected=f"up to {MAX_CHANGES} of [input, item, value]")
    return tuple(_change(row) for row in rows)


def _change(row: object) -> Change:
    if not (isinstance(row, list) and len(row) == 3):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    name, item, value = row
    number = _finite(value)
    if number is None:
        raise ModelError(f"{name!r:.40} is {value!r:.40}", expected="a finite number")
    if not isinstance(name, str) or not (item is None or type(item) is int):
        raise ModelError(f"{row!r:.60} is no input", expected="[input, item, value]")
    return Change(name[:40], item, number)


def _finite(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
