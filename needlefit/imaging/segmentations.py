"""Read segmentations: volumes in which every voxel holds the number of its layer."""

from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from needlefit.errors import DataError, located
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import open_member, read_image_file

SAVE_FIX = "load the segmentation in 3D Slicer, contours (RTSTRUCT) too, and save it as .seg.nrrd"


@dataclass(frozen=True)
class Labels:
    """A segmentation, and the names of the layers 1, 2, ... by the values of their voxels, in this order."""

    volume: Volume
    names: dict[int, str]  # "" where the file states none


def read_labels(path: Path) -> Labels:
    """Read a segmentation: `.seg.nrrd` of 3D Slicer, any label volume, a .zip of one.

    The layers are the segments in the order in which the file lists them, or, where it lists none, the labels
    in the order of their values.

    DataError if it is not a volume, its segments overlap, one is empty or missing, or its values are no
    labels.
    """
    with open_member(path) as place, located(place):
        volume, texts = read_image_file(place)
        present = sorted(set().union(*(np.unique(plane).tolist() for plane in volume.values)) - {0.0})
        are_labels = all(0 < value < 2**16 and value.is_integer() for value in present)
        if not are_labels or not 1 <= len(present) <= np.iinfo(np.uint8).max:
            raise DataError(
                f"holds {len(present)} values besides 0, {', '.join(map(str, present[:3]))} ...: no labels",
                expected="a .seg.nrrd, or another volume (NRRD, NIfTI, MetaImage) of a whole number for each "
                "voxel's layer, 0 outside the tissue",
                fix=SAVE_FIX,
            )
        labels = [f"{value:.0f}" for value in present]
        numbers = takewhile(lambda n: f"Segment{n}_ID" in texts, count())
        stated = [
            (
                texts.get(f"Segment{n}_LabelValue", f"{n + 1}").strip(),
                texts.get(f"Segment{n}_Name", "").strip(),
            )
            for n in numbers
        ] or [(label, "") for label in labels]
        if sorted(label for label, _ in stated) != sorted(labels):
            segments = ", ".join(f"{name} (label {label})" for label, name in stated)
            raise DataError(
                f"its voxels have the labels {', '.join(labels)}, its segments are {segments}",
                expected="each voxel in one segment, and voxels in every segment",
                fix=SAVE_FIX,
            )
        return Labels(volume, {int(label): name for label, name in stated})
