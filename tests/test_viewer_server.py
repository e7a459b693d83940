"""The server of the interactive simulation, as windows and strangers meet it."""

import asyncio
import json
import logging
import socket
import struct
from dataclasses import dataclass
from pathlib import Path

import aiohttp
import pytest
from server_cases import served

from needlefit.mechanics.scene import Scene
from needlefit.planning.recording import read_recording, replay
from needlefit.planning.steered_needle import Change, SteeredNeedle
from needlefit.viewer import server as server_module
from needlefit.viewer.messages import read_message as read_message
from needlefit.viewer.opening import open_target
from needlefit.viewer.server import KERNEL_FILES, AccessControl
from needlefit.viewer.steering_page import SteeringPage
from needlefit.viewer.trials import TrialRegistry

#: id of a message that is refused after all those before it were answered
BARRIER = 1_000_000


class Page:
    """A window as the server sees it: it simulates its needle, sends its steps, and hears answers."""

    def __init__(self, socket) -> None:
        self.socket, self.id = socket, 0
        self.scene, self.steering, self.steps, self.refused = None, None, [], None

    async def read(self) -> dict:
        """Take the next message."""
        answer = json.loads((await self.socket.receive(timeout=20)).data)
        if answer["kind"] == "scene":
            self.begin(answer)
        elif answer["kind"] in ("refused", "ended") and answer.get("answers") != BARRIER:
            self.refused = answer["what"]
        elif answer["kind"] == "steps":
            self.follow(answer)
        return answer

    def begin(self, scene: dict) -> None:
        """Begin with a needle of the program, at first contact, and carry out its steps."""
        self.scene, self.steps = scene, []
        record = open_target(scene["target"]).record
        self.steering = SteeredNeedle(Scene.from_record(record), scene["first_cell_mm"])
        self.follow(scene)

    def follow(self, given: dict) -> None:
        for number, _, _, changes, tip in given["past"]:
            self.steering.keep()
            self.steering.apply([Change(*change) for change in changes])
            assert (number, tip) == (self.steering.number, self.steering.now.shape.tip_lateral)
            self.steps.append(changes)

    async def send(self, do: str, **arguments) -> None:
        self.id += 1
        await self.socket.send_str(json.dumps({"do": do, "id": self.id, **arguments}))

    async def say(self, do: str, **arguments) -> None:
        """Send a message; return once all before it has been answered."""
        self.refused = None
        await self.send(do, **arguments)
        await self.socket.send_str(json.dumps({"do": "nothing", "id": BARRIER}))
        while (await self.read()).get("answers") != BARRIER:
            pass

    async def act(self, *changes, gesture=None, time: float = 0.0) -> None:
        """Carry out a step, and send it."""
        self.steering.keep()
        state = self.steering.apply([Change(*change) for change in changes])
        self.steps.append(list(changes))
        row = [self.steering.number, time, gesture, changes, state.shape.tip_lateral]
        await self.say("steps", steps=[row])

    async def insert(self, depth: float) -> None:
        await self.act(("depth_mm", None, depth))

    @property
    def depth(self) -> float:
        return self.steering.now.step.depth


@dataclass
class RunningServer:
    access: AccessControl
    client: aiohttp.ClientSession
    trials: TrialRegistry
    folder: Path
    patch: pytest.MonkeyPatch

    @property
    def base(self) -> str:
        return f"http://127.0.0.1:{self.access.port}"

    def post(self, length: int) -> bytes:
        """The headers of a request of the page with so many bytes."""
        head = f"POST /law HTTP/1.1\r\nHost: 127.0.0.1:{self.access.port}\r\nOrigin: {self.base}\r\n"
        head += f"Authorization: Bearer {self.access.token}\r\nContent-Length: {length}\r\n\r\n"
        return head.encode()

    async def connect(self, **headers):
        return await self.client.ws_connect(f"{self.base}/ws", headers={"Origin": self.base} | headers)

    async def page(self, needle: str | None = None) -> Page:
        page = Page(await self.connect())
        await page.say("hello", token=self.access.token, needle=needle)
        return page


def visit(test, name: str = "study2"):
    """Run an asynchronous test with a server of its own and a page on it."""

    async def attend(folder, patch) -> None:
        shown = open_target(name)
        trials = TrialRegistry(shown, folder, lambda insertion: open_target(shown.name, insertion))
        async with served(SteeringPage(trials)) as (access, client):
            server = RunningServer(access, client, trials, folder, patch)
            await test(server, await server.page())

    def run(tmp_path, monkeypatch) -> None:
        asyncio.run(asyncio.wait_for(attend(tmp_path / "view", monkeypatch), 90))

    run.__name__, run.__doc__ = test.__name__, test.__doc__
    return run


@visit
async def test_what_is_recorded_is_there_at_every_moment_and_replays(server, page) -> None:
    path = server.folder / page.scene["recording"]
    assert not path.exists() and page.depth == 0 and page.scene["target"] == "study2"
    for n in range(1, 6):
        await page.act(("depth_mm", None, 3.3 * n), ("base_slope", None, 0.001 * n), gesture=n, time=0.1 * n)
        steps = list(replay(read_recording(path)))
        assert len(steps) == n + 1 and steps[-1].recorded.time == pytest.approx(0.1 * n)
        assert steps[-1].state.shape.tip_lateral == page.steering.now.shape.tip_lateral
    source = read_recording(path)
    trials = TrialRegistry(open_target("study2"), server.folder, open_target, source)
    copy = trials.open("")  # as of `view --recording`
    assert copy.steering.now.step.depth == page.depth and copy.recorder.path != path
    assert copy.steering.now.shape.tip_lateral == page.steering.now.shape.tip_lateral


@visit
async def test_steps_that_do_not_follow_end_the_connection(server, page) -> None:
    await page.insert(10.0)
    await page.send("steps", steps=[[3, 0.0, None, [["depth_mm", None, 20.0]], 0.0]])
    assert (await page.socket.receive()).type is aiohttp.WSMsgType.CLOSE
    back = await server.page(page.scene["needle"])
    assert back.depth == 10


@visit
async def test_a_needle_has_one_window_the_newest(server, page) -> None:
    await page.insert(10.0)
    two = await server.page(page.scene["needle"])
    assert two.depth == 10
    assert json.loads((await page.socket.receive()).data) == {"kind": "taken"}
    assert (await page.socket.receive()).type is aiohttp.WSMsgType.CLOSE
    await two.insert(11.0)
    assert server.trials.known(two.scene["needle"]).steering.now.step.depth == 11


MALFORMED = {
    "version": "GET / HTTP/9.9\r\n\r\n",
    "header": "GET / HTTP/1.1\r\nHost : x\r\n\r\n",
    "length": "GET / HTTP/1.1\r\nHost: {host}\r\nContent-Length: -3\r\n\r\n",
    "chunk": "POST /law HTTP/1.1\r\nHost: {host}\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n\r\n",
    "encoding": "POST /law HTTP/1.1\r\nHost: {host}\r\nContent-Encoding: gzip\r\nContent-Length: 1\r\n\r\na",
    "path": "GET /page/" + 7000 * "a" + " HTTP/1.1\r\nHost: {host}\r\n\r\n",
}


@visit
async def test_malformed_http_is_answered_and_logs_nothing(server, page) -> None:
    handler, records = logging.Handler(), []
    handler.emit = records.append
    logging.getLogger("aiohttp.server").addHandler(handler)
    for name, text in MALFORMED.items():
        host = f"127.0.0.1:{server.access.port}"
        reader, writer = await asyncio.open_connection("127.0.0.1", server.access.port)
        writer.write(text.replace("{host}", host).encode())
        status = int((await reader.readline()).split()[1])
        assert 400 <= status < 500, name
        writer.close()
    await asyncio.sleep(0.3)
    logging.getLogger("aiohttp.server").removeHandler(handler)
    assert records == []


@visit
async def test_requests_that_are_not_sent_to_their_end_time_out(server, page) -> None:
    """Half a body; a connection that has sent a whole request is kept."""
    server.patch.setattr(server_module, "REQUEST_TIMEOUT_S", 0.3)
    reader, writer = await asyncio.open_connection("127.0.0.1", server.access.port)
    writer.write(server.post(100) + b"{")
    assert (await reader.readline()).split()[1] == b"408"
    assert await asyncio.wait_for(reader.read(), 5)  # to its end: the connection is closed
    writer.close()
    await asyncio.sleep(0.6)
    await page.insert(1.0)
    assert not page.refused


@visit
async def test_a_request_that_is_cut_logs_nothing(server, page) -> None:
    handler, records = logging.Handler(), []
    handler.emit = records.append
    logging.getLogger("aiohttp.server").addHandler(handler)
    for content, reset in ((b"", False), (b"{", False), (b"{", True)):
        _, writer = await asyncio.open_connection("127.0.0.1", server.access.port)
        writer.write(server.post(100) + content)
        await asyncio.sleep(0.1)
        if reset:
            linger = struct.pack("ii", 1, 0)
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        writer.close()
    await asyncio.sleep(0.3)
    logging.getLogger("aiohttp.server").removeHandler(handler)
    assert records == []
    await page.insert(1.0)
    assert not page.refused


@pytest.mark.parametrize(
    "text",
    [
        "needle",
        '{"do": [], "id": 9}',
        '{"do": "dance", "id": 9}',
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, [["base_y_mm", null, NaN]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, [["base_y_mm", null, "1"]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, [["base_y_mm", 1, 1]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, [["mu_pa", null, 1]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, '
        + str([["base_y_mm", 0, 1]] * 65).replace("'", '"')
        + ", 0.0]]}",
        "[" * 15_000,
        '{"do": "steps", "id": 9, "steps": [[1, 0.0, 1, [["alpha", 1, 1e16]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": ' + str(17 * [[1, 0, 1, [["base_y_mm", 1, 1]], 0]]) + "}",
        '{"do": "steps", "id": 9, "steps": [[1, -1.0, 1, [["depth_mm", null, 1]], 0.0]]}',
        '{"do": "steps", "id": 9, "steps": [[true, 0.0, 1, [["depth_mm", null, 1]], 0.0]]}',
    ],
)
def test_a_faulty_message_is_refused(text: str) -> None:
    assert read_message(text).fault


@visit
async def test_what_is_refused_changes_nothing(server, page) -> None:
    await page.insert(30.0)
    for do, arguments in (
        ("steps", {"steps": [[2, 0.0, None, [["base_y_mm", None, float("inf")]], 0.0]]}),
        ("steps", {"steps": [[2, 0.0, None, [["mu_pa", 1, -3]], 0.0]]}),
        ("show", {"insertion": "../../etc"}),
        ("no such thing", {}),
    ):
        await page.say(do, **arguments)
        assert page.refused, (do, arguments)
        assert len(server.trials.known(page.scene["needle"]).steps) == 1


@visit
async def test_strangers_are_kept_out(server, page) -> None:
    """Another page in the same browser, a name bent to this machine, a wrong token."""
    for headers in ({"Origin": "http://evil.example"}, {"Origin": ""}, {"Host": "evil.example"}):
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await server.connect(**headers)
    async with server.client.get(server.base, headers={"Host": "evil.example"}) as answer:
        assert answer.status == 421
    for token in ("", "wrong", None, 7, "\ud800", "tök", server.access.token[:-1]):
        socket = await server.connect()
        await socket.send_json({"do": "hello", "id": 0, "token": token})
        assert (await socket.receive()).data == 4401
    right = {"Authorization": f"Bearer {server.access.token}"}
    wrong = {"Authorization": "Bearer wrong", "Origin": server.base}
    foreign = {"Authorization": "Bearer tök"}
    for headers in ({}, wrong, foreign, right, right | {"Origin": "http://evil.example"}):
        async with server.client.post(f"{server.base}/export/inputs.csv", headers=headers) as answer:
            assert answer.status == 403 and "Content-Security-Policy" in answer.headers
    for path in ("/page/../server.py", "/page/%2e%2e/server.py", "/page/"):
        async with server.client.get(server.base + path) as answer:
            assert answer.status in (403, 404, 405)
    async with server.client.get(server.base) as answer:
        assert server.access.token not in await answer.text()
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]


@visit
async def test_inputs_can_be_taken_away_as_they_were_recorded(server, page) -> None:
    await page.insert(10.0)
    headers = {"Authorization": f"Bearer {server.access.token}", "Origin": server.base}
    url, needle = f"{server.base}/export", {"needle": page.scene["needle"]}
    async with server.client.post(f"{url}/inputs.csv", headers=headers, json=needle) as answer:
        assert await answer.read() == (server.folder / page.scene["recording"]).read_bytes()
    async with server.client.post(f"{url}/shape.exe", headers=headers, json=needle) as answer:
        assert answer.status == 404
    deep, half = b"[" * 15_000, b'{"needle": "\\ud800"}'
    for body in (b'{"needle": "x"}', b"{}", b"[]", b"7", b"", b"\xff", deep, half):
        for kind in ("application/json", "text/plain; charset=nonsense"):
            sent = headers | {"Content-Type": kind}
            async with server.client.post(f"{url}/inputs.csv", headers=sent, data=body) as answer:
                assert answer.status in (400, 404)


@visit
async def test_of_the_kernel_only_its_files_are_sent(server, page) -> None:
    for name in (*KERNEL_FILES, "native.py", "..%2fsession.py"):
        async with server.client.get(f"{server.base}/mechanics/native/{name}") as answer:
            assert answer.status == (200 if name in KERNEL_FILES else 404)


@visit
async def test_a_law_that_is_a_table_is_computed_for_the_page(server, page) -> None:
    tissue = Scene.from_record(open_target("study2").record).tissue
    headers = {"Authorization": f"Bearer {server.access.token}", "Origin": server.base}
    for shape, status in ((tissue.shape.tolist(), 200), ([[1.0]], 422), ("x", 422), ([[1e300] * 9], 422)):
        content = {"needle": page.scene["needle"], "shape": shape}
        async with server.client.post(f"{server.base}/law", headers=headers, json=content) as answer:
            assert answer.status == status
            if status == 200:
                assert await answer.json() == page.scene["simulation"]["model"]["law"]


@visit
async def test_a_recording_that_cannot_be_written_ends_with_a_message(server, page) -> None:
    await page.insert(10.0)
    path = server.folder / page.scene["recording"]
    kept = path.read_bytes()
    path.unlink()
    path.mkdir()
    await page.insert(11.0)
    assert "cannot be written" in page.refused
    path.rmdir()
    path.write_bytes(kept)
    await page.insert(12.0)
    assert "has ended" in page.refused
    assert path.read_bytes() == kept
