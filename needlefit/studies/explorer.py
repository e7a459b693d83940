"""What the HTML page of a fit or cross-validation computes: scored needles and their draws.

A run stores how each insertion was made, so that its report can be made again without the dataset.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import InsertionInputs, InsertionPose
from needlefit.errors import ConfigError
from needlefit.geometry.curves import TIP_POINTS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import MAX_TOLERANCE_MM
from needlefit.mechanics.plan import Lattice, make_lattice
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.metrics import list_metrics
from needlefit.planning.insertion_scene import (
    find_layers,
    make_scene_record,
    name_bevel_key,
    name_layer_values,
)
from needlefit.planning.steered_needle import (
    format_head,
    list_scene_changes,
    make_head,
    make_steered_scene,
    name_guides,
)
from needlefit.reporting import labels
from needlefit.reporting.needle_page import (
    MAX_BAND_DRAWS,
    PageData,
    choose_evenly,
    encode_draws,
    encode_measured,
    encode_scene,
    find_measured,
    kernel_exists,
)
from needlefit.reporting.table_files import Row, select_rows, to_records
from needlefit.schemas.run_metadata import FitMetadata, InsertionMetadata, PredictionMetadata
from needlefit.studies.run import FIT_KINDS, NEW_SPECIMEN, PREDICTION_METHOD, FitFrames, Run, draw_insertion

# Modules that simulate are imported where they are used: other reports do not load them.


def _read_inputs(metadata: FitMetadata, name: str) -> InsertionInputs:
    """Return what the simulation of an insertion needs, as a run stored it; none under a guide is stored."""
    layers, stored, dataset = metadata.layers[name], metadata.insertions[name], metadata.dataset
    needle = dataset.needle or (dataset.needles or {})[stored.needle]  # of all insertions, or its own
    return InsertionInputs(
        needle=Needle(
            needle.length, needle.flexural_rigidity, outer_diameter=needle.outer_diameter, name=stored.needle
        ),
        sequence=tuple(layer for layer, _ in layers),
        boundaries=np.array([top for _, top in layers[1:]]),
        **stored.model_dump(exclude={"needle", "compared", "specimen", "observations"}),
    )


def collect_explorer(run: Run) -> PageData | None:
    """Return the data of the page of a fit, cross-validation or prediction; None where there is no needle.

    Nothing can be computed in an installation without the kernel in WebAssembly, of tip tracks, and of runs
    of earlier versions, which did not store how each insertion was made.
    """
    if not kernel_exists():
        return None
    if run.kind == "prediction":
        return _collect_prediction(run)
    if run.kind not in FIT_KINDS:
        return None
    frames = FitFrames.of(run)
    scored = frames.select_errors(method="fitted")
    metadata = run.knows(FitMetadata)
    stored = metadata.insertions
    rows = [row for row in to_records(scored) if row["converged"] and row["insertion"] in stored]
    shapes = select_rows(frames.shapes, boundaries="measured")
    points = [f"{kind}_{axis}_mm" for kind in ("measured", "simulated") for axis in "xyz"]
    curves: dict[Hashable, Floats] = {  # stations are in order
        key: some.to_numpy().reshape(-1, 2, 3)
        for key, some in shapes.groupby(["fold", "role", "insertion", "method"], sort=False)[points]
    }
    rows = [row for row in rows if (row["fold"], row["role"], row["insertion"], "fitted") in curves]
    if not rows:  # of curvatures alone no place is known
        return None
    data = PageData({"needlefit": metadata.versions["needlefit"], "title": run.title})
    for row in rows:
        where = row["fold"], row["role"], row["insertion"]
        needle = _encode_needle(data, run, row, curves[*where, "fitted"])
        about = {
            "group": labels.group_name(row["medium"], row["layers"]),
            "errors": {name: row[name] for name, *_ in needle["scene"]["measured"]["metrics"]},
        }
        if needle["scene"]["measured"]["target"]["pose"] == "known":  # its curve lies where it is drawn
            needle["scene"]["measured"]["prediction"] = find_prediction(run, *where)
        data.needles.append(needle | about)
    return data


def choose_drawn(sets: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Return the parameters (Pa, mm) of some draws, evenly chosen, that the page of a prediction needs."""
    return {
        name: [float(sets[n][name]) for n in choose_evenly(len(sets), MAX_BAND_DRAWS)] for name in sets[0]
    }


def _collect_prediction(run: Run) -> PageData | None:
    """Return the data of the page of a predicted needle; None where its draws are not certified."""
    from needlefit.inference.forward_model import make_rules, select_layer_draws
    from needlefit.mechanics.simulate import find_last_shape

    metadata = run.knows(PredictionMetadata)
    if metadata.drawn is None or (values := metadata.nearest or metadata.mode) is None:
        return None
    medium, record = metadata.medium, run.record.scene
    record = record.model_copy(
        update={
            "layers": tuple(
                layer.model_copy(update=name_layer_values(values, n, medium))
                for n, layer in enumerate(record.layers, start=1)
            ),
            "bevel": record.bevel.model_copy(update={name_bevel_key(medium): values[medium.bevel_parameter]}),
            "rules": make_rules(medium).model_copy(
                update={key: getattr(record.rules, key) for key in ("element_mm", "first_cell_mm")}
            ),
            "law": medium.law,
        }
    )
    try:
        scene, guides = name_guides(make_steered_scene(record, run.record.scene_name))
    except ConfigError:
        return None  # the page steers no such needle
    encoded, lattice = _encode_scene(run, scene, guides, run.title)
    shape = find_last_shape(scene.needle, scene.tissue, scene.steps, scene.rules, lattice)
    data = PageData({"needlefit": metadata.versions["needlefit"], "title": run.title})
    layers = range(1, scene.tissue.layers + 1)
    draws = select_layer_draws(pd.DataFrame(metadata.drawn), layers, medium.law)
    encoded["draws"] = encode_draws(draws, medium.law, data)
    head = format_head(make_head(run.name, lattice.first_cell, record))
    about = {"new_specimen": metadata.specimen == "others", "head": head, "tip": shape.tip_lateral}
    data.needles.append({"scene": encoded, **about})
    return data


def _encode_scene(
    run: Run, scene: Scene, guides: Sequence[str], title: str
) -> tuple[dict[str, Any], Lattice]:
    """Return a scene with the changes of its steps as the page has it, and its lattice."""
    lattice, changes = make_lattice(scene.steps, scene.rules), list_scene_changes(scene.steps, guides)
    return encode_scene(scene, lattice.first_cell, guides, changes, title, run.origin_mark), lattice


def find_prediction(run: Run, fold: str, role: str, insertion: str) -> dict[str, Any] | None:
    """Return our prediction of an insertion, which the verdict judges: its curve or tip, mm, and its errors.

    None of an insertion that was not held out.
    """
    place = {"fold": fold, "role": role, "insertion": insertion}
    place |= {"method": PREDICTION_METHOD, "boundaries": "measured"}
    shapes, errors = (select_rows(run.frames[name], **place) for name in ("shapes", "errors"))
    if shapes.empty or errors.empty:
        return None
    (row,), drawn = to_records(errors), find_measured(len(shapes))
    curve = {axis: shapes[f"simulated_{axis}_mm"].tolist()[drawn] for axis in "xy"}
    return curve | {"errors": {metric.name: row.get(metric.name) for metric in list_metrics()}}


def _encode_needle(data: PageData, run: Run, row: Row, curve: Floats) -> dict[str, Any]:
    """Return one needle with the fit's parameters: its scene, draws, and what the run stored of it."""
    from needlefit.inference.forward_model import select_layer_draws

    metadata, name = run.knows(FitMetadata), row["insertion"]
    medium, stored, inputs = metadata.medium, metadata.insertions[name], _read_inputs(metadata, name)
    parameter_rows = select_rows(run.frames["parameters"], fold=row["fold"], method="fitted")
    values = dict(zip(parameter_rows["parameter"], parameter_rows["value"].astype(float), strict=True))
    title = f"{name} · {run.dataset_title}"
    # as the fit has simulated it, to its tolerance: the needle is that of the run to the bit
    dataset = metadata.dataset.name
    record = make_scene_record(values, medium, dataset, inputs, title, MAX_TOLERANCE_MM)
    scene, guides = name_guides(Scene.from_record(record, name))
    encoded, lattice = _encode_scene(run, scene, guides, title)
    encoded["measured"] = _encode_measured(scene, lattice, stored, row, curve, metadata.compared)
    drawn = draw_insertion(run, row["fold"], name, stored.specimen)
    if drawn.table is not None:
        draws = select_layer_draws(drawn.table, [layer for _, layer in find_layers(inputs)], medium.law)
        turned = replace(draws, bevel=stored.bevel_factor * draws.bevel)
        encoded["draws"] = encode_draws(turned, medium.law, data)
    head = make_head(f"{run.name}/{name}", lattice.first_cell, record)
    return {"scene": encoded, "new_specimen": drawn.specimen == NEW_SPECIMEN, "head": format_head(head)}


def _encode_measured(
    scene: Scene, lattice: Lattice, stored: InsertionMetadata, row: Row, curve: Floats, compared: str
) -> dict[str, Any]:
    """Return the measured needle as the page draws and compares it, and the needle that the run stored.

    `curve` (K, 2, 3) are its points and the simulated ones.
    """
    from needlefit.inference.likelihood.compared_points import align
    from needlefit.mechanics.simulate import find_last_shape

    measured, simulated = curve[:, 0], curve[:, 1]
    if stored.compared is None:
        pose: InsertionPose = "direction" if row["comparison"] == "shifted" else "known"
        s = stored.depth * np.linspace(0.0, 1.0, len(curve))
    else:
        pose, s = "free", stored.depth - np.linspace(stored.compared, 0.0, len(curve))
    shown, tip = measured[:, :2], {}
    shape = find_last_shape(scene.needle, scene.tissue, scene.steps, scene.rules, lattice)
    if len(curve) > TIP_POINTS and "tip" in stored.observations:  # which was measured by itself
        off = [row[f"tip_error_{axis}_mm"] for axis in "xyz"]
        end = compute_positions(shape, np.array([stored.depth])) - off
        tip = {"tip": dict(zip("xyz", end.T.tolist(), strict=True))}
    if pose != "known":  # laid on the needle of the fit
        shown = align(pose, shown, compute_positions(shape, s)[:, :2])
    points = np.column_stack([shown, measured[:, 2]])
    target = {"compared": compared, "pose": pose, "s": s, "points": measured}
    encoded = encode_measured(row["insertion"], points, s, stored.depth, row["floor_te_mm"], target)
    return encoded | {"stored": dict(zip("xyz", simulated.T.tolist(), strict=True)), **tip}
