"""Encode a needle for the page: computed values in mm and frame C, ready for JSON."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.mechanics.control import Bevel, Guide, ModelOptions
from needlefit.mechanics.laws import LAWS, ShapeParameter
from needlefit.mechanics.load import Loads, compute_loads
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points
from needlefit.mechanics.tissue import Tissue
from needlefit.metrics import list_metrics
from needlefit.viewer.interaction.inputs import guide_number
from needlefit.viewer.interaction.steering import SteeredNeedle
from needlefit.viewer.overlay.band import NeedleBand
from needlefit.viewer.overlay.measured import compute_live_errors
from needlefit.viewer.viewed_scene import ViewedScene

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
            "x": _round_lengths(measured.points[:, 0]),
            "y": _round_lengths(measured.points[:, 1]),
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
    s = _stations(shape)
    needle = compute_positions(shape, s)  # (K, 2)
    load = compute_loads(shape, now.tissue, steering.scene.needle, controls, steering.scene.rules)
    return {
        "kind": "state",
        "step": steering.number,
        "depth_mm": step.depth,
        "x": _round_lengths(needle[:, 0]),
        "y": _round_lengths(needle[:, 1]),
        "constraints": [_round_lengths(column) for column in map_beam_points(shape, shape.constraints).T],
        "tip_path": [_round_lengths(column) for column in map_beam_points(shape, shape.tip_path).T],
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
        "x": _round_lengths(at[:, 0]),
        "y": _round_lengths(at[:, 1]),
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
    found = compute_live_errors(measured, shape) if measured else None
    if found is None:
        return None
    return {
        **found.values,
        "upto_mm": found.upto,
        "whole": found.whole,
        "floor_mm": found.floor,
    }
