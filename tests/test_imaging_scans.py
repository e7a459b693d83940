"""Tables of scans, and volumes named one by one: what they ask for, and every fault with its line."""

import numpy as np
import pytest
from refusals import refusal

from needlefit.errors import DataError
from needlefit.geometry.surfaces import make_sheet, write_surface
from needlefit.imaging.scans import LayerSource, Scan, StagePose, make_scans, read_scans
from needlefit.project.stored_values import encode
from needlefit.schemas.scan_files import ScanFiles

STAGE = "entry_x_mm,entry_y_mm,entry_z_mm,entry_dx,entry_dy,entry_dz,pose_shift_sd_mm,pose_angle_sd_deg"


@pytest.fixture
def folder(tmp_path):
    """Files that a table may name; only their names matter here."""
    for name in ("one.nrrd", "two.nii.gz", "needle.nrrd", "markers.csv", "placed.mrk.json", "all.seg.nrrd"):
        (tmp_path / name).touch()
    (tmp_path / "series").mkdir()
    for name in ("skin", "core"):
        write_surface(make_sheet(name, (0, 0, 0), (1, 0, 0), 50, into=2), tmp_path / f"{name}.stl")
    return tmp_path


def table(folder, *lines):
    path = folder / "scans.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def refused(folder, *lines):
    error = refusal(DataError, "", lambda: read_scans(table(folder, *lines)))
    assert "fix: " in str(error)
    return str(error)


def test_every_column_comes_through_and_has_a_default(folder):
    scans = read_scans(table(folder, "scan", "one.nrrd", "two.nii.gz", "series"))
    assert scans == tuple(
        Scan(name, folder / path, "medium")
        for name, path in (("one", "one.nrrd"), ("two", "two.nii.gz"), ("series", "series"))
    )
    lines = f"scan,surfaces,{STAGE},bevel_x,bevel_y,bevel_z,origin,layers", "one.nrrd" + "," * 14
    assert read_scans(table(folder, *lines)) == (Scan("one", folder / "one.nrrd", "medium"),)
    columns = (
        f"id,scan,series,medium,specimen,mask,markers,fiducials,surfaces,surfaces_in,{STAGE},"
        "bevel_x,bevel_y,bevel_z,bevel_side,layers,layers_alternative,guide_distance_mm,origin"
    )
    cells = (
        "a,series,2,gel,block,needle.nrrd,markers.csv,placed.mrk.json,skin.stl;core.stl=solid:4,scan,"
        "1,2,3,0,0.6,0.8,0.1,1.5,0,0,2,-1,3,4,30,synthetic"
    )
    [scan] = read_scans(table(folder, columns, cells))
    expected = Scan(
        id="a",
        volume=folder / "series",
        series="2",
        medium="gel",
        specimen="block",
        mask=folder / "needle.nrrd",
        markers=folder / "markers.csv",
        fiducials=folder / "placed.mrk.json",
        surfaces=(LayerSource(folder / "skin.stl"), LayerSource(folder / "core.stl", "solid", 4)),
        surfaces_in="scan",
        stage=StagePose(np.array([1.0, 2, 3]), np.array([0, 0.6, 0.8]), 0.1, np.radians(1.5)),
        bevel=np.array([0.0, 0, 1]),
        side=-1,
        layers=3,
        layers_alternative=4,
        guide_distance=30.0,
        origin="synthetic",
    )
    assert encode(scan) == encode(expected)


@pytest.mark.parametrize(
    ("columns", "cells", "words"),
    [
        ("id,scan", "../a,one.nrrd", "id is '../a'"),
        ("scan", "none.nrrd", "scan is 'none.nrrd'"),
        ("scan,medium", "one.nrrd,pork loin", "medium is 'pork loin'"),
        ("id,scan", "a,", "scan is empty"),
        ("scan,mask", "one.nrrd,none.nrrd", "mask is 'none.nrrd'"),
        ("scan,fiducials", "one.nrrd,placed.mrk.json", "without markers"),
        ("scan,markers", "one.nrrd,series", "/series is a folder"),
        ("scan,surfaces", "one.nrrd,none.stl", "surfaces is 'none.stl'"),
        ("scan,surfaces", "one.nrrd,skin.stl=shell:2", "surfaces is 'skin.stl=shell:2'"),
        ("scan,surfaces", "one.nrrd,all.seg.nrrd=solid:2", "surfaces is 'all.seg.nrrd=solid:2'"),
        ("scan,surfaces", "one.nrrd,skin.stl;all.seg.nrrd", "one segmentation"),
        ("scan,surfaces_in", "one.nrrd,room", "surfaces_in is 'room'"),
        ("scan,origin", "one.nrrd,guessed", "origin is 'guessed'"),
        ("scan,layers", "one.nrrd,two", "layers is 'two'"),
        ("scan,bevel_side", "one.nrrd,-1", "no bevel direction"),
        ("scan,bevel_side", "one.nrrd,2", "bevel_side is '2'"),
        ("scan,bevel_x", "one.nrrd,1", "bevel_y is empty"),
        ("scan,guide_distance_mm", "one.nrrd,-3", "guide_distance_mm is '-3'"),
        ("scan,entry_x_mm,entry_y_mm", "one.nrrd,1,2", "entry_z_mm is empty"),
        (f"scan,{STAGE}", "one.nrrd,1,2,3,0,0,2,0.1,1", "entry direction has length 2"),
    ],
)
def test_a_wrong_cell_is_named_with_its_line(folder, columns, cells, words):
    message = refused(folder, columns, cells)
    assert words in message and f"{folder / 'scans.csv'}:2: " in message, message


def test_options_of_volumes_named_one_by_one_are_checked(folder):
    (folder / "one.nii").touch()
    with pytest.raises(DataError, match=r" id one,.*one\.nrrd") as error:
        make_scans([folder / "one.nrrd", folder / "one.nii"])
    assert "table of scans" in error.value.fix
    with pytest.raises(DataError, match="has 3 faults") as error:
        make_scans(
            [folder / "none"], ScanFiles(markers=folder / "none.csv", layers=(str(folder / "none.stl"),))
        )
    for words in ("none: ", "none.csv", "none.stl"):
        assert words in str(error.value)
