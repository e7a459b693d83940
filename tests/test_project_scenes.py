"""The shipped scenes hold the paper's parameter sets, and nothing else."""

import csv
from pathlib import Path

import pytest

from needlefit.errors import ConfigError
from needlefit.project.load import check, load
from needlefit.project.overrides import keys, override
from needlefit.project.places import find, names, shipped
from needlefit.project.records.scene import SceneRecord

PAPER = shipped() / "data" / "paper"
TUNED_ON = {"study1": "phantom2", "study2": "phantom2", "study3": "phantom2", "study4": "phantom2"}
TUNED_ON |= {"study5": "chicken", "phantom2_by_layers": "phantom2"}


def rows(name: str) -> list[dict[str, str]]:
    with (PAPER / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


SETS = rows("parameters")


def scene(name: str) -> SceneRecord:
    return load(find("scene", name), SceneRecord)


def test_every_set_has_its_scene():
    assert {row["set"] for row in SETS} <= set(names("scene"))


@pytest.mark.parametrize("row", SETS, ids=lambda row: row["set"])
def test_a_scene_holds_the_published_parameters(row):
    record = scene(row["set"])
    printed = [(row[f"mu{n}_pa"], row[f"alpha{n}"]) for n in (1, 2, 3, 4) if row[f"mu{n}_pa"]]
    assert [(layer.mu_pa, layer.alpha) for layer in record.layers] == [
        (float(mu), float(a)) for mu, a in printed
    ]
    assert record.bevel.offset_mm == float(row["bevel_mm"])
    assert [layer.top_mm for layer in record.layers] == [0, 20, 28, 45][: len(printed)]


@pytest.mark.parametrize("name", [row["set"] for row in SETS])
def test_its_depth_is_the_middle_of_the_medium_s(name):
    medium = TUNED_ON.get(name, name)
    depths = [
        float(row[key])
        for row in rows("insertions")
        if row["medium"] == medium
        for key in ("depth_min_mm", "depth_max_mm")
    ]
    assert scene(name).depth_mm == pytest.approx((min(depths) + max(depths)) / 2)


@pytest.mark.parametrize("name", [row["set"] for row in SETS])
def test_it_is_the_paper_s_needle_and_says_what_is_invented(name):
    record = scene(name)
    assert (record.needle.length_mm, record.needle.outer_diameter_mm) == (150, 1.27)
    assert record.needle.youngs_modulus_gpa == 80
    assert len(record.layers) == 1 or "invented" in record.note


def test_every_key_can_be_set():
    tables = {"layers": [{}, {}], "needle": {}}
    known = set(keys(SceneRecord, tables))
    assert {
        "depth_mm",
        "bevel.offset_mm",
        "layers.2.alpha",
        "needle.length_mm",
        "controls.base_y_mm",
    } <= known
    assert "layers.3.alpha" not in known and "schema" not in known


def test_setting_leaves_the_file_s_tables_alone():
    tables = {"depth_mm": 3.0, "layers": [{"mu_pa": 1.0}]}
    changed = override(tables, [("layers.1.mu_pa", "3e5"), ("law", "linear")], SceneRecord, "a.toml")
    assert changed == {"depth_mm": 3.0, "layers": [{"mu_pa": 3e5}], "law": "linear"}
    assert tables == {"depth_mm": 3.0, "layers": [{"mu_pa": 1.0}]}


def test_a_fault_in_a_list_is_numbered_from_1(tmp_path: Path):
    tables = {"schema": 1, "depth_mm": 3.0, "needle": {"length_mm": 9, "flexural_rigidity_nmm2": 1}}
    tables |= {"bevel": {"offset_mm": 0.1}, "layers": [{"top_mm": 0, "mu_pa": 1, "alpha": 1}, {"top_mm": 1}]}
    with pytest.raises(ConfigError, match=r"`layers\.2\.mu_pa` is missing"):
        check(tables, SceneRecord, "a.toml")
