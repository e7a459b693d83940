"""Find the scene to show for a name on the command line, or for a recording.

It imports little, so that a scene is there at once; `measured` opens datasets and runs.
"""

import csv
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needlefit.errors import DataError, NeedlefitError
from needlefit.mechanics.laws import LAWS
from needlefit.planning.steered_needle import Recording, make_steered_scene
from needlefit.project.input_files import is_file, read_text
from needlefit.project.locate import TargetKind, file_label, find_view_target
from needlefit.project.toml import load
from needlefit.schemas.scene import SceneRecord
from needlefit.viewer.measured import ViewedScene

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws

DEFAULT_SCENE = "phantom2_fitted"  #: scene that is shown where none is named
DRAWS_SUFFIX = ".draws.csv"  #: ending of the table of parameter draws beside a scene, in place of `.toml`


def open_target(name: str | None, specimen: str = "shown", first: TargetKind | None = None) -> ViewedScene:
    """Return the scene to show for SCENE, RUN or DATASET/ID; `DEFAULT_SCENE` where there is no name.

    A name of several means the kind `first`, by default the run.

    The insertion is the one in `name`, else the first: of a run the first held-out one. `specimen` is
    that of the draws of a run: of its band, and of plans. ConfigError if there is no such thing, or the
    file of a scene has a fault. DataError if the dataset has a fault, or the run is of another kind or
    damaged, found no parameters, or its data have changed since.
    """
    first = first or ("scene" if name is None else "run")
    view_target = replace(find_view_target(name or DEFAULT_SCENE, first), specimen=specimen)
    if view_target.kind == "scene":
        record = load(view_target.path, SceneRecord)
        scene = make_steered_scene(record, file_label(view_target.path))
        title = record.title or view_target.path.stem
        note = f"Parameters: those of the scene {view_target.name}. {record.note}".rstrip()
        draws = read_scene_draws(view_target.path.with_suffix(DRAWS_SUFFIX), record)
        return ViewedScene(
            name=view_target.name, title=title, note=note, record=record,
            first_cell=scene.lattice.first_cell, spread=draws,
        )  # fmt: skip
    from needlefit.viewer import measured

    if view_target.kind == "run":
        return measured.open_run(view_target)
    return measured.open_dataset(view_target)


def read_scene_draws(path: Path, record: SceneRecord) -> "ParameterDraws | None":
    """Return the draws in the table beside a scene: a row for each, `mu1_pa`, `mu2_pa`, ... and `bevel_mm`.

    A shape parameter without a column is that of the scene. None if there is no table, or the scene advances
    by the path angle. DataError if a value is missing or no positive number.
    """
    if record.bevel.offset_mm is None or not is_file(path):
        return None
    from needlefit.inference.forward_model import select_layer_draws

    layers = range(1, len(record.layers) + 1)
    names = [*(f"mu{layer}_pa" for layer in layers), "bevel_mm"]
    rows = list(csv.DictReader(read_text(path).splitlines()))
    try:
        table = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
        usable = all((np.isfinite(table[name]) & (table[name] > 0)).all() for name in names)
    except (IndexError, KeyError, TypeError, ValueError):  # no row, no such column, or no number
        usable = False
    if not usable:
        raise DataError("its draws are not all positive", expected=", ".join(names), where=path)
    tissue = make_steered_scene(record, str(path)).tissue
    for layer, shape in zip(layers, tissue.shape.T.tolist(), strict=True):
        for name, value in zip(LAWS[record.law].shape_names, shape, strict=True):
            table.setdefault(f"{name}{layer}", np.full(len(rows), value))
    return select_layer_draws(table, layers, record.law)


#: largest difference (mm, degrees, or a fraction of the value) of two numbers of scenes that are the same
NUMBER_TOLERANCE = 1e-6


def _is_same(first: object, other: object) -> bool:
    """Return whether the values of two scenes mean the same, to whatever tolerance they are solved."""
    if isinstance(first, dict) and isinstance(other, dict):
        keys = (first.keys() | other.keys()) - {"tolerance_mm"}
        return all(_is_same(first.get(key), other.get(key)) for key in keys)
    if isinstance(first, list | tuple) and isinstance(other, list | tuple):
        return len(first) == len(other) and all(map(_is_same, first, other))
    if isinstance(first, float | int) and isinstance(other, float | int):
        return math.isclose(first, other, rel_tol=NUMBER_TOLERANCE, abs_tol=NUMBER_TOLERANCE)
    return bool(first == other)


def open_recording(recording: Recording) -> ViewedScene:
    """Return the scene of a recording, with its overlays if their files still exist unchanged."""
    head = recording.head
    title, note = head.scene.title or head.target, "Opened from a recording."
    alone = ViewedScene(
        name=head.target, title=title, note=note, record=head.scene, first_cell=head.first_cell_mm,
        placement=head.placement,
    )  # fmt: skip
    try:
        target = open_target(head.target, first="scene")  # a run's insertions have names of their own
    except NeedlefitError as error:
        return replace(alone, note=f"{note} Not found beside it: {error.what}.")
    if target.record.title != head.scene.title:  # a title of its own changes no needle
        record = target.record.model_copy(update={"title": head.scene.title})
        target = replace(target, record=record, title=title)
    if not _is_same(target.record.model_dump(), head.scene.model_dump()):
        return replace(alone, note=f"{note} {head.target} has another scene and is not shown beside it.")
    return replace(target, record=head.scene, first_cell=head.first_cell_mm)
