"""`needlefit view` from the shell: what it prints, how it ends, what it refuses."""

import signal
import subprocess
import sys
import urllib.request

import pytest
from test_cli import run
from test_viewer_recording import recorded

from needlefit.viewer.opening import open_recording
from needlefit.viewer.recording import read_recording


def test_view_serves_its_page_and_ends_on_a_signal(tmp_path):
    command = [sys.executable, "-m", "needlefit", "view", "study2", "--no-browser", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = process.stdout.readline()
        page, token = address.strip().split("#token=")
        with urllib.request.urlopen(page) as answer:
            text = answer.read().decode()
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=20)
    assert page.startswith("http://127.0.0.1:") and len(token) >= 32
    assert "<title>needlefit" in text and token not in text
    assert (process.returncode, out) == (0, "")  # nothing was steered, so nothing recorded
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (("no_such_thing",), 3, "no_such_thing"),
        (("twin/phantom2-99",), 3, "phantom2-09"),
        (("study2", "--recording", "log.csv"), 2, "leave it out"),
        (("--recording", "log.csv"), 3, "no such file"),
        (("study2", "--port", "70000"), 2, "--port"),
    ],
)
def test_invalid_input_is_refused_before_anything_is_served(words, code, expected, capsys, tmp_path):
    assert run("view", *words, "--no-browser", "--out", str(tmp_path)) == code
    assert expected in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_port_in_use_is_reported(capsys):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert run("view", "study2", "--no-browser", "--port", str(port)) == 3
    assert f"port {port} cannot be used" in capsys.readouterr().err


def test_a_missing_extra_is_named_with_its_install_command(capsys, monkeypatch):
    import needlefit.viewer.server

    # the import that fails makes a new package of this name; later tests need the attribute as it was
    monkeypatch.setattr(needlefit.viewer, "server", needlefit.viewer.server)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "needlefit.viewer.server")
    assert run("view", "study2", "--no-browser") == 3
    assert "'needlefit[view]'" in capsys.readouterr().err


def test_a_recording_opens_with_the_files_beside_it(tmp_path):
    path = tmp_path / "log.csv"
    recorded(path)
    shown = open_recording(read_recording(path))
    assert (shown.name, shown.first_cell) == ("study2", 1.0)
    path.write_text(path.read_text().replace('target = "study2"', 'target = "twin/phantom2-05"'))
    changed = open_recording(read_recording(path))
    assert changed.measured is None and "has changed since" in changed.note
    path.write_text(path.read_text().replace('target = "twin/phantom2-05"', 'target = "gone"'))
    assert "is not found" in open_recording(read_recording(path)).note
