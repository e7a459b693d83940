"""Valid inputs of every kind, small, with the same bytes in every run."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
CASES = Path(__file__).resolve().parent.parent / "imports"
CORPUS = PROJECT / "tests" / "fuzz" / "corpus"
"""Files that once ended the interpreter, or took gigabytes."""


@dataclass(frozen=True)
class Seed:
    """A valid input: files by their names, which of them is opened, and which are damaged."""

    files: Mapping[str, bytes]
    opened: str
    damaged: tuple[str, ...]


def one_file(name, data):
    return Seed({name: data.encode() if isinstance(data, str) else data}, name, (name,))


def project_files(pattern, name):
    """Return the project's own files that match a pattern, each as an input of the same name."""
    return [one_file(name, path.read_bytes()) for path in sorted(PROJECT.glob(pattern))]


def corpus(pattern):
    """Return crashing inputs: their neighbours are the likeliest to crash again."""
    found = []
    for path in sorted(CORPUS.glob(pattern)):
        endings = path.suffixes[-2 if path.suffix in (".gz", ".nrrd") else -1 :]
        found.append(one_file("".join(("volume", *endings)), path.read_bytes()))
    return found


def written(write, opened, damaged=()):
    """Return the files that `write` leaves in a folder; `damaged` are all of them unless some are named."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        paths = sorted(path for path in Path(folder).rglob("*") if path.is_file())
        files = {str(path.relative_to(folder)): path.read_bytes() for path in paths}
    return Seed(files, opened, tuple(damaged) or tuple(files))


def saved(name, write, *arguments, **options):
    """Return the file that `write` makes of a path, which it takes first, and of these arguments."""
    return written(lambda folder: write(folder / name, *arguments, **options), name)


# ---- datasets


def datasets():
    """A dataset with surfaces, and one of tip tracks in a long table."""
    from test_datasets import block, without_checksums
    from track_cases import GUIDE, track
    from track_cases import written as write_tracks

    runs = [track("r1", GUIDE), track("r2", 0 * GUIDE)]
    return [
        written(lambda folder: without_checksums(block(folder)), "dataset.toml"),
        written(lambda folder: write_tracks(folder, runs), "dataset.toml"),
    ]


# ---- files of other programs


def markups():
    from test_datasets_markups import COLUMNS, HEADER, markup, save

    points = [(5.0 * k, 0.0, 0.01 * k * k) for k in range(12)]
    rows = "".join(f"F_{k},{x},{y},{z},0,0,0,1,1,1,0,F-{k},,,2,0\n" for k, (x, y, z) in enumerate(points))
    old = "".join(f"p{k},{x},{y},{z},1,1\n" for k, (x, y, z) in enumerate(points))
    tables = (HEADER.format("4.11", "LPS") + COLUMNS + rows, f"# CoordinateSystem = 0\n{old}")
    return [
        *(saved("curve.mrk.json", save, markup(kind, points=points)) for kind in ("Curve", "Fiducial")),
        *(one_file("curve.fcsv", text) for text in tables),
        one_file("labels.mrk.json", (CASES / "labels.mrk.json").read_bytes()),
    ]


def markers():
    table = (PROJECT / "data/sample_scan/markers/sample.csv").read_bytes()
    return [one_file("markers.csv", table), *markups()]


def sources():
    rows = "".join(f"{name},{x},0,{4e-4 * x * x:.5f},0.1\n" for name in "ab" for x in range(0, 60, 4))
    return [
        one_file("shapes.csv", "id,x_mm,y_mm,z_mm,sd_mm\n" + rows),
        one_file("shape.csv", "x_mm,y_mm,z_mm\n" + "".join(f"{x},0,{x * x / 1e3}\n" for x in range(30))),
    ]


def matlab():
    """MATLAB files of version 4, 5, 7 (compressed) and 7.3 (HDF5), and the crashing ones."""
    import numpy as np
    from scipy.io import savemat

    x = np.arange(0.0, 60.0, 3.0)
    curve = np.column_stack([x, 0 * x, 4e-4 * x * x])
    nested = {"curve": curve, "s": {"a": curve, "name": "needle"}, "unit": "mm"}

    def five_of(path, compressed):
        savemat(path, nested, do_compression=compressed)
        # scipy writes the time into the first 116 bytes
        path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(116) + path.read_bytes()[116:])

    name = "curve.mat"
    return [
        saved(name, savemat, {"curve": curve}, format="4"),
        *(saved(name, five_of, compressed) for compressed in (False, True)),
        one_file(name, (CASES / "needles_v73.mat").read_bytes()),
        *(one_file(name, path.read_bytes()) for path in sorted(CORPUS.glob("*.mat"))),
    ]


def json_lines():
    points = "".join(f'{{"needle": "a", "x": {x}, "y": 0, "z": {x * x / 2000}}}\n' for x in range(0, 60, 4))
    return [
        one_file("a.jsonl", (CASES / "shapes.jsonl").read_bytes()),
        one_file("a.jsonl", points),
    ]


def import_tables():
    from import_cases import needle, write_european_csv

    curves = [needle(n, 9 - n) for n in range(2)]
    return [
        saved("t.csv", write_european_csv, curves),
        one_file("t.txt", (CASES / "em.csv").read_text().replace(",", "\t").encode("utf-16")),
        *(one_file("t.csv", (CASES / name).read_bytes()) for name in ("em.csv", "clock.csv")),
    ]


def structure_sets():
    return [one_file("needles.dcm", (CASES / "needles_rs.dcm").read_bytes())]


def workbooks():
    from import_cases import needle, write_sheets

    rows = [["x (mm)", "y (mm)", "z (mm)"], *needle(1, 8).tolist()]
    return [saved("t.xlsx", lambda path: write_sheets(path, Nadel=rows))]


def volumes():
    """NRRD, NIfTI and MetaImage, packed and not, with the voxels inside or beside, and the crashing ones."""
    import test_imaging_volume as cases

    image = cases.volume_of(cases.VALUES)

    def with_raw(name, write, **options):
        def both(folder):
            write(folder / name, **options)
            (folder / "volume.raw").write_bytes(cases.VALUES.tobytes())

        return written(both, name)

    writers = {"volume.nrrd": cases.nrrd, "volume.nii.gz": cases.nifti, "volume.mha": cases.metaimage}
    return [
        *(saved(name, write) for name, write in writers.items()),
        saved("volume.nrrd", lambda path: cases.write_volume(image, path)),
        with_raw("volume.nhdr", cases.nrrd, data=b"", data_file="volume.raw"),
        with_raw("volume.mhd", cases.metaimage, ElementDataFile="volume.raw"),
        *corpus("crash-volume-*"),
    ]


def labels():
    from layer_cases import labelled, save, save_segments

    volume = labelled(lambda points: 1 + (points[:, 0] > 0), shape=(8, 9, 10))
    return [
        saved("l.seg.nrrd", save_segments, volume, [(1, "skin"), (2, "fat")]),
        *(saved(name, save, volume) for name in ("l.nii.gz", "l.nrrd")),
        *corpus("crash-labels-*"),
    ]


def dicom():
    """A series of slices, plain and compressed, one of which is damaged, and the slices that took 4 GB."""
    import numpy as np
    from dicom_series import COUNT, a_slice, packed_as, save

    first = "series/000.dcm"

    def series(make):
        def write(folder):
            plain = (a_slice(k, np.full((8, 6), k, dtype=np.int16)) for k in range(COUNT))
            save(folder / "series", [make(one, folder) for one in plain])

        return written(write, "series", (first,))

    return [
        series(lambda one, _: one),
        series(lambda one, folder: packed_as(one, "JPEG2000", folder)),
        *(Seed({first: path.read_bytes()}, "series", (first,)) for path in sorted(CORPUS.glob("*.dcm"))),
    ]


def archives():
    import zipfile

    files = {f"s/{Path(file).name}": data for file, data in dicom()[0].files.items()}

    def write(path, method):
        with zipfile.ZipFile(path, "w", method) as archive:
            for name, data in files.items():
                archive.writestr(name, data)

    return [saved("scan.zip", write, method) for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)]


def meshes():
    import trimesh
    from layer_cases import save_mesh
    from trimesh.exchange.ply import export_ply

    mesh = trimesh.creation.box((20.0, 30.0, 40.0))
    return [
        *(saved(name, save_mesh, mesh, "LPS") for name in ("m.stl", "m.ply", "m.obj")),
        one_file("m.ply", export_ply(mesh, encoding="ascii")),
    ]


# ---- files of needlefit


def recordings():
    from test_viewer_recording import recorded

    return [saved("log.csv", recorded)]


def results():
    from reporting_results import stereo, study

    from needlefit.studies.run import store_run

    runs = (study(1), stereo())
    return [written(lambda folder, of=of: store_run(of, folder), ".", ("results.json.gz",)) for of in runs]


def posteriors():
    from reporting_results import sampled

    from needlefit.inference.sampling.posterior import save

    (posterior,) = sampled(0.08, 0.09).posteriors.values()
    return [written(lambda folder: save(posterior, folder / "posterior.nc"), "posterior.nc")]


WORK = {"study": "fuzzed", "seed": 1}


def checkpoints():
    """The checkpoint of a run: a fit that has ended, and rows."""
    from needlefit.inference.fit import Fit, Start
    from needlefit.project.checkpoint import open_checkpoint

    def write(folder):
        kept = open_checkpoint(folder / "run.partial", False, WORK)
        for n in range(3):
            start = Start(n, (0.1, 0.2), (0.11, 0.21), 3.5, 40, 0, "tolerance")
            kept.keep("fit", Fit(start.theta, {"b": 0.1}, 3.5, (start,), 40, 0, False))
            kept.keep_row("rows", {"insertion": f"a-{n}", "te_mm": 0.1 + n})

    return [written(write, "run.partial")]


def run_files():
    paths = sorted((PROJECT / "reports" / "reference").glob("s*/run.json"))
    return [Seed({"run.json": path.read_bytes()}, ".", ("run.json",)) for path in paths]


# ---- texts


def scans():
    folder = PROJECT / "data" / "sample_scan"
    files = {
        str(path.relative_to(folder)): path.read_bytes() if path.suffix in (".csv", ".stl") else b""
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    return [Seed(files, "scans.csv", ("scans.csv",))]
