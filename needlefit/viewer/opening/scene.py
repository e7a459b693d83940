"""A scene as what is shown."""

from needlefit.mechanics.scene import Scene
from needlefit.project.load import load
from needlefit.project.places import label
from needlefit.project.records.scene import SceneRecord
from needlefit.project.subjects import Named
from needlefit.viewer.subject import Subject


def open_scene(named: Named) -> Subject:
    """Return the needle of a scene.

    Raises
    ------
    ConfigError
        If its file has a fault.
    """
    record = load(named.path, SceneRecord)
    scene = Scene.from_record(record, label(named.path))
    title = record.title or named.path.stem
    return Subject(named.name, title, record.note, record, scene.lattice.first_cell)
