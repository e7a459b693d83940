"""Mark needle and layers of a reconstruction in the voxels of its scan; write DICOM-SEG, `.seg.nrrd`."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.meshes import fill_mesh, make_tube
from needlefit.geometry.surfaces import Surface, make_mesh, map_surface
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.refusals import refusal
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import IMAGE_SUFFIXES, VoxelGrid, list_series_files
from needlefit.imaging.volume_files import (
    SEGMENT_SECONDS,
    SEGMENTATION_BYTES,
    UNPACKED_BYTES_PER_SECOND,
    explain_missing_packages,
    unpacked,
)
from needlefit.project.sandbox import limits_for, read_in_sandbox

NEEDLE_SEGMENT = "needle"
SEGMENT_COLOURS = ("0.90 0.78 0.55", "0.55 0.72 0.85", "0.75 0.60 0.75", "0.60 0.78 0.60")
NEEDLE_COLOUR = "0.00 0.45 0.70"  # red, green, blue, 0 to 1


@dataclass(frozen=True)
class MarkedVoxels:
    """Labels 1, 2, ... of voxels (K, J, I), 0 elsewhere, and what each label is."""

    values: NDArray[np.uint8]
    names: tuple[str, ...]


def layers_in_patient(one: Reconstruction) -> tuple[Surface, ...]:
    """Return the surfaces of the layers in the frame of the scan, LPS, mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = one.patient.rotation.T
    matrix[:3, 3] = -one.patient.rotation.T @ one.patient.origin
    return tuple(map_surface(surface, matrix) for surface in one.layers.surfaces)


def mark_voxels(one: Reconstruction, grid: VoxelGrid, diameter: float) -> MarkedVoxels:
    """Return the voxels of the solid layers, in their order, and of the needle, which comes last.

    Of solids that lie in one another the later one has the voxels. Open surfaces (sheets) bound no voxels.
    """
    solids = [surface for surface in layers_in_patient(one) if surface.kind == "solid"]
    across = one.patient.rotation.T @ one.frame.rotation[:, 1]  # C's y axis in the scan
    tube = make_mesh(*make_tube(one.needle_axis.points, diameter / 2, across))
    values = np.zeros(grid.size[::-1], dtype=np.uint8)
    for label, mesh in enumerate([*(solid.mesh for solid in solids), tube], 1):
        indices = mesh.copy()
        indices.vertices = (mesh.vertices - grid.origin) @ grid.direction / grid.spacing
        values[fill_mesh(indices, grid.size)] = label
    names = [f"layer {solid.into}: {solid.name}" for solid in solids]
    return MarkedVoxels(values, (*names, NEEDLE_SEGMENT))


def write_dicom_segmentation(scan: Scan, marked: MarkedVoxels, path: Path) -> None:
    """Write a DICOM segmentation that refers to the slices of a scan; the same content gives the same bytes.

    DataError if the scan is no DICOM series, or its headers lack what a segmentation must repeat. ConfigError
    if a package is missing.
    """
    if scan.volume.name.lower().endswith(IMAGE_SUFFIXES):
        raise refusal(f"""the scan is no DICOM series
            expected: slices that a DICOM segmentation can refer to
            fix: give the DICOM series itself
            where: {scan.volume}""")
    with explain_missing_packages(), unpacked(scan.volume) as place, TemporaryDirectory() as folder:
        labels, written = Path(folder) / "labels.npy", Path(folder) / "segmentation.dcm"
        np.save(labels, marked.values)
        size = sum(file.stat().st_size for file in list_series_files(place))
        seconds = SEGMENT_SECONDS + size / UNPACKED_BYTES_PER_SECOND
        allowed = limits_for(SEGMENTATION_BYTES + 8 * marked.values.size, 4 * marked.values.size, seconds)
        arguments = {"path": str(place), "series": scan.series, "names": list(marked.names)}
        arguments |= {"labels": str(labels), "out": str(written)}
        writer = "needlefit.imaging.dicom.segmentation_writer:write_segmentation"
        read_in_sandbox(writer, scan.volume, allowed, arguments)
        path.write_bytes(written.read_bytes())


def write_slicer_segmentation(marked: MarkedVoxels, grid: VoxelGrid, path: Path) -> None:
    """Write labels on a grid with the name and colour of each segment; the same labels give the same bytes.

    ConfigError if the packages that write scans are not installed.
    """
    with explain_missing_packages():
        from needlefit.imaging.image_files import write_labels

        found = {
            "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
            "Segmentation_SourceRepresentation": "Binary labelmap",
            "Segmentation_MasterRepresentation": "Binary labelmap",  # its name before Slicer 5.2
            "Segmentation_ReferenceImageExtentOffset": "0 0 0",
            "Segmentation_ConversionParameters": "",
        }
        for number, name in enumerate(marked.names):
            where = np.argwhere(marked.values == number + 1)[:, ::-1]
            low, high = (where.min(axis=0), where.max(axis=0)) if len(where) else (np.zeros(3), -np.ones(3))
            extent = " ".join(f"{a:.0f} {b:.0f}" for a, b in zip(low, high, strict=True))
            colour = (
                NEEDLE_COLOUR if name == NEEDLE_SEGMENT else SEGMENT_COLOURS[number % len(SEGMENT_COLOURS)]
            )
            entries = {"ID": f"Segment_{number + 1}", "Name": name, "NameAutoGenerated": "0", "Color": colour}
            entries |= {"ColorAutoGenerated": "0", "LabelValue": str(number + 1), "Layer": "0"}
            entries |= {"Extent": extent, "Tags": ""}
            found |= {f"Segment{number}_{key}": value for key, value in entries.items()}
        write_labels(marked.values, grid, found, path)
