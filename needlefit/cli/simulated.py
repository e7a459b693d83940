"""What `simulate` carried out: a scene, or a recording of one that was steered by hand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from needlefit.cli import scene_files, screen
from needlefit.cli.scene_files import Inserted
from needlefit.errors import NeedlefitError
from needlefit.project.outputs import require_output_files
from needlefit.project.subjects import find_subject

if TYPE_CHECKING:
    from needlefit.geometry.placement import Placement
    from needlefit.mechanics.scene import Scene
    from needlefit.mechanics.shape import NeedleShape
    from needlefit.project.records.scene import SceneRecord
    from needlefit.project.result_warnings import ResultWarning

Write = Callable[[Path], bool | None]


@dataclass(frozen=True)
class Simulated:
    """A needle at the end of its way.

    Attributes
    ----------
    title : str
    scene : Scene
        Its steps are those that `shapes` belong to.
    shapes : tuple of NeedleShape
        After each step, up to the one that failed.
    files : mapping of str to callable
        By option, what writes such a file; False where there is no needle to write.
    more : dict
        What else `--json` says.
    placement : Placement or None
        Where a measured needle lies; None of a scene, which says so itself.
    warnings : tuple of ResultWarning
    """

    title: str
    scene: "Scene"
    shapes: "tuple[NeedleShape, ...]"
    files: Mapping[str, Write]
    more: dict[str, Any]
    placement: "Placement | None" = None
    warnings: "tuple[ResultWarning, ...]" = ()


def of_scene(name: str, record: "SceneRecord", where: str) -> Simulated:
    """Carry out a scene's steps; `where` is named in errors."""
    from needlefit.mechanics.scene import Scene, insert
    from needlefit.project.unit_warnings import coarse_warnings, scene_warnings

    screen.compile_ahead()
    scene = Scene.from_record(record, where)
    done = Inserted(record.title or name, scene, insert(scene), record.needle.outer_diameter_mm)
    files: dict[str, Write] = {
        "plot": partial(scene_files.write_picture, done),
        "csv": partial(scene_files.write_table, done),
        "slicer": partial(scene_files.write_curves, done),
        "animation": partial(scene_files.write_animation, done),
    }
    warnings = (*scene_warnings(record, where), *coarse_warnings(record, where))
    return Simulated(done.title, scene, done.shapes, files, {}, warnings=warnings)


def of_recording(path: Path, upto: int | None, outputs: Mapping[str, Path]) -> Simulated:
    """Carry out a recording, or its steps up to number `upto`.

    Raises
    ------
    ConfigError
        If one of `outputs`, by option, is a file of what was steered, or cannot be written.
    """
    from needlefit.project.unit_warnings import coarse_warnings, scene_warnings
    from needlefit.viewer.exports import export
    from needlefit.viewer.exports.outcome import carry_out
    from needlefit.viewer.recording.log import read

    recording = read(path)
    require_output_files(outputs, [path, *_subject_files(recording.head.subject)])
    if upto is not None:
        if upto > len(recording.steps):
            raise typer.BadParameter(f"the recording has {len(recording.steps)} steps", param_hint="--step")
        recording = replace(recording, steps=recording.steps[:upto])
    screen.compile_ahead()
    done = carry_out(recording)
    files: dict[str, Write] = {
        "plot": partial(export.write_picture, done),
        "csv": partial(export.write_table, done),
        "slicer": partial(export.write_curve, done),
        "animation": partial(export.write_animation, done),
    }
    more = {"replayed": {"steps": len(recording.steps), "off_mm": done.off}}
    planned = recording.head.scene
    warnings = (*scene_warnings(planned, str(path)), *coarse_warnings(planned, str(path)))
    return Simulated(done.title, done.scene, (done.moment.shape,), files, more, done.placement, warnings)


def _subject_files(subject: str) -> list[Path]:
    """Return the scene, or the folder of the run or dataset, that a recording is of; none if it is gone."""
    try:
        named = find_subject(subject)
    except NeedlefitError:
        return []
    return [named.path.parent if named.kind == "dataset" else named.path]
