"""What the page shows of a needle, computed in Python: the reference of `page/model/state.js`."""

import math
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.geometry.curves import COMPARISON_POINTS, compare_curves
from needlefit.inference.compared_points import align, align_points
from needlefit.inference.curve_bands import find_bands
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.shape import compute_positions, list_planes, map_beam_points
from needlefit.mechanics.torsion import find_roll
from needlefit.metrics import compute_metrics
from needlefit.planning.steered_needle import guide_number
from needlefit.planning.steering import StartedInsertion
from needlefit.reporting.needle_page import SHOWN_METRICS, choose_evenly, encode_layers, encode_strength
from needlefit.studies.needle_placement import BAND_PROBABILITY, NEEDLE_POINTS
from needlefit.viewer.overlays import MAX_BAND_DRAWS
from needlefit.viewer.page_needle import LENGTH_DIGITS

POINTS_BEFORE_TISSUE = 25  # points of the needle drawn before the tissue


def compute_live_errors(measured, shape):
    """Return the errors, mm, of a needle as deep as the measured one, or of the length that both share.

    None where they are undefined.
    """
    upto, beyond = min(shape.depth, measured.depth), shape.depth - measured.depth
    if not shape.converged or upto < 1.0:
        return None
    whole = abs(beyond) <= 1e-6
    if whole:  # read from the tip, so that both tips are compared
        errors = compare_curves(
            *align_points(measured.target, lambda s: compute_positions(shape, s + beyond)),
            measured.target.compared,
        )
    elif measured.target.pose != "free":
        s = upto * np.linspace(0.0, 1.0, COMPARISON_POINTS)
        seen = np.column_stack([np.interp(s, measured.s, axis) for axis in measured.points.T])
        simulated = compute_positions(shape, s)
        errors = compare_curves(align(measured.target.pose, simulated, seen), seen, measured.target.compared)
    else:
        return None
    found = compute_metrics(errors)
    values = {name: found[name] if math.isfinite(found[name]) else None for name in SHOWN_METRICS}
    return {**values, "upto_mm": upto, "whole": whole, "floor_mm": measured.floor}


def encode_state(viewed_scene, steering):
    """Return all that changes from step to step; rotations u' in rad."""
    now, scene, measured = steering.now, steering.scene, viewed_scene.measured
    shape, step, controls = now.shape, now.step, now.step.controls
    before = np.linspace(float(shape.x[0]), min(0.0, shape.depth), POINTS_BEFORE_TISSUE)
    needle = compute_positions(shape, np.unique(np.concatenate([before, shape.x])))  # (K, 3)
    planes = len(list_planes(shape)[0])  # the page has no z of a needle that it solves for in one
    items = [guide_number(guide, steering.names) for guide in controls.guides]
    errors = None if measured is None else compute_live_errors(measured, shape)
    base, tip = (
        {"x": place[0], "y": place[1], "z": place[2] if planes == 2 else None, "rotation": float(slope)}
        for place, slope in zip(
            needle[[0, -1]].round(LENGTH_DIGITS).tolist(), shape.slope[[0, -1]], strict=True
        )
    )
    return {
        "step": steering.number,
        "depth_mm": step.depth,
        "x": needle[:, 0].tolist(),
        "y": needle[:, 1].tolist(),
        "z": needle[:, 2].tolist() if planes == 2 else None,
        **{
            name: dict(zip("xyz", map_beam_points(shape, points).T[: 1 + planes].tolist(), strict=False))
            for name, points in (("constraints", shape.constraints), ("tip_path", shape.tip_path))
        },
        "base": {k: base[k] for k in ("x", "y", "rotation")}
        | {"input_y": controls.base_y, "input_slope": controls.base_slope},
        "guides": [
            {
                "item": item,
                "name": guide.name,
                "x": guide.x,
                "y": guide.y,
                "slope": guide.slope or 0.0,
                "turns_freely": guide.slope is None,
            }
            for item, guide in zip(items, controls.guides, strict=True)
        ],
        "tip": tip
        | {"lateral_mm": shape.tip_lateral, "held": controls.tip is not None, "input_y": float(shape.u[-1])},
        "bevel": {
            "side": 1 if step.bevel.toward[0] > -1e-12 else -1,
            "roll_deg": 180 - (180 - find_roll(step.bevel)) % 360,
            **encode_strength(step.bevel, scene.rules),
        },
        **encode_layers(now.tissue),
        "max_slope": float(shape.validity.max_slope),
        "faults": list(shape.validity.faults),
        "errors": errors,
    }


@dataclass(frozen=True)
class NeedleBand:
    """The simultaneous band that holds 95 % of the drawn needles from entry to tip, in C."""

    x: Floats  #: (K,) Depth along the entry axis, median over the needles, mm
    low: Floats  #: low, high: (K,) Of y, mm
    high: Floats
    failed: int  #: draws whose needle was not found; they are left out


def compute_band(insertion):
    """Return the band of a needle where it stands: it holds 95 % of the needles of posterior draws.

    Every draw replaces moduli and shape parameters of all layers and the strength of the bevel of all steps;
    the layers stay where they are, guides and base where the user holds them. It includes neither the noise
    of measured points, nor errors of the layers' depths, nor model error. Runs on one core, and lets the
    interpreter go. None without draws, before the tip is in, and where no draw can be solved.
    """
    spread, path = insertion.draws, insertion.path
    if spread is None or not path[-1].depth > 0:
        return None
    drawn = spread.only(choose_evenly(len(spread), MAX_BAND_DRAWS))
    batch = drawn.make_batch(insertion.needle, insertion.tissue, path, insertion.rules)
    # One thread: the other cores are left to the needles that users control at the same time.
    (shapes,) = simulate_batches([batch], threads=1)
    points = compute_batch_positions(shapes, np.linspace(0.0, path[-1].depth, NEEDLE_POINTS))
    found = points[shapes.converged]  # (B, K, 3)
    if not len(found):
        return None
    across = found[:, :, 1:].transpose(0, 2, 1).reshape(len(found), -1)  # y, then z, which is 0 in a plane
    low, high = (end[:NEEDLE_POINTS] for end in find_bands(across).ends(BAND_PROBABILITY))
    return NeedleBand(np.median(found[:, :, 0], axis=0), low, high, len(shapes) - len(found))


def continue_insertion(viewed_scene, steering):
    """Return the insertion of a steered needle of a scene from where it stands."""
    rules = replace(steering.scene.rules, first_cell=steering.first_cell)
    tissue, path = steering.now.tissue, steering.input_path()
    return StartedInsertion(steering.scene.needle, tissue, rules, path, viewed_scene.spread)
