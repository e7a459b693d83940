"""The table of readers: what is read, from which valid inputs, and how many mutants a default test takes.

A reader takes the path that a user would name. It is imported late: a worker process reads with few of them.
"""

import gzip
import json
import os
import pickle
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from fuzzing import seeds
from fuzzing.seeds import Seed, project_files

QUICK, NATIVE, SLOWEST = 40, 8, 4
"""Mutants of a default test: of a reader in Python, of one with a child process, of one with several."""

MAX_LINES = 40
"""Messages of a conversation: duplicated lines make it no longer."""


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


def reader(name: str) -> Reader:
    return READERS.get(name) or BROKEN[name]


_INPUTS: dict[str, tuple[Seed, ...]] = {}


def inputs(name: str, stored: Path) -> tuple[Seed, ...]:
    """Return the valid inputs of a reader: built once, then taken from the folder `stored`."""
    if name not in _INPUTS:
        file = stored / f"{name}.pickle"
        if not file.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(pickle.dumps(tuple(reader(name).seeds())))
        _INPUTS[name] = pickle.loads(file.read_bytes())
    return _INPUTS[name]


def _late(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(f"needlefit.{module}"), attribute)


def _call(name: str, path: Path) -> object:
    return _late(name)(path)


def _load(record: str, path: Path) -> object:
    return _late("project.toml.load")(path, _late(f"schemas.{record}"))


# ---- TOML


def _scene(path: Path) -> object:
    return _late("mechanics.scene.Scene").from_record(_load("scene.SceneRecord", path))


def _study(path: Path) -> object:
    study = _late("studies.study_files.load_study")(path)
    _late("studies.study_files.find_missing_data")(path)
    return study


def _medium(path: Path) -> object:
    return _late("inference.parameters.Parameters").from_record(_load("medium.MediumRecord", path))


# ---- datasets


def _dataset(path: Path) -> object:
    """Check a dataset; one without faults must be readable."""
    found = _late("datasets.read.check")(path)
    if found:
        raise _late("datasets.faults.as_error")(found, path)
    return _late("datasets.read.read")(path)


def _import(path: Path) -> object:
    answers = _late("datasets.importing.answers.Answers")({"pose": "1,0,0", "bevel": "0,1,0"})
    content, plan = import_module("import_cases").plan_import([path], answers)
    with _late("project.folders.create_folder")(path.parent / "made") as fresh:
        _late("datasets.importing.writing.write_plan")(fresh, content, plan, answers)
    return _late("datasets.read.read")(path.parent / "made")


def _mesh(path: Path) -> object:
    found: list = []
    source = _late("imaging.scans.LayerSource")(path)
    surface = _late("imaging.layers.read_mesh")(source, 2, found)
    if found:
        raise _late("datasets.faults.as_error")(found, path)
    return surface


# ---- own files


def _results(folder: Path) -> object:
    return _late("studies.store.restore_runs")(folder, unverified=True)


def _content(path: Path) -> object:
    folder = path.parent / "run"
    folder.mkdir(exist_ok=True)
    (folder / "results.json.gz").write_bytes(gzip.compress(path.read_bytes()))
    return _results(folder)


def _checkpoint(folder: Path) -> object:
    kept = _late("project.checkpoint.open_checkpoint")(folder, True, seeds.WORK)
    chain, row = kept.open_file("chain", ("failures", "failed"))
    if row:
        import_module("emcee").backends.HDFBackend(chain).get_last_sample()
    return _late("inference.fit.read_starts")(kept, "fit"), kept.rows("rows"), row


def _rows(path: Path) -> object:
    """Keep rows with right digests, and take them as starts."""
    kept = _late("project.checkpoint.open_checkpoint")(path.with_name("run.partial"), False, seeds.WORK)
    values = _late("project.input_files.read_json")(path)
    for row in values if isinstance(values, list) else [values]:
        kept.keep_row("fit", row)
    return _late("inference.fit.read_starts")(kept, "fit")


def _kept(folder: Path) -> object:
    batch = import_module("needlefit.imaging.batch")
    kept = _late("project.checkpoint.open_checkpoint")(folder / "run.partial", True, seeds.WORK)
    values = _late("project.input_files.read_json")(folder / "values.json")
    if not isinstance(values, dict):
        return None
    return [batch._decode_checkpoint({**row, **values}) for row in kept.rows("scan")]


def _difference(folder: Path) -> object:
    found = _late("studies.run_differences.compare_runs")(folder / "a", folder / "b", unverified=True)
    differences = import_module("needlefit.studies.run_differences")
    if found:
        differences.lay_out_differences(found)
    return differences.summarize_differences(found), differences.differences_to_json(found)


# ---- texts


def _assignments(path: Path) -> object:
    scene = _late("schemas.scene.SceneRecord")
    file = _late("project.locate.find_file")("scene", "figure1")
    tables = _late("project.toml.read_toml")(file)
    override, check = _late("project.toml.override"), _late("project.toml.check")
    pairs = [line.partition("=")[::2] for line in _text(path).splitlines() if "=" in line]
    return check(override(tables, pairs, scene, "figure1"), scene, "figure1")


def _conversation(path: Path) -> object:
    """Answer messages, a line each, in one window as the page's server does; replies must be JSON."""
    open_target = _late("viewer.opening.open_target")
    registry = _late("viewer.trials.TrialRegistry")(open_target("figure1"), path.parent / "view", open_target)
    window = _late("viewer.window.Window")(registry, registry.open(""))
    read, refused = _late("viewer.messages.read_message"), None
    for text in _text(path).splitlines()[:MAX_LINES]:
        try:
            replies = list(window.answer(read(text)))
        except _late("viewer.trial.StepOrderError") as error:
            refused = str(error)
            continue
        for reply in replies:
            json.dumps(reply, allow_nan=False).encode()
            if reply["kind"] == "refused":
                refused = reply["what"]
    if refused is not None:
        raise _late("errors.ModelError")(refused)
    return window.trial.steering.number


def _names(path: Path) -> object:
    name, locate = _text(path), import_module("needlefit.project.locate")
    kinds = ("scene", "recipe", "study", "fit", "medium", "dataset", "scans", "reconstruction")
    lookups = [
        *(partial(locate.find_file, kind) for kind in kinds),
        *(locate.find_study_or_fit, locate.find_studies, locate.find_run),
        _late("project.locate.find_view_target"),
    ]
    error, found = None, []
    for lookup in lookups:
        try:
            found.append(lookup(name))
        except _late("errors.NeedlefitError") as fault:
            error = fault
    if error is not None and not found:
        raise error
    return found


def _command(path: Path) -> object:
    """Run a whole command; its exit code must be one of those that are documented, and not that of a bug."""
    failure = import_module("needlefit.cli.exit_codes")
    words = _text(path).splitlines()
    try:
        _late("cli.main")(words)
    except SystemExit as ending:
        if ending.code in (failure.UNEXPECTED, None) or ending.code not in failure.EXIT_CODES:
            raise RuntimeError(f"exit code {ending.code}: {words}") from None
        return ending.code
    return 0


def _text(path: Path) -> str:
    """Return what the file holds as the interpreter gives arguments: bytes that are no UTF-8 are kept."""
    return path.read_bytes().decode("utf-8", "surrogateescape").replace("\0", "")


def _configs(record: str, folder: str, name: str) -> Reader:
    return Reader(partial(_load, record), partial(project_files, f"configs/{folder}/*.toml", f"{name}.toml"))


READ_VOLUME = partial(_call, "imaging.volume_files.read_volume")
READ_LABELS = partial(_call, "imaging.segmentations.read_labels")

READERS: dict[str, Reader] = {
    "scene": Reader(_scene, partial(project_files, "configs/scenes/*.toml", "scene.toml")),
    "study": Reader(_study, partial(project_files, "studies/*.toml", "study.toml")),
    "fit": _configs("study.FitRecord", "fits", "fit"),
    "recipe": _configs("recipe.RecipeRecord", "recipes", "recipe"),
    "reconstruction": _configs("reconstruction.ReconstructionRecord", "reconstruction", "reconstruction"),
    "medium": Reader(_medium, partial(project_files, "configs/media/*.toml", "medium.toml")),
    "dataset": Reader(_dataset, seeds.datasets, 40),
    "markers": Reader(partial(_call, "imaging.markers.read_markers"), seeds.markers),
    "scans": Reader(partial(_call, "imaging.scans.read_scans"), seeds.scans, 40),
    "markups": Reader(_import, seeds.markups),
    "source": Reader(_import, seeds.sources),
    "table": Reader(_import, seeds.import_tables, 30),
    "workbook": Reader(_import, seeds.workbooks, SLOWEST),
    "structure_set": Reader(_import, seeds.structure_sets, SLOWEST),
    "mat": Reader(_import, seeds.matlab, SLOWEST),
    "volume": Reader(READ_VOLUME, seeds.volumes, NATIVE, packed=True),
    "labels": Reader(READ_LABELS, seeds.labels, NATIVE, packed=True),
    "dicom": Reader(READ_VOLUME, seeds.dicom, SLOWEST),
    "archive": Reader(READ_VOLUME, seeds.archives, SLOWEST),
    "segmentation": Reader(READ_LABELS, seeds.segmentations, SLOWEST),
    "mesh": Reader(_mesh, seeds.meshes, 50),
    "recording": Reader(partial(_call, "viewer.recording.read_recording"), seeds.recordings),
    "results": Reader(_results, seeds.results, 20, packed=True),
    "content": Reader(_content, seeds.contents),
    "posterior": Reader(partial(_call, "inference.sampling.posterior.load"), seeds.posteriors, SLOWEST),
    "checkpoint": Reader(_checkpoint, seeds.checkpoints, 40),
    "rows": Reader(_rows, seeds.rows),
    "kept": Reader(_kept, seeds.kept, SLOWEST),
    "run": Reader(partial(_call, "studies.store.read_run"), seeds.run_files),
    "diff": Reader(_difference, seeds.runs, 20),
    "manifest": Reader(partial(_call, "project.folders.require_replaceable"), seeds.manifests),
    "conversation": Reader(_conversation, seeds.conversations, 20),
    "set": Reader(_assignments, seeds.assignments, 40),
    "command": Reader(_command, seeds.commands, 30),
    "name": Reader(_names, seeds.names, 40),
}
"""Every reader of what comes from outside, by its name."""


# ---- readers that break the rule


def _crash(_: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _spin(_: Path) -> None:
    while True:
        pass


def _grow(_: Path) -> None:
    bytearray(1200 * 2**20)[::4096] = b"1" * (1200 * 2**20 // 4096)


def _raise(_: Path) -> None:
    raise KeyError("x")


def _print(path: Path) -> None:
    print(path.name + "\x1b[31m")


BROKEN: dict[str, Reader] = {
    one.__name__: Reader(one, lambda: [seeds.one_file("input.txt", "1\n")])
    for one in (_crash, _spin, _grow, _raise, _print)
}
"""What the rule must find out, by name."""
