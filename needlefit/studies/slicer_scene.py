"""Write what 3D Slicer shows of a scan: a scene (`.mrb`), and control points by which it is corrected."""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.columns import make_id
from needlefit.datasets.formats.mrk_json import CurveStyle, write_mrk_json
from needlefit.datasets.markups import Markups
from needlefit.geometry.meshes import fill_mesh, make_tube, write_ply
from needlefit.geometry.surfaces import Surface, make_mesh, map_surface
from needlefit.imaging.corrections import LIST_NAME, make_control_points
from needlefit.imaging.needle.segmentation import median_tissue_hu
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.volume import Volume, VoxelGrid, to_index
from needlefit.imaging.volume_files import explain_missing_packages, write_volume
from needlefit.project.folders import replace_file
from needlefit.reporting.labels import rgb
from needlefit.studies.slicer import LAYER_COLOUR, POINT_SIZE_MM, make_scan_markups

ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # date of all members, so that the same scene gives the same bytes
WINDOW_HU = 700.0  # width of the window in which tissue is shown, HU
CONTROL_POINT_STYLE = CurveStyle(rgb("#D55E00"), POINT_SIZE_MM, locked=False)


# By kind of node: tag and class of the node, of what stores it and of what displays it.
_NODES = {
    "Volume": (
        ("Volume", "vtkMRMLScalarVolumeNode"),
        ("VolumeArchetypeStorage", "vtkMRMLVolumeArchetypeStorageNode"),
        ("VolumeDisplay", "vtkMRMLScalarVolumeDisplayNode"),
    ),
    **{
        kind: (
            (kind, f"vtkMRML{kind}Node"),
            (f"{stored}Storage", f"vtkMRML{stored}StorageNode"),
            (f"{shown}Display", f"vtkMRML{shown}DisplayNode"),
        )
        for kind, stored, shown in (
            ("MarkupsCurve", "MarkupsJson", "Markups"),
            ("MarkupsFiducial", "MarkupsJson", "Markups"),
            ("Model", "Model", "Model"),
            ("Segmentation", "Segmentation", "Segmentation"),
        )
    },
}
_IN_LPS = {"coordinateSystem": "LPS"}


@dataclass
class _SlicerScene:
    """The nodes of a scene and the folder of its files."""

    folder: Path
    root: ElementTree.Element
    counts: dict[str, int] = field(default_factory=dict)

    def add(self, node: tuple[str, str], name: str, **attributes: str) -> str:
        """Add a node; return its id."""
        tag, class_ = node
        self.counts[class_] = self.counts.get(class_, 0) + 1
        id_ = f"{class_}{self.counts[class_]}"
        ElementTree.SubElement(self.root, tag, {"id": id_, "name": name, **attributes})
        return id_

    def add_stored(
        self, kind: str, name: str, file: str, stored: Mapping[str, str], shown: Mapping[str, str]
    ) -> str:
        """Add a node with what stores and displays it, which have further attributes; return its id."""
        node, storage, display = _NODES[kind]
        kept = self.add(storage, f"{name} storage", fileName=quote(f"Data/{file}"), **stored)
        seen = self.add(display, f"{name} display", visibility="true", **shown)
        return self.add(node, name, references=f"display:{seen};storage:{kept};")


def make_scan_control_points(one: Reconstruction) -> Markups | None:
    """Return the control points by which a reconstruction is corrected, LPS."""
    (entry,) = one.patient.to_local(one.points[:1])
    balls = np.empty((0, 3)) if one.markers is None else one.markers.centers
    return make_control_points(one.scan.id, one.needle_axis.points, entry, balls)


def write_control_points(points: Markups | None, folder: Path) -> None:
    """Write the control points of a scan, if there are any, to `<id>.corrections.mrk.json`."""
    if points is not None:
        folder.mkdir(exist_ok=True)
        path = folder / f"{points.path.name}.{LIST_NAME}.mrk.json"
        write_mrk_json(path, [(points, CONTROL_POINT_STYLE)])


def write_slicer_scene(one: Reconstruction, volume: Volume, diameter: float, path: Path) -> None:
    """Write a Medical Reality Bundle that shows a scan with what was found in it.

    It holds the volume, curves of the needle, entry, tip, layer crossings and markers, the control points
    of corrections, open surfaces of layers as models, closed ones and the needle as a segmentation. The same
    content gives the same bytes.

    `diameter`: of the needle, mm.
    """
    labels, names = _mark_voxels(one, volume.grid, diameter)
    with TemporaryDirectory(prefix="needlefit-") as folder:
        scene = _SlicerScene(
            Path(folder) / "Data", ElementTree.Element("MRML", version="Slicer5.0.0", userTags="")
        )
        scene.folder.mkdir()
        write_volume(volume, scene.folder / "scan.nrrd")
        shown = {"window": f"{WINDOW_HU:g}", "level": f"{median_tissue_hu(volume):g}"}
        shown |= {"autoWindowLevel": "0", "colorNodeID": "vtkMRMLColorTableNodeGrey"}
        volume_id = scene.add_stored("Volume", one.scan.id, "scan.nrrd", {}, shown)
        selected = {"id": "vtkMRMLSelectionNodeSingleton", "name": "Selection", "singletonTag": "Singleton"}
        selected["references"] = f"ActiveVolume:{volume_id};"
        ElementTree.SubElement(scene.root, "Selection", selected)
        lists = list(make_scan_markups(one))
        if (points := make_scan_control_points(one)) is not None:
            lists.append((points, CONTROL_POINT_STYLE))
        for number, (markups, style) in enumerate(lists, start=1):
            file, colour = f"markups{number}.mrk.json", _format_colour(style.colour)
            write_mrk_json(scene.folder / file, [(markups, style)])
            shown = {"color": colour, "selectedColor": colour}
            scene.add_stored(f"Markups{markups.kind}", markups.name, file, _IN_LPS, shown)
        # the open surfaces of the layers; closed ones are segments
        sheets = [surface for surface in _layers_in_patient(one) if surface.kind == "sheet"]
        for number, sheet in enumerate(sheets, start=1):
            file = f"{number}_{make_id(sheet.name, 'surface')}.ply"
            write_ply(sheet.mesh.vertices, sheet.mesh.faces, scene.folder / file)
            shown = {"color": _format_colour(rgb(LAYER_COLOUR)), "opacity": "0.4"}
            scene.add_stored("Model", f"into layer {sheet.into}: {sheet.name}", file, _IN_LPS, shown)
        file = "segmentation.seg.nrrd"
        _write_segmentation(labels, names, volume.grid, scene.folder / file)
        scene.add_stored("Segmentation", f"{one.scan.id} needle and layers", file, {}, {})
        ElementTree.indent(scene.root)
        text = ElementTree.tostring(scene.root, encoding="utf-8", xml_declaration=True)
        (Path(folder) / f"{one.scan.id}.mrml").write_bytes(text + b"\n")
        files = sorted(file for file in Path(folder).rglob("*") if file.is_file())
        with replace_file(path) as fresh, zipfile.ZipFile(fresh, "w") as archive:
            for stored in files:  # in a folder, as 3D Slicer has it
                place = stored.relative_to(folder).as_posix()
                member = zipfile.ZipInfo(f"{one.scan.id}/{place}", ZIP_DATE)
                packed = stored.suffix != ".nrrd"
                member.compress_type = zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
                member.external_attr = 0o644 << 16
                archive.writestr(member, stored.read_bytes())


def _format_colour(colour: tuple[float, float, float]) -> str:
    return " ".join(f"{part:.4g}" for part in colour)


NEEDLE_SEGMENT = "needle"
SEGMENT_COLOURS = ("0.90 0.78 0.55", "0.55 0.72 0.85", "0.75 0.60 0.75", "0.60 0.78 0.60")
NEEDLE_COLOUR = "0.00 0.45 0.70"  # red, green, blue, 0 to 1


def _layers_in_patient(one: Reconstruction) -> tuple[Surface, ...]:
    """Return the surfaces of the layers in the frame of the scan, LPS, mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = one.patient.rotation.T
    matrix[:3, 3] = -one.patient.rotation.T @ one.patient.origin
    return tuple(map_surface(surface, matrix) for surface in one.layers.surfaces)


def _mark_voxels(
    one: Reconstruction, grid: VoxelGrid, diameter: float
) -> tuple[NDArray[np.uint8], tuple[str, ...]]:
    """Return labels 1, 2, ... of voxels (K, J, I), 0 elsewhere, and what each is: solid layers, the needle.

    Of solids that lie in one another the later one has the voxels. Open surfaces (sheets) bound no voxels.
    """
    solids = [surface for surface in _layers_in_patient(one) if surface.kind == "solid"]
    across = one.patient.rotation.T @ one.frame.rotation[:, 1]  # C's y axis in the scan
    tube = make_mesh(*make_tube(one.needle_axis.points, diameter / 2, across))
    values = np.zeros(grid.size[::-1], dtype=np.uint8)
    for label, mesh in enumerate([*(solid.mesh for solid in solids), tube], 1):
        indices = mesh.copy()
        indices.vertices = to_index(grid, mesh.vertices)
        values[fill_mesh(indices, grid.size)] = label
    names = [f"layer {solid.into}: {solid.name}" for solid in solids]
    return values, (*names, NEEDLE_SEGMENT)


def _write_segmentation(values: NDArray[np.uint8], names: Sequence[str], grid: VoxelGrid, path: Path) -> None:
    """Write labels 1, 2, ... (K, J, I) on a grid with the name and colour of each segment."""
    with explain_missing_packages():
        from needlefit.imaging.image_files import write_labels

        found = {
            "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
            "Segmentation_SourceRepresentation": "Binary labelmap",
            "Segmentation_MasterRepresentation": "Binary labelmap",  # its name before Slicer 5.2
            "Segmentation_ReferenceImageExtentOffset": "0 0 0",
            "Segmentation_ConversionParameters": "",
        }
        for number, name in enumerate(names):
            where = np.argwhere(values == number + 1)[:, ::-1]
            low, high = (where.min(axis=0), where.max(axis=0)) if len(where) else (np.zeros(3), -np.ones(3))
            extent = " ".join(f"{a:.0f} {b:.0f}" for a, b in zip(low, high, strict=True))
            colour = (
                NEEDLE_COLOUR if name == NEEDLE_SEGMENT else SEGMENT_COLOURS[number % len(SEGMENT_COLOURS)]
            )
            entries = {"ID": f"Segment_{number + 1}", "Name": name, "NameAutoGenerated": "0", "Color": colour}
            entries |= {"ColorAutoGenerated": "0", "LabelValue": str(number + 1), "Layer": "0"}
            entries |= {"Extent": extent, "Tags": ""}
            found |= {f"Segment{number}_{key}": value for key, value in entries.items()}
        write_labels(values, grid, found, path)
