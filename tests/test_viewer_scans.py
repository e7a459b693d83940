"""A scan that is examined and corrected: slices, corrections, the session and its server."""

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from server_cases import asynchronous, served
from test_cli import run

from needlefit.cli.view import names_scan, open_session
from needlefit.errors import ConfigError, DataError
from needlefit.imaging.scans import read_scans, write_scan_table
from needlefit.imaging.volume import Volume, to_patient
from needlefit.viewer.scan_page import ScanPage
from needlefit.viewer.scan_session import (
    HALF_WIDTH_MM,
    PIXEL_MM,
    ScanSession,
    cut_slice,
    list_slice_axes,
    make_course,
    read_corrections,
)

SAMPLE = Path(__file__).parents[1] / "data/sample_scan/scans.csv"


@pytest.fixture(scope="module")
def examined(tmp_path_factory) -> ScanSession:
    session = open_session(str(SAMPLE), {}, None, tmp_path_factory.mktemp("scans"))
    assert not session.describe()["examined"]  # slices can be looked at before
    session.again({})
    return session


@pytest.fixture(scope="module")
def free(examined, tmp_path_factory) -> ScanSession:
    scan = dataclasses.replace(examined.scan, stage=None, propose_layers=True)
    folder = tmp_path_factory.mktemp("free") / "free"
    session = ScanSession(scan, examined.recipe, examined._recipe_file, folder)
    session.again({})
    return session


@pytest.fixture
def session(examined):
    """A session as found, whatever was corrected before."""
    yield examined
    examined.again({})


@pytest.fixture
def free_session(free):
    """A session of the scan without its stage: the entry is where the scan shows it."""
    yield free
    free.again({})


def turned(columns) -> Volume:
    """Return a volume whose voxels hold 100 i + 10 j + k, its axes along columns of LPS."""
    k, j, i = np.indices((4, 3, 2))
    values = (100 * i + 10 * j + k).astype(np.float32)
    return Volume(values, np.zeros(3), np.array([1.0, 2.0, 3.0]), np.array(columns, dtype=float).T)


@pytest.mark.sweep
@pytest.mark.parametrize(
    "columns",
    [np.eye(3), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], [[0, 1, 0], [0, 0, -1], [1, 0, 0]]],
    ids=["LPS", "RAS", "permuted"],
)
def test_slices_show_the_patient_from_the_same_sides(columns):
    volume = turned(columns)
    ways = ([0, 1], [0, -2], [1, -2])  # patient axes to the right and downwards; -2: S runs upwards
    for axes, (right, down) in zip(list_slice_axes(volume), ways, strict=True):
        plane = cut_slice(volume, axes, 1)
        shape = [volume.grid.size[axis] for axis in (axes.down, axes.right)]
        assert plane.shape == tuple(shape)
        for rows, columns_, patient, sign in (
            ((0, 0), (0, -1), right, 1),
            ((0, -1), (0, 0), abs(down), 1 if down > 0 else -1),
        ):
            first, last = (float(plane[r, c]) for r, c in zip(rows, columns_, strict=True))
            ends = [[int(v // 100), int(v % 100 // 10), int(v % 10)] for v in (first, last)]
            step = np.diff(to_patient(volume, np.array(ends, dtype=float)), axis=0)[0]
            assert np.sign(step[patient]) == sign
    assert ["".join(one.letters) for one in list_slice_axes(volume)] == ["RLAP", "RLSI", "APSI"]


@pytest.mark.sweep
def test_the_needle_is_drawn_straight():
    s = np.linspace(0, 20, 41)
    needle = np.column_stack([s, 0.01 * s**2, np.zeros_like(s)])
    k, j, i = np.indices((40, 60, 120))
    away = np.hypot(0.5 * j - 8 - 0.01 * (0.5 * i) ** 2, 0.5 * k - 10)
    volume = Volume(
        np.where(away < 1, 1000, 0).astype(np.float32), np.array([0, -8.0, -10]), np.full(3, 0.5), np.eye(3)
    )
    course = make_course(needle)
    for angle in (0.0, 1.2):
        cut = course.cut(volume, angle)
        rows = np.arange(len(cut))[:, None]
        bright = np.nan_to_num(cut[:, 5:60])
        middle = (rows * bright).sum(axis=0) / bright.sum(axis=0)
        assert np.abs(middle - HALF_WIDTH_MM / PIXEL_MM).max() < 0.6  # rows of 0.3 mm


@pytest.mark.sweep
@pytest.mark.parametrize(
    "content",
    [3, {"needle": [1, 2]}, {"tip": ["a", 1, 2]}, {"points": "x"}, {"contact": [1, 2, True]}, {"ball_mm": 0}],
)
def test_corrections_that_are_no_places_are_refused(content):
    with pytest.raises(DataError):
        read_corrections(content)


@pytest.mark.sweep
def test_scans_are_written_as_the_rows_from_which_they_are_read(tmp_path):
    (scan,) = read_scans(SAMPLE)
    tip, contact = np.array([1.5, -2.25, 3.0]), np.array([0.5, 0.25, 9.0])
    placed = [
        dataclasses.replace(scan, tip=tip, propose_layers=True),
        dataclasses.replace(scan, id="free", stage=None, contact=contact),
    ]
    write_scan_table(placed, tmp_path / "scans.csv")
    for before, after in zip(placed, read_scans(tmp_path / "scans.csv"), strict=True):
        require_equal(before, after)


def require_equal(one, other):
    """Two scans are the same, their files wherever they are named from."""
    for field in dataclasses.fields(one):
        before, after = getattr(one, field.name), getattr(other, field.name)
        if field.name == "stage" and before is not None:
            assert all(np.allclose(getattr(before, f), getattr(after, f)) for f in vars(before))
        elif isinstance(before, np.ndarray):
            np.testing.assert_allclose(after, before, rtol=1e-9)
        elif isinstance(before, Path):
            assert after.resolve() == before.resolve()
        elif field.name == "surfaces":
            assert [(s.kind, s.into, s.path.resolve()) for s in after] == [
                (s.kind, s.into, s.path.resolve()) for s in before
            ]
        else:
            assert after == before, field.name


@pytest.mark.sweep
def test_a_session_describes_its_findings(session):
    found = session.describe()
    assert found["error"] is None and len(found["balls"]) == 5 and len(found["layers"]) == 1
    assert [one["chosen"] for one in found["tubes"]] == [True] and len(found["entries"]) >= 1
    assert session.cut({"view": "axial", "index": 3, "low": 0, "high": 100}).startswith(b"\x89PNG")
    assert session.cut({"view": "needle", "angle": 30, "low": 0, "high": 100}).startswith(b"\x89PNG")
    with pytest.raises(DataError):
        session.cut({"view": "axial", "index": "x", "low": 0, "high": 1})


@pytest.mark.sweep
def test_proposed_layers_are_shown_where_the_needle_crosses_them(session, free_session):
    assert session.describe()["proposed"] == []
    found = free_session.describe()
    (known,) = found["layers"]
    nearest = min(found["proposed"], key=lambda one: abs(one["depth"] - known["depth"]))
    assert nearest["depth"] == pytest.approx(known["depth"], abs=1.0) and nearest["sd"] > 0
    assert np.linalg.norm(np.subtract(nearest["at"], known["at"])) < 1.0


def test_corrections_are_used_kept_and_repeated(session, tmp_path):
    found = session.describe()
    tip = np.array(found["tip"]["at"])
    along = np.array(found["axis"][-3]) - tip
    placed = {"tip": (tip + 0.8 * along / np.linalg.norm(along)).tolist(), "contact": None}
    balls = [one["at"] for one in found["balls"]]
    session.again(placed | {"needle": found["tubes"][0]["middle"], "balls": balls})
    corrected = session.describe()
    assert corrected["tip"]["placed"] and corrected["tip"]["along_sd"] == 0.3
    assert corrected["inserted"]["depth"] == pytest.approx(found["inserted"]["depth"] - 0.8, abs=0.05)
    table = session.save()
    again = open_session(str(table.parent), {}, None, tmp_path)
    again.again({})
    repeated = again.describe()
    assert repeated["inserted"] == pytest.approx(corrected["inserted"], abs=1e-6)
    session.again({})
    assert session.describe()["inserted"] == found["inserted"]


@pytest.mark.sweep
def test_only_saving_writes_and_never_over_what_another_session_saved(session, tmp_path):
    folder = tmp_path / "scans" / "sample"
    tip = session.describe()["tip"]["at"]
    balls = [one["at"] for one in session.describe()["balls"]]

    def kept():
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def begin() -> ScanSession:
        one = copy.copy(session)  # examined already
        one._folder, one._saved_to = folder, None
        return one

    first, second = begin(), begin()
    first.again({"balls": balls})
    assert kept() == {} and first.unsaved
    assert first.save().parent == folder and not first.unsaved
    assert first.keep_unsaved() is None
    before = kept()
    first.again({"balls": balls, "tip": tip})
    second.again({"tip": tip})
    assert kept() == before
    assert second.save().parent.name == "sample-2"
    assert first.keep_unsaved().parent.name == "sample-3"
    assert {path: kept()[path] for path in before} == before
    first.again({"balls": balls[:4]})
    assert first.save().parent.name == "sample-3" and len(kept()) == 8


@pytest.mark.sweep
@pytest.mark.parametrize("refused", ["three balls", "balls elsewhere", "a needle beside every tube"])
def test_a_correction_that_does_not_fit_is_an_error_of_the_scan(session, refused):
    balls = [one["at"] for one in session.describe()["balls"]]
    corrections, where = {
        "three balls": ({"balls": balls[:3]}, ""),
        "balls elsewhere": ({"balls": [[0.0, 0.0, 900.0 + n] for n in range(4)]}, "balls placed by hand"),
        "a needle beside every tube": ({"needle": session.volume.origin.tolist()}, "needle_x_mm"),
    }[refused]
    before = session.describe()
    session.again(corrections)
    found = session.describe()
    assert found["refusal"]["what"] and found["refusal"]["where"].startswith(where)
    assert found == before | {"refusal": found["refusal"]} and not session.unsaved  # the former result stays


@pytest.mark.sweep
@pytest.mark.parametrize("count", [0, 2])
def test_too_few_balls_change_nothing(session, count):
    before = session.describe()
    with pytest.raises(DataError, match=f"{count} "):
        session.again({"balls": [one["at"] for one in before["balls"][:count]]})
    assert session.describe() == before


@pytest.mark.sweep
def test_an_entry_is_not_placed_beside_the_stage(session):
    with pytest.raises(DataError, match="entry"):
        session.again({"contact": session.describe()["tip"]["at"]})


@pytest.mark.sweep
def test_what_a_dataset_may_not_hold_is_refused_on_the_page_and_by_the_command(
    free_session, tmp_path, capsys
):
    axis = np.array(free_session.describe()["axis"])
    contact = axis[-1] + 0.3 * (axis[-1] - axis[-2])
    free_session.again({"contact": contact.tolist()})
    refused = ScanSession(
        dataclasses.replace(free_session.scan, contact=contact),
        free_session.recipe,
        free_session._recipe_file,
        tmp_path,
    )
    refused.again({})
    error, table = refused.describe()["error"], refused.save()
    assert error == free_session.describe()["refusal"] is not None
    assert run("reconstruct", str(table), "--out", str(tmp_path / "out"), "-q") == 3
    assert error["what"] in capsys.readouterr().err


@pytest.mark.sweep
def test_targets_that_are_scans_are_recognised(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/run.json").write_text("{}")
    volume = SAMPLE.parent / "volumes/sample.nrrd"
    files = (SAMPLE, f"{SAMPLE}/sample", volume, volume.parent, SAMPLE.parent)
    assert [names_scan(one) for one in ("sample_scan", *map(str, files))] == 6 * [True]
    assert [names_scan(one) for one in (None, "phantom2", "a.toml", "run", "twin/x")] == 5 * [False]
    for name, files in ((f"{SAMPLE}/other", {}), (str(SAMPLE), {"markers": tmp_path / "m.csv"})):
        with pytest.raises(ConfigError):
            open_session(name, files, None, tmp_path)


@pytest.mark.sweep
@asynchronous
async def test_requests_without_the_token_are_refused(session):
    async with served(ScanPage(session)) as (access, client):
        base = f"http://127.0.0.1:{access.port}"
        async with client.get(base) as answer:
            assert answer.status == 200 and "scan/main.js" in await answer.text()
        async with client.post(f"{base}/scan/describe", json={}) as answer:
            assert answer.status == 403
        own = {"Authorization": f"Bearer {access.token}", "Origin": base}
        async with client.post(f"{base}/scan/describe", json={}, headers=own) as answer:
            assert answer.status == 200 and (await answer.json())["id"] == "sample"
        for name, content, status in (
            ("cut", {"view": "coronal", "index": 5, "low": 0, "high": 9}, 200),
            ("cut", {"view": "nowhere"}, 422),
            ("again", {"tip": 3}, 422),
            ("save", {"tip": [1, 2, 3]}, 422),  # not what is in use
        ):
            async with client.post(f"{base}/scan/{name}", json=content, headers=own) as answer:
                assert answer.status == status
        async with client.post(f"{base}/scan/cut", data=b"{", headers=own) as answer:
            assert answer.status == 400
