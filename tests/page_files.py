"""HTML files that compute needles, in tests: their data, and a browser without a network that shows them."""

import base64
import json
import re
import subprocess
import zlib
from contextlib import contextmanager
from pathlib import Path

import needlefit
from needlefit.mechanics import native
from needlefit.reporting.needle_page import compress

PAGE = Path(needlefit.__file__).parent / "viewer" / "page"
#: states that a page has computed again, and the largest distance from what is stored, mm
ALL_STATES = "[Number(proof.dataset.count), Number(proof.dataset.largest)]"
PATIENCE_MS, PAUSE_MS = 60_000, 100


def read_page_data(text):
    """Return the data in the text of a file, each shared list in its places."""
    (packed,) = re.findall(r'id="data">([^<]*)</script>', text)
    data = json.loads(zlib.decompress(base64.b64decode(packed), -15))
    lists = data.pop("lists")

    def resolve(value):
        if isinstance(value, dict):
            return lists[value["$"]] if "$" in value else {key: resolve(one) for key, one in value.items()}
        return [resolve(one) for one in value] if isinstance(value, list) else value

    return dict(resolve(data))


def change_page_data(text, change):
    """Return the text of a file after a change of its data."""
    (packed,) = re.findall(r'id="data">([^<]*)</script>', text)
    data = json.loads(zlib.decompress(base64.b64decode(packed), -15))
    change(data)
    return text.replace(packed, compress(json.dumps(data).encode()))


def run_node(program, job):
    """Return what a program, which finds the kernel and the modules of the page, prints of a job in JSON."""
    for name, value in {
        "KERNEL": (native.FOLDER / "needle.js").as_uri(),
        "PAGE": PAGE.as_uri() + "/",
        "WASM": str(native.FOLDER / "kernel.wasm"),
    }.items():
        program = program.replace(name, repr(value))
    command = ["node", "--no-wasm-tier-up", "--input-type=module", "-e", program]
    text = json.dumps(job, allow_nan=False)
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def require_accessible(page):
    """Fail with what axe finds wrong on a page."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


@contextmanager
def open_offline(chromium, path, address="", **settings):
    """Yield a page without a network that has computed all it holds; a fault or a request fails the test."""
    begun = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce", "offline": True}
    context = chromium.new_context(**(begun | settings))
    page, faults, asked = context.new_page(), [], []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: message.type == "error" and faults.append(message.text))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{path.as_uri()}#{address}" if address else path.as_uri())
    for _ in range(PATIENCE_MS // PAUSE_MS):  # the policy forbids what playwright itself would wait with
        if page.evaluate("document.getElementById('proof').dataset.count !== undefined") or faults:
            break
        page.wait_for_timeout(PAUSE_MS)
    yield page
    context.close()
    assert faults == []
    assert {url.split("#")[0] for url in asked if not url.startswith("blob:")} == {path.as_uri()}
