"""Find the scene to show for a name on the command line, or for a recording."""

from dataclasses import replace

from needlefit.errors import NeedlefitError
from needlefit.mechanics.scene import Scene
from needlefit.project.load import load
from needlefit.project.locate import file_label
from needlefit.project.view_targets import SpecimenChoice, ViewTarget, find_view_target
from needlefit.schemas.scene import SceneRecord
from needlefit.viewer.opening.insertion import open_insertion
from needlefit.viewer.opening.run import open_run
from needlefit.viewer.recording import Recording
from needlefit.viewer.viewed_scene import ViewedScene


def open_scene(view_target: ViewTarget) -> ViewedScene:
    """Return a scene, ready to be shown.

    Raises
    ------
    ConfigError
        If its file has a fault.
    """
    record = load(view_target.path, SceneRecord)
    scene = Scene.from_record(record, file_label(view_target.path))
    title = record.title or view_target.path.stem
    note = f"Parameters: those of the scene {view_target.name}. {record.note}".rstrip()
    return ViewedScene(view_target.name, title, note, record, scene.lattice.first_cell)


DEFAULT_SCENE = "phantom2"
"""The scene that is shown where nothing is named."""


def open_target(
    name: str | None, insertion: str | None = None, specimen: SpecimenChoice = "shown"
) -> ViewedScene:
    """Return the scene to show for SCENE, RUN or DATASET/ID.

    Parameters
    ----------
    name : str or None
        None: the scene `DEFAULT_SCENE`.
    insertion : str, optional
        Of the run or dataset; by default the one in `name`, else the first.
    specimen : SpecimenChoice
        Of the draws of a run: of its band, and of plans.

    Raises
    ------
    ConfigError, DataError
        If there is no such thing, or it has a fault.
    """
    view_target = replace(find_view_target(DEFAULT_SCENE if name is None else name), specimen=specimen)
    if insertion is not None and view_target.kind != "scene":
        view_target = replace(view_target, insertion=insertion)
    return _OPENERS[view_target.kind](view_target)


_OPENERS = {"scene": open_scene, "run": open_run, "dataset": open_insertion}


def open_recording(recording: Recording) -> ViewedScene:
    """Return the scene of a recording, with its overlays if their files still exist unchanged."""
    head = recording.head
    alone = ViewedScene(
        head.target,
        head.scene.title or head.target,
        "Opened from a recording.",
        head.scene,
        head.first_cell_mm,
        head.placement,
    )
    try:
        found = open_target(head.target)
    except NeedlefitError as error:
        return replace(alone, note=f"{alone.note} What was shown beside it is not found: {error.what}.")
    if found.record.title != head.scene.title:  # a title of its own changes no needle
        found = replace(
            found, record=found.record.model_copy(update={"title": head.scene.title}), title=alone.title
        )
    if found.record != head.scene:
        return replace(
            alone, note=f"{alone.note} {head.target} has changed since and is not shown beside it."
        )
    return replace(found, first_cell=head.first_cell_mm)
