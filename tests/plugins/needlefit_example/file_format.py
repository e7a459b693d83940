"""Points as plain numbers: three a line, between spaces."""

import numpy as np

from needlefit.datasets.formats import FileFormat
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.project.input_files import read_text


def read_curves(path):
    """Return the one curve of a file, by the file's name."""
    try:
        values = np.array([[float(cell) for cell in line.split()] for line in read_text(path).splitlines()])
    except ValueError:
        values = np.empty(0)
    if values.ndim != 2 or values.shape[1] != 3:
        raise DataError("holds no points", where=str(path), expected="three numbers a line", fix="correct it")
    return {path.stem: Points(path, values, np.arange(len(values)) + 1)}, ()


XYZ = FileFormat("xyz", (".xyz",), read_curves)
