"""Files of a run that were damaged or changed by hand: an error that names file, key or column."""

import gzip
import json

import pytest
from refusals import refusal
from reporting_results import study
from test_cli import run
from test_validation_differences import write

import needlefit
from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.studies.report import rebuild
from needlefit.studies.run import RESULTS_FILE, restore_run, store_run


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """What a study stores, without its digest."""
    path = store_run(study(1), tmp_path_factory.mktemp("run"))
    return json.loads(gzip.decompress(path.read_bytes()))


def stored(folder, values):
    (folder / RESULTS_FILE).write_bytes(gzip.compress(json.dumps(values).encode()))
    write_manifest(folder)
    return folder


def fault(folder):
    caught = refusal(DataError, "", restore_run, folder)
    assert RESULTS_FILE in caught.where and caught.expected and caught.fix
    return caught


@pytest.fixture
def written(tmp_path):
    """A stored run whose errors were then made a hundredth of what they were."""
    folder = write(tmp_path / "run")
    path = folder / RESULTS_FILE
    values = json.loads(gzip.decompress(path.read_bytes()))
    cells = values["frames"]["errors"]["columns"]["te_mm"]
    cells[:] = [None if cell is None else 0.01 * cell for cell in cells]
    path.write_bytes(gzip.compress(json.dumps(values).encode()))
    return folder


def test_results_that_do_not_agree_with_the_manifest_are_not_reported_on(written, tmp_path, capsys):
    again = tmp_path / "again"
    for line in (
        f"report {written} --out {again}",
        f"diff {written} {written}",
        f"view {written} --no-browser --out {again}",
    ):
        assert run(line) == 3
        assert RESULTS_FILE in capsys.readouterr().err and not again.exists()
    refusal(DataError, RESULTS_FILE, needlefit.load_run, written)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("format", 99),
        ("name", "../elsewhere"),
        ("frames.errors.types.te_mm", "U999999999"),
        ("frames.errors.columns.te_mm", [1.0]),
        ("run.planes", "two"),
        ("run.nonsense", 1),
    ],
)
def test_values_that_were_never_written_are_refused(key, value, content, tmp_path):
    changed = json.loads(json.dumps(content))
    *before, last = key.split(".")
    inner = changed
    for part in before:
        inner = inner[part]
    inner[last] = value
    refusal(DataError, "", lambda: rebuild(stored(tmp_path, changed), tmp_path / "again"))
    assert not (tmp_path / "again").exists()


def test_a_run_without_a_column_is_refused_by_its_name(content, tmp_path):
    changed = json.loads(json.dumps(content))
    errors = changed["frames"]["errors"]
    for column in ("hole", "converged"):
        del errors["types"][column], errors["columns"][column]
    fault = refusal(DataError, "", restore_run, stored(tmp_path, changed))
    assert all(name in fault.what for name in ("`study1`", "hole, converged", "errors")) and fault.fix
