"""Write a reconstruction as a scene of 3D Slicer (`.mrb`): scan, needle, points, layers, all in place."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote
from xml.etree import ElementTree

from needlefit.datasets.columns import make_id
from needlefit.datasets.formats.mrk_json import write_mrk_json
from needlefit.geometry.meshes import write_ply
from needlefit.imaging.label_export import (
    layers_in_patient,
    mark_voxels,
    write_slicer_segmentation,
)
from needlefit.imaging.needle.segmentation import median_tissue_hu
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import write_volume
from needlefit.project.folders import replace_file
from needlefit.reporting.labels import rgb
from needlefit.studies.slicer import LAYER_COLOUR, make_scan_markups

ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # date of all members, so that the same scene gives the same bytes
WINDOW_HU = 700.0  # width of the window in which tissue is shown, HU


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


def write_slicer_scene(one: Reconstruction, volume: Volume, diameter: float, path: Path) -> None:
    """Write a Medical Reality Bundle that shows a scan with what was found in it.

    It holds the volume, curves of the needle, entry, tip, layer crossings and markers, open surfaces of
    layers as models, closed ones and the needle as a segmentation. The same content gives the same bytes.

    `diameter`: of the needle, mm.
    """
    marked = mark_voxels(one, volume.grid, diameter)
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
        for number, (markups, style) in enumerate(make_scan_markups(one), start=1):
            file, colour = f"markups{number}.mrk.json", _format_colour(style.colour)
            write_mrk_json(scene.folder / file, [(markups, style)])
            shown = {"color": colour, "selectedColor": colour}
            scene.add_stored(f"Markups{markups.kind}", markups.name, file, _IN_LPS, shown)
        # the open surfaces of the layers; closed ones are segments
        sheets = [surface for surface in layers_in_patient(one) if surface.kind == "sheet"]
        for number, sheet in enumerate(sheets, start=1):
            file = f"{number}_{make_id(sheet.name, 'surface')}.ply"
            write_ply(sheet.mesh.vertices, sheet.mesh.faces, scene.folder / file)
            shown = {"color": _format_colour(rgb(LAYER_COLOUR)), "opacity": "0.4"}
            scene.add_stored("Model", f"into layer {sheet.into}: {sheet.name}", file, _IN_LPS, shown)
        file = "segmentation.seg.nrrd"
        write_slicer_segmentation(marked, volume.grid, scene.folder / file)
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
