"""The lines of keys in TOML files, and errors that name them."""

import pytest

from needlefit.errors import ConfigError
from needlefit.project.toml import add_file_context, add_key_context, find_line, load
from needlefit.schemas.study import FitRecord

TEXT = '''\
# a comment with point_sd_mm = 1
schema = 1
title = """
[noise]
point_sd_mm = 2
"""

[noise]
note = "point_sd_mm"
point_sd_mm = 0.0

[media."gel.1"]
surfaces = [
    { file = "a.stl", into = 2 },
]
[[validate]]
layers = [1]
[[validate]]
layers = [2]
'''


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("schema", 2),
        ("title", 3),
        ("noise", 8),
        ("noise.point_sd_mm", 10),
        ("noise.missing", 8),
        ("media.gel.1.surfaces", 13),
        ("media.gel.1.surfaces.1.into", 13),
        ("validate.1.layers", 17),
        ("validate.2.layers", 19),
        ("validate.2", 18),
        ("validate.3.layers", 16),
        ("nothing", None),
    ],
)
def test_the_line_of_a_key(key, line):
    assert find_line(TEXT, key) == line


@pytest.mark.parametrize("text", ["", "= 1", "a = [" * 3000])
def test_a_text_without_the_key_has_no_line(text):
    assert find_line(text, "a.b") is None


def test_errors_name_the_file_and_line_once(tmp_path):
    file, other = tmp_path / "fit.toml", tmp_path / "other.toml"
    file.write_text('schema = 1\ndataset = "twin"\nmedium = 3\n')
    other.write_text("dataset = 1\n")
    with pytest.raises(ConfigError) as fault:
        load(file, FitRecord)
    assert fault.value.where == f"{file}:3"
    with (
        pytest.raises(ConfigError) as fault,
        add_file_context(other),
        add_file_context(file),
        add_key_context("dataset"),
    ):
        raise ConfigError("is wrong")
    assert fault.value.where == f"{file}:2"
    with pytest.raises(ConfigError) as fault, add_file_context(file), add_key_context("dataset"):
        raise ConfigError("is wrong", where="elsewhere")
    assert fault.value.where == "elsewhere"
