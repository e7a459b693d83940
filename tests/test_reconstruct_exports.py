"""The scene that `reconstruct --slicer-scene` writes for 3D Slicer: parsed back by its rules."""

import json
import zipfile
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from test_cli import run

from needlefit.datasets.formats.markups import read_markups
from needlefit.datasets.read import read
from needlefit.imaging.volume_files import read_volume

pytestmark = pytest.mark.sweep
BOX_MM = (8, 5, 6)
SCENE = ("--slicer-scene", "-q")


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """A scan, reconstructed with its scene: the folder of scans and dataset.

    The closed layer is a box beside the needle, within the scan.
    """
    folder = tmp_path_factory.mktemp("exports")
    assert run("twin", "ct", "sample", "--out", str(folder / "scans"), "-q") == 0
    box = trimesh.creation.box(BOX_MM, trimesh.transformations.translation_matrix([10, -8, 5]))
    box.export(folder / "scans/layers/phantom2_cylinder.stl")
    assert run("reconstruct", str(folder / "scans/scans.csv"), "--out", str(folder / "one"), *SCENE) == 0
    return folder


def test_the_scene_s_references_lead_to_nodes_and_files_that_lie_where_they_did(exported, tmp_path):
    bundle = exported / "one/slicer/sample.mrb"
    with zipfile.ZipFile(bundle) as archive:
        archive.extractall(tmp_path)
        names = set(archive.namelist())
    root = ElementTree.parse(tmp_path / "sample/sample.mrml").getroot()
    nodes = {node.get("id"): node for node in root}
    assert len(nodes) == len(root)
    used = {f"sample/{unquote(node.get('fileName'))}" for node in root if node.get("fileName")}
    assert used | {"sample/sample.mrml"} == names
    for node in root:
        for part in filter(None, node.get("references", "").split(";")):
            role, _, ids = part.partition(":")
            assert role in ("display", "storage", "ActiveVolume") and set(ids.split()) <= set(nodes)
    tags = [node.tag for node in root]
    counts = {"Volume": 1, "Model": 4, "MarkupsCurve": 4}
    assert {tag: tags.count(tag) for tag in counts} == counts
    for file in (tmp_path / "sample/Data").glob("*.mrk.json"):
        assert len(json.loads(file.read_text())["markups"]) == 1
    scan = read_volume(exported / "scans/volumes/sample.nrrd")
    again = read_volume(tmp_path / "sample/Data/scan.nrrd")
    np.testing.assert_array_equal(again.values, scan.values)
    np.testing.assert_allclose(again.origin, scan.origin, atol=1e-9)
    (insertion,) = read(exported / "one").insertions
    lists = [one for file in (tmp_path / "sample/Data").glob("*.mrk.json") for one in read_markups(file)]
    (curve,) = [one for one in lists if " inserted" in one.name]
    np.testing.assert_allclose(curve.points, insertion.patient.to_local(insertion.centerline), atol=1e-3)
