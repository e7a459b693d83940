"""Write what 3D Slicer shows of a scan: a scene (`.mrb`), and control points by which it is corrected."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote
from xml.etree import ElementTree

import numpy as np

from needlefit.datasets.columns import make_id
from needlefit.datasets.formats.markups import CurveStyle, Markups, write_mrk_json
from needlefit.geometry.meshes import make_tube, write_ply
from needlefit.geometry.surfaces import make_mesh, map_surface
from needlefit.imaging.corrections import LIST_NAME, list_control_points
from needlefit.imaging.needle.segmentation import median_tissue_hu
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import write_nrrd
from needlefit.project.folders import replace_file
from needlefit.reporting.labels import rgb
from needlefit.reporting.slicer import INSERTED_COLOUR, LAYER_COLOUR, POINT_SIZE_MM, make_scan_markups

ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # date of all members, so that the same scene gives the same bytes
WINDOW_HU = 700.0  # width of the window in which tissue is shown, HU
CONTROL_POINT_STYLE = CurveStyle(rgb("#D55E00"), POINT_SIZE_MM, locked=False)


# By kind of node: tags of the node, of what stores it and of what displays it.
_NODES = {
    "Volume": ("ScalarVolume", "VolumeArchetypeStorage", "ScalarVolumeDisplay"),
    "MarkupsCurve": ("MarkupsCurve", "MarkupsJsonStorage", "MarkupsDisplay"),
    "MarkupsFiducial": ("MarkupsFiducial", "MarkupsJsonStorage", "MarkupsDisplay"),
    "Model": ("Model", "ModelStorage", "ModelDisplay"),
}
_IN_LPS = {"coordinateSystem": "LPS"}


@dataclass
class _SlicerScene:
    """The nodes of a scene and the folder of its files."""

    folder: Path
    root: ElementTree.Element
    counts: dict[str, int] = field(default_factory=dict)

    def add(self, tag: str, name: str, **attributes: str) -> str:
        """Add a node; return its id."""
        self.counts[tag] = self.counts.get(tag, 0) + 1
        id_ = f"vtkMRML{tag}Node{self.counts[tag]}"
        # volumes and what stores them have tags of their own
        short = tag.replace("ScalarVolume", "Volume")
        ElementTree.SubElement(self.root, short, {"id": id_, "name": name, **attributes})
        return id_

    def add_stored(
        self, kind: str, name: str, file: str, stored: Mapping[str, str], shown: Mapping[str, str]
    ) -> str:
        """Add a node with what stores and displays it, which have further attributes; return its id."""
        tag, storage, display = _NODES[kind]
        kept = self.add(storage, f"{name} storage", fileName=quote(f"Data/{file}"), **stored)
        seen = self.add(display, f"{name} display", visibility="true", **shown)
        return self.add(tag, name, references=f"display:{seen};storage:{kept};")


def write_control_points(points: Markups | None, folder: Path) -> None:
    """Write the control points of a scan, if there are any, to `<id>.corrections.mrk.json`."""
    if points is not None:
        folder.mkdir(exist_ok=True)
        path = folder / f"{points.path.name}.{LIST_NAME}.mrk.json"
        write_mrk_json(path, [(points, CONTROL_POINT_STYLE)])


def write_slicer_scene(one: Reconstruction, volume: Volume, diameter: float, path: Path) -> None:
    """Write a Medical Reality Bundle that shows a scan with what was found in it.

    It holds the volume, curves of the needle, entry, tip, layer crossings and markers, the control points
    of corrections, the needle and the surfaces of layers. The same content gives the same bytes.

    `diameter`: of the needle, mm.
    """
    with TemporaryDirectory(prefix="needlefit-") as folder:
        scene = _SlicerScene(
            Path(folder) / "Data", ElementTree.Element("MRML", version="Slicer5.0.0", userTags="")
        )
        scene.folder.mkdir()
        write_nrrd(volume, scene.folder / "scan.nrrd")
        shown = {"window": f"{WINDOW_HU:g}", "level": f"{median_tissue_hu(volume):g}"}
        shown |= {"autoWindowLevel": "0", "colorNodeID": "vtkMRMLColorTableNodeGrey"}
        volume_id = scene.add_stored("Volume", one.scan.id, "scan.nrrd", {}, shown)
        selected = {"id": "vtkMRMLSelectionNodeSingleton", "name": "Selection", "singletonTag": "Singleton"}
        selected["references"] = f"ActiveVolume:{volume_id};"
        ElementTree.SubElement(scene.root, "Selection", selected)
        lists = list(make_scan_markups(one))
        if (points := list_control_points(one)) is not None:
            lists.append((points, CONTROL_POINT_STYLE))
        for number, (markups, style) in enumerate(lists, start=1):
            file, colour = f"markups{number}.mrk.json", _format_colour(style.colour)
            write_mrk_json(scene.folder / file, [(markups, style)])
            shown = {"color": colour, "selectedColor": colour}
            scene.add_stored(f"Markups{markups.kind}", markups.name, file, _IN_LPS, shown)
        matrix = np.eye(4)  # from the world to the scan
        matrix[:3, :3] = one.patient.rotation.T
        matrix[:3, 3] = -one.patient.rotation.T @ one.patient.origin
        layers = [map_surface(surface, matrix) for surface in one.layers.surfaces]
        across = one.patient.rotation.T @ one.frame.rotation[:, 1]  # C's y axis in the scan
        needle = make_tube(one.needle_axis.points, diameter / 2, across)
        bodies = [
            (f"into layer {layer.into}: {layer.name}", layer.mesh, "0.4", LAYER_COLOUR) for layer in layers
        ]
        for number, (name, body, opacity, colour) in enumerate(
            [*bodies, ("needle", make_mesh(*needle), "1", INSERTED_COLOUR)], start=1
        ):
            file = f"{number}_{make_id(name, 'surface')}.ply"
            write_ply(body.vertices, body.faces, scene.folder / file)
            shown = {"color": _format_colour(rgb(colour)), "opacity": opacity}
            scene.add_stored("Model", name, file, _IN_LPS, shown)
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
