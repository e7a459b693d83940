"""Reconstructions become a dataset: what they share, what each has for itself, what is left out."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pytest import approx

from needlefit.datasets.read import check, read
from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import transform_surface
from needlefit.imaging.assembly import DatasetDescription, assemble_checked, assemble_dataset
from needlefit.imaging.batch import reconstruct_all
from needlefit.imaging.checks import collect_warnings
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import read_scans
from needlefit.project.locate import shipped_folder
from needlefit.project.stored_values import decode, encode
from needlefit.schemas.reconstruction import ReconstructionRecord

RECIPE = ReconstructionRecord(schema=1)
ABOUT = DatasetDescription("mine", "Mine", notes="As scanned.", media={"phantom2": "A box."})


@cache
def small():
    """The shipped sample with the pose of its shaft and the one surface that its needle crosses."""
    (scan,) = read_scans(shipped_folder() / "data" / "sample_scan" / "scans.csv")
    free = replace(scan, stage=None, bevel=None, layers=None, layers_alternative=None)
    ((one,),) = reconstruct_all([free], RECIPE)
    return replace(one, layers=replace(one.layers, surfaces=one.layers.surfaces[:1]))


def named(name, **changes):
    one = small()
    return replace(one, scan=replace(one.scan, id=name), **changes)


def shifted(one, shift):
    """The same insertion, its layers 0.5 mm deeper: drawn in its own scan."""
    away = Frame(np.asarray(shift, dtype=float), np.eye(3))
    surfaces = tuple(transform_surface(surface, away) for surface in one.layers.surfaces)
    return replace(one, layers=replace(one.layers, surfaces=surfaces))


@pytest.mark.sweep
def test_a_stored_reconstruction_is_read_to_the_last_bit():
    text = json.dumps(encode([small()]))
    (again,) = decode(json.loads(text), tuple[Reconstruction, ...])
    assert json.dumps(encode([again])) == text
    assert again.needle_axis.points.tobytes() == small().needle_axis.points.tobytes()


@pytest.mark.sweep
def test_the_dataset_records_what_was_reconstructed(tmp_path):
    assemble_dataset(tmp_path, [named("a"), named("b")], RECIPE, ABOUT)
    assert check(tmp_path) == []
    dataset = read(tmp_path)
    first, _ = dataset.insertions
    one = small()
    assert (dataset.origin, dataset.title) == ("synthetic", "Mine")
    assert first.centerline == approx(one.points, abs=1e-4)
    assert first.sd == approx(one.sd, abs=1e-4)
    assert first.patient.rotation == approx(one.patient.rotation, abs=1e-7)
    assert first.boundaries == approx(one.layers.boundaries, abs=2e-3)
    assert first.boundary_sd == approx(one.layers.sd[0], abs=1e-4)
    assert first.depth_sd == approx(one.depth_sd, abs=1e-4)
    assert first.pose_shift_sd == approx(one.pose.shift_sd, abs=1e-4)
    assert first.pose_source == "shaft"
    assert dataset.noise.registration_mean == approx(one.target_error.mean(), abs=1e-4)
    assert dataset.noise.correlated_sd == approx(np.sqrt(np.mean(one.sd**2)), abs=1e-4)


def test_surfaces_that_all_share_are_written_once_others_for_each(tmp_path):
    assemble_dataset(tmp_path / "shared", [named("a"), named("b")], RECIPE, ABOUT)
    assert [file.name for file in (tmp_path / "shared" / "layers").iterdir()] == ["phantom2_interface1.stl"]
    into = small().frame.rotation[:, 0]
    assemble_dataset(tmp_path / "own", [named("a"), shifted(named("b"), 0.5 * into)], RECIPE, ABOUT)
    assert sorted(file.name for file in (tmp_path / "own" / "layers").iterdir()) == ["a_1.stl", "b_1.stl"]
    assert check(tmp_path / "own") == []
    a, b = read(tmp_path / "own").insertions
    assert b.boundaries - a.boundaries == approx([0.5], abs=0.02)


def with_surfaces(name, medium, *names):
    """An insertion whose layers have these names, each 1 mm behind the one before."""
    one = named(name)
    (surface,) = one.layers.surfaces
    into = one.frame.rotation[:, 0]
    surfaces = tuple(
        replace(transform_surface(surface, Frame(n * into, np.eye(3))), name=called, into=n + 2)
        for n, called in enumerate(names)
    )
    layers = replace(one.layers, surfaces=surfaces, sequence=tuple(range(1, len(names) + 2)))
    return replace(one, scan=replace(one.scan, medium=medium), layers=layers)


def test_any_surface_name_gives_a_valid_file_and_media_share_none(tmp_path):
    one = with_surfaces("a", "gel", "skin {id}/2", "Fett (außen)", "fett au en", "x_1")
    assemble_dataset(tmp_path, [one], RECIPE, ABOUT)
    found = sorted(file.name for file in (tmp_path / "layers").iterdir())
    assert found == ["gel_Fett_außen_.stl", "gel_fett_au_en.stl", "gel_skin_id_2.stl", "gel_x_1.stl"]
    assert check(tmp_path) == []
    with pytest.raises(DataError, match=r" layers/gel_b_c\.stl") as error:
        assemble_dataset(
            tmp_path, [with_surfaces("a", "gel", "b_c"), with_surfaces("b", "gel_b", "c")], RECIPE, ABOUT
        )
    assert error.value.fix


def test_an_insertion_with_a_fault_is_left_out_and_reported(tmp_path):
    backwards = named("b", points=small().points[::-1])
    kept, failed = assemble_checked(tmp_path / "out", [named("a"), backwards, named("c")], RECIPE, ABOUT)
    assert [one.scan.id for one in kept] == ["a", "c"]
    assert {one.scan.id for one in failed} == {"b"}
    assert check(tmp_path / "out") == []
    assert not (tmp_path / "out" / "centerlines" / "b.csv").exists()
    (tmp_path := tmp_path / "b").mkdir()
    short = RECIPE.model_copy(update={"needle": RECIPE.needle.model_copy(update={"length_mm": 20.0})})
    kept, failed = assemble_checked(tmp_path / "out", [named("a"), named("b")], short, ABOUT)
    assert kept == () and not (tmp_path / "out").exists()
    assert [one.scan.id for one in failed] == ["a", "b"]
    message = str(failed[0].error)
    assert message.startswith(f"{small().scan.volume}: ") and "20 mm" in message
    assert "needle.length_mm" in message and "recipe" in message and "dataset.toml" not in message


def changed_pose(**changes):
    return replace(small(), pose=replace(small().pose, source="stage", **changes))


def move_passed(result, away):
    """What the needle passes lies elsewhere along it."""
    runs = (replace(run, begin=run.begin + away, end=run.end + away) for run in result.passed)
    return replace(result, passed=tuple(runs))


def own_surface():
    """The tissue begins where its surface is."""
    (surface,) = small().layers.surfaces
    return replace(small(), layers=replace(small().layers, surfaces=(surface, replace(surface, into=1))))


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (
            lambda: replace(small(), registration=replace(small().registration, p_value=1e-4)),
            "registration error",
        ),
        (lambda: changed_pose(angle_sd=0.2), "bending plane"),
        (
            lambda: move_passed(changed_pose(), 4.0),
            r"begins [34]\.\d\d ± .* mm after the stage's entry",
        ),
        (
            lambda: move_passed(own_surface(), -2.0),
            r"begins [12]\.\d\d ± .* mm before its own surface",
        ),
    ],
)
def test_doubtful_reconstructions_give_warnings(one, words):
    warnings = [*collect_warnings(one())]
    assert any(re.search(words, warning) for warning in warnings), warnings
