"""Segments of a label map, chosen by name."""

from functools import partial

import pytest
from layer_cases import labelled, save_segments
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refused_file

from needlefit.imaging.layers import extract_label_surfaces
from needlefit.imaging.scans import LayerSource, parse_layer_source
from needlefit.imaging.segmentations import read_labels

pytestmark = pytest.mark.usefixtures("read_here")

refused = partial(refused_file, read_labels)


def test_segments_are_chosen_by_name(tmp_path):
    path = save_segments(
        tmp_path / "l.seg.nrrd", [labelled(lambda p: 1 + (p[:, 0] > 0))], [(1, "skin"), (2, "fat")]
    )
    assert [one.name for one in read_labels(path, ("Fat", "skin")).segments] == ["fat", "skin"]
    assert "bone" in refused(path, ("bone",)).what and "fat" in refused(path, ("bone",)).expected
    (fat,) = extract_label_surfaces(path, ("fat",))
    assert fat.into == 1 and fat.vertices[:, 0].min() == pytest.approx(0, abs=0.1)
    source = parse_layer_source("l.seg.nrrd=segments:skin, fat", tmp_path)
    assert source == LayerSource(path, segments=("skin", "fat"))
    with pytest.raises(ValueError, match=r"l\.seg\.nrrd"):
        parse_layer_source("l.seg.nrrd=solid:2", tmp_path)
