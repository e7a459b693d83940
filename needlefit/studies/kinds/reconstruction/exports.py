"""Export a reconstructed scan for other programs: a scene of 3D Slicer, a DICOM segmentation."""

from collections.abc import Collection
from pathlib import Path
from typing import Literal

from needlefit.errors import DataError
from needlefit.imaging.label_export import (
    mark_voxels,
    write_dicom_segmentation,
    write_slicer_segmentation,
)
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.volume_files import read_volume
from needlefit.studies.slicer_scene import write_slicer_scene

ExportKind = Literal["scene", "seg"]


def export_scan(
    one: Reconstruction, exports: Collection[ExportKind], folder: Path, diameter: float
) -> tuple[str, ...]:
    """Write what is exported of a scan; return warnings.

    `<id>.mrb`, a scene of 3D Slicer; `<id>.seg.dcm`, a DICOM segmentation. Where the scan allows none, it is
    `<id>.seg.nrrd`, a segmentation of 3D Slicer.
    """
    if not exports:
        return ()
    volume = read_volume(one.scan.volume, one.scan.series)
    if "scene" in exports:
        write_slicer_scene(one, volume, diameter, folder / f"{one.scan.id}.mrb")
    if "seg" in exports:
        marked = mark_voxels(one, volume.grid, diameter)
        try:
            write_dicom_segmentation(one.scan, marked, folder / f"{one.scan.id}.seg.dcm")
        except DataError as error:
            instead = folder / f"{one.scan.id}.seg.nrrd"
            write_slicer_segmentation(marked, volume.grid, instead)
            return (f"no DICOM segmentation is written, {instead.name} instead: {error.what}",)
    return ()
