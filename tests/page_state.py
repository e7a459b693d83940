"""What the page shows of a needle, computed in Python: the reference of `page/model/state.js`."""

from dataclasses import replace

import numpy as np

from needlefit.inference.curve_bands import find_bands
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.shape import compute_positions, list_planes, map_beam_points
from needlefit.mechanics.torsion import find_roll
from needlefit.planning.steered_needle import guide_number
from needlefit.reporting.needle_page import encode_layers, encode_strength
from needlefit.studies.needle_placement import BAND_PROBABILITY, NEEDLE_POINTS
from needlefit.viewer.page_needle import LENGTH_DIGITS

POINTS_BEFORE_TISSUE = 25  # points of the needle drawn before the tissue


def encode_state(steering):
    """Return all that changes from step to step but the errors; rotations u' in rad."""
    now, scene = steering.now, steering.scene
    shape, step, controls = now.shape, now.step, now.step.controls
    before = np.linspace(float(shape.x[0]), min(0.0, shape.depth), POINTS_BEFORE_TISSUE)
    needle = compute_positions(shape, np.unique(np.concatenate([before, shape.x])))  # (K, 3)
    planes = len(list_planes(shape)[0])  # the page has no z of a needle that it solves for in one
    items = [guide_number(guide, steering.names) for guide in controls.guides]
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
    }


def compute_band(steering, draws):
    """Return depth, ends of y (mm) and failures of the band that holds 95 % of the needles of draws.

    None before the tip is in, and where no draw can be solved.
    """
    path, rules = steering.input_path(), replace(steering.scene.rules, first_cell=steering.first_cell)
    if not path[-1].depth > 0:
        return None
    batch = draws.make_batch(steering.scene.needle, steering.now.tissue, path, rules)
    (shapes,) = simulate_batches([batch], threads=1)
    points = compute_batch_positions(shapes, np.linspace(0.0, path[-1].depth, NEEDLE_POINTS))
    found = points[shapes.converged]  # (B, K, 3)
    if not len(found):
        return None
    across = found[:, :, 1:].transpose(0, 2, 1).reshape(len(found), -1)  # y, then z, which is 0 in a plane
    low, high = (end[:NEEDLE_POINTS] for end in find_bands(across).ends(BAND_PROBABILITY))
    failed = len(shapes) - len(found)
    return {"x": np.median(found[:, :, 0], axis=0), "low": low, "high": high, "failed": failed}
