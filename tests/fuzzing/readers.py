"""The table of readers: what is read, from which valid inputs, and how many mutants a default test takes.

A reader takes the path that a user would name. It is imported late: a worker process reads with few of them.
"""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path

from fuzzing import seeds
from fuzzing.seeds import Seed, project_files

QUICK, NATIVE, SLOWEST = 40, 8, 4
"""Mutants of a default test: of a reader in Python, of one with a child process, of one with several."""


@dataclass(frozen=True)
class Reader:
    """What reads one kind of input, and its valid ones.

    `read` takes the path, and raises `NeedlefitError` or returns; of `packed` files, which are gzip, the
    inside is damaged too.
    """

    read: Callable[[Path], object]
    seeds: Callable[[], Sequence[Seed]]
    mutants: int = QUICK
    packed: bool = False


_INPUTS = {}


def inputs(name, stored):
    """Return the valid inputs of a reader: built once, then taken from the folder `stored`."""
    if name not in _INPUTS:
        file = stored / f"{name}.pickle"
        if not file.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(pickle.dumps(tuple(READERS[name].seeds())))
        _INPUTS[name] = pickle.loads(file.read_bytes())
    return _INPUTS[name]


def _late(name):
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(f"needlefit.{module}"), attribute)


def _call(name, path):
    return _late(name)(path)


def _load(record, path):
    return _late("project.toml.load")(path, _late(f"schemas.{record}"))


# ---- TOML


def _scene(path):
    return _late("mechanics.scene.Scene").from_record(_load("scene.SceneRecord", path))


def _study(path):
    return _late("studies.load.load_study_file")(path)


def _medium(path):
    return _late("inference.parameters.Parameters").from_record(_load("medium.MediumRecord", path))


# ---- datasets


def _dataset(path):
    """Check a dataset; one without faults must be readable."""
    found = _late("datasets.read.check")(path)
    if found:
        raise _late("datasets.faults.as_error")(found, path)
    return _late("datasets.read.read")(path)


def _import(path):
    stated = [("pose", "1,0,0"), ("bevel", "0,1,0")]
    prepared = _late("datasets.importing.prepare.prepare_import")([path], stated)
    with _late("project.folders.replace_folder")(path.parent / "made", False) as fresh:
        write_plan = _late("datasets.importing.writing.write_plan")
        write_plan(fresh, prepared.content, prepared.plan, prepared.mapping)
    return _late("datasets.read.read")(path.parent / "made")


def _mesh(path):
    return _late("imaging.layers.read_mesh")(_late("imaging.scans.LayerSource")(path), 2)


# ---- own files


def _results(folder):
    _late("project.folders.write_manifest")(folder)
    return _late("studies.run.restore_run")(folder)


def _checkpoint(folder):
    kept = _late("project.checkpoint.open_checkpoint")(folder, True, seeds.WORK)
    return kept.read("fit", _late("inference.fit.Fit")), kept.rows("rows"), kept.rows("arrays")


# ---- texts


READ_VOLUME = partial(_call, "imaging.volume_files.read_volume")
READ_LABELS = partial(_call, "imaging.segmentations.read_labels")

READERS = {
    "scene": Reader(_scene, partial(project_files, "configs/scenes/*.toml", "scene.toml")),
    "study": Reader(_study, partial(project_files, "studies/*.toml", "study.toml")),
    "medium": Reader(_medium, partial(project_files, "configs/media/*.toml", "medium.toml")),
    "dataset": Reader(_dataset, seeds.datasets, 40),
    "markers": Reader(partial(_call, "imaging.markers.read_markers"), seeds.markers),
    "scans": Reader(partial(_call, "imaging.scans.read_scans"), seeds.scans, 40),
    "markups": Reader(_import, seeds.markups),
    "source": Reader(_import, seeds.sources),
    "table": Reader(_import, seeds.import_tables, 30),
    "workbook": Reader(_import, seeds.workbooks, SLOWEST),
    "structure_set": Reader(_import, seeds.structure_sets, SLOWEST),
    "json_lines": Reader(_import, seeds.json_lines),
    "mat": Reader(_import, seeds.matlab, SLOWEST),
    "volume": Reader(READ_VOLUME, seeds.volumes, NATIVE, packed=True),
    "labels": Reader(READ_LABELS, seeds.labels, NATIVE, packed=True),
    "dicom": Reader(READ_VOLUME, seeds.dicom, SLOWEST),
    "archive": Reader(READ_VOLUME, seeds.archives, SLOWEST),
    "mesh": Reader(_mesh, seeds.meshes, 50),
    "recording": Reader(partial(_call, "planning.steered_needle.read_recording"), seeds.recordings),
    "results": Reader(_results, seeds.results, 20, packed=True),
    "posterior": Reader(partial(_call, "inference.sampling.posterior.load"), seeds.posteriors, SLOWEST),
    "checkpoint": Reader(_checkpoint, seeds.checkpoints, 40),
    "run": Reader(partial(_call, "studies.run.read_run"), seeds.run_files),
}
"""Every reader of what comes from outside, by its name."""
