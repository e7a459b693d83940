"""Export a reconstructed scan for other programs: a scene of 3D Slicer, a DICOM segmentation."""

from collections.abc import Collection
from pathlib import Path
from typing import Literal

from needlefit.imaging.label_export import mark_voxels, write_dicom_segmentation
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.volume_files import read_volume
from needlefit.studies.slicer_scene import write_slicer_scene

ExportKind = Literal["scene", "seg"]


def export_scan(one: Reconstruction, exports: Collection[ExportKind], folder: Path, diameter: float) -> None:
    """Write what is exported of a scan: `<id>.mrb`, a scene of 3D Slicer; `<id>.seg.dcm`, a DICOM-SEG."""
    if not exports:
        return
    volume = read_volume(one.scan.volume, one.scan.series)
    if "scene" in exports:
        write_slicer_scene(one, volume, diameter, folder / f"{one.scan.id}.mrb")
    if "seg" in exports:
        marked = mark_voxels(one, volume.grid, diameter)
        write_dicom_segmentation(one.scan, marked, folder / f"{one.scan.id}.seg.dcm")
