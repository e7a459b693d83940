"""Reconstructions become a dataset: what they share, what each has for itself, what is left out."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pytest import approx
from synthetic.build import build_dataset
from synthetic.design import list_designs

from needlefit.datasets.read import check, read
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import transform_surface
from needlefit.imaging import assembly
from needlefit.imaging.assembly import DatasetDescription, assemble_checked, assemble_dataset
from needlefit.imaging.batch import reconstruct_all
from needlefit.imaging.checks import collect_warnings
from needlefit.imaging.scans import read_scans
from needlefit.project.locate import shipped_folder
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


def named(name, medium="phantom2", surfaces=("interface1",), behind=0.0, **changes):
    """An insertion whose surfaces have these names; the first lies `behind` its place, others 1 mm apart."""
    one = small()
    (surface,) = one.layers.surfaces
    into = one.frame.rotation[:, 0]
    surfaces = tuple(
        replace(transform_surface(surface, Frame((behind + n) * into, np.eye(3))), name=called, into=n + 2)
        for n, called in enumerate(surfaces)
    )
    layers = replace(one.layers, surfaces=surfaces, sequence=tuple(range(1, len(surfaces) + 2)))
    return replace(one, scan=replace(one.scan, id=name, medium=medium), layers=layers, **changes)


def list_layers(folder):
    return sorted(file.name for file in (folder / "layers").iterdir())


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
    assert list_layers(tmp_path / "shared") == ["phantom2_interface1.stl"]
    assemble_dataset(tmp_path / "own", [named("a"), named("b", behind=0.5)], RECIPE, ABOUT)
    assert list_layers(tmp_path / "own") == ["a_1.stl", "b_1.stl"]
    assert check(tmp_path / "own") == []
    a, b = read(tmp_path / "own").insertions
    assert b.boundaries - a.boundaries == approx([0.5], abs=0.02)


def test_any_surface_name_gives_a_valid_file_and_media_share_none(tmp_path):
    called = ("skin {id}/2", "Fett (außen)", "fett au en", "x_1")
    assemble_dataset(tmp_path, [named("a", "gel", called)], RECIPE, ABOUT)
    files = ["gel_Fett_außen_.stl", "gel_fett_au_en.stl", "gel_skin_id_2.stl", "gel_x_1.stl"]
    assert list_layers(tmp_path) == files
    assert check(tmp_path) == []
    both = [named("a", "gel", ["b_c"]), named("b", "gel_b", ["c"])]
    kept, failed = assemble_checked(tmp_path / "both", both, RECIPE, ABOUT)
    assert kept == () and [one.scan.id for one in failed] == ["a", "b"] and not (tmp_path / "both").exists()
    assert "layers/gel_b_c.stl" in failed[0].error.what and failed[0].error is failed[1].error


def test_an_insertion_with_a_fault_is_left_out_and_reported(tmp_path, monkeypatch):
    checked = []
    monkeypatch.setattr(assembly, "check", lambda folder: checked.append(folder) or check(folder))
    assert assemble_checked(tmp_path / "all", [named("a"), named("c")], RECIPE, ABOUT)[1] == ()
    assert len(checked) == 1
    backwards = named("b", points=small().points[::-1])
    kept, failed = assemble_checked(tmp_path / "out", [named("a"), backwards, named("c")], RECIPE, ABOUT)
    assert [one.scan.id for one in kept] == ["a", "c"]
    assert {one.scan.id for one in failed} == {"b"}
    assert len(checked) == 1 + 1 + 3 + 1  # all, each alone, those without a fault
    assert check(tmp_path / "out") == []
    assert not (tmp_path / "out" / "centerlines" / "b.csv").exists()
    short = RECIPE.model_copy(update={"needle": RECIPE.needle.model_copy(update={"length_mm": 20.0})})
    kept, (failed,) = assemble_checked(tmp_path / "none", [named("a")], short, ABOUT)
    assert kept == () and not (tmp_path / "none").exists()
    message = str(failed.error)
    assert message.startswith(f"{small().scan.volume}: ") and "20 mm" in message
    assert "needle.length_mm" in message and "recipe" in message and "dataset.toml" not in message


def contradicted(one, away, source, **changes):
    """By the stage's entry, or the tissue's own surface, what the needle passes lies elsewhere along it."""
    runs = (replace(run, begin=run.begin + away, end=run.end + away) for run in one.passed)
    return replace(one, pose=replace(one.pose, source=source), passed=tuple(runs), **changes)


def own_surface(layers):
    return replace(layers, surfaces=(*layers.surfaces, replace(layers.surfaces[0], into=1)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda one: replace(one, registration=replace(one.registration, p_value=1e-4)),
            "registration error",
        ),
        (lambda one: replace(one, pose=replace(one.pose, angle_sd=0.2)), "bending plane"),
        (
            lambda one: contradicted(one, 4.0, "stage"),
            r"begins [34]\.\d\d ± .* mm after the stage's entry",
        ),
        (
            lambda one: contradicted(one, -2.0, "shaft", layers=own_surface(one.layers)),
            r"begins [12]\.\d\d ± .* mm before its own surface",
        ),
    ],
)
def test_doubtful_reconstructions_give_warnings(change, words):
    warnings = [*collect_warnings(change(small()))]
    assert any(re.search(words, warning) for warning in warnings), warnings


def test_an_insertion_of_the_synthetic_twin_is_as_deep_as_planned(tmp_path):
    plan = list_designs()[:1]
    dataset = read(build_dataset(tmp_path / "twin", 1, plan).parent)
    (insertion,) = dataset.insertions
    assert insertion.id == plan[0].id and insertion.depth == approx(plan[0].depth, abs=0.5)
