"""The server of the interactive simulation, as windows and strangers meet it."""

import asyncio
import json
import math
import threading
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import aiohttp
import pytest
from server_cases import served

from needlefit.errors import ModelError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import simulate_steps
from needlefit.planning.goals import Goal
from needlefit.planning.steering import PlanLimits, plan_steering
from needlefit.schemas.planning import ObstacleRecord
from needlefit.viewer import server as server_module
from needlefit.viewer.messages import read_message as read_message
from needlefit.viewer.opening import open_target
from needlefit.viewer.plans import begin_insertion
from needlefit.viewer.recording import read_recording, replay
from needlefit.viewer.server import (
    MAX_BURST_MESSAGES,
    MAX_MESSAGE_BYTES,
    MAX_WINDOWS,
    AccessControl,
    RateLimit,
    SteeringPage,
)
from needlefit.viewer.steering import Change
from needlefit.viewer.trials import MAX_TRIALS, TrialRegistry


class Page:
    """A window as the server sees it: messages out, answers in."""

    def __init__(self, socket) -> None:
        self.socket, self.id, self.scene, self.kept = socket, 0, None, {}

    async def hear(self, kind: str) -> dict:
        """Return the next message of a kind, also one that came before an answer."""
        while kind not in self.kept:
            answer = json.loads((await self.socket.receive(timeout=20)).data)
            self.kept[answer["kind"]] = answer
        return self.kept.pop(kind)

    async def say(self, do: str, **arguments) -> dict:
        """Return the state that answers a message; whatever comes before it is kept."""
        self.id += 1
        await self.socket.send_str(json.dumps({"do": do, "id": self.id, **arguments}))
        self.refused = None
        while True:
            answer = json.loads((await self.socket.receive(timeout=10)).data)
            if answer["kind"] == "scene":
                self.scene = answer
            elif answer["kind"] == "refused":
                self.refused = answer["what"]
            elif answer["kind"] == "state" and answer["answers"] == self.id:
                return answer
            else:
                self.kept[answer["kind"]] = answer


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

    async def connect(self, **headers):
        return await self.client.ws_connect(f"{self.base}/ws", headers={"Origin": self.base} | headers)

    async def page(self, needle: str | None = None) -> Page:
        page = Page(await self.connect())
        page.first = await page.say("hello", token=self.access.token, needle=needle)
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
async def test_the_base_stops_before_the_first_guide(server, page) -> None:
    await page.say("change", set=[["guide_x_mm", 1, -100.0], ["guide_y_mm", 1, 0.0]])
    stopped = await page.say("change", insert_mm=500)
    assert stopped["depth_mm"] == pytest.approx(150 - 100 - 5) and stopped["base"]["x"] == pytest.approx(-105)
    before = await page.say("change", set=[["guide_x_mm", 1, -103.0]])
    assert page.refused and before["guides"][0]["x"] == -100


@visit
async def test_a_needle_that_leaves_the_validity_stays_as_it_was(server, page) -> None:
    """Two guides hold it; a base moved aside just before them would bend it beyond small slopes."""
    guides = [
        ["guide_x_mm", 1, -40.0],
        ["guide_y_mm", 1, 0.0],
        ["guide_x_mm", 2, -30.0],
        ["guide_y_mm", 2, 0.0],
    ]
    before = await page.say("change", insert_mm=100, set=[["bevel_offset_mm", None, 0.0], *guides])
    after = await page.say("change", set=[["base_y_mm", None, 5.0]])
    assert "slope" in page.refused and "limit 0.3" in page.refused
    assert after["step"] == before["step"] and after["y"] == before["y"]
    again = await page.say("change", set=[["base_y_mm", None, 0.1]])
    assert again["step"] == before["step"] + 1 and again["faults"] == []


@visit
async def test_a_window_steers_its_needle(server, page) -> None:
    assert page.first["depth_mm"] == 0 and page.scene["target"] == "study2"
    state = await page.say("change", insert_mm=30, set=[["base_y_mm", None, 0.5]])
    assert (state["depth_mm"], state["base"]["y"], state["step"]) == (30, 0.5, 1)
    assert len(state["x"]) == len(state["y"]) > 50
    state = await page.say("change", set=[["bevel_side", None, -1]], insert_mm=30)
    assert state["bevel"]["side"] == -1 and state["depth_mm"] == 60
    assert (await page.say("undo"))["depth_mm"] == 30
    assert (await page.say("redo"))["depth_mm"] == 60
    assert (await page.say("reset"))["depth_mm"] == 0
    assert (await page.say("undo"))["depth_mm"] == 60
    assert (await page.say("undo"))["redo"]
    assert not (await page.say("change", insert_mm=1))["redo"]  # another way was taken


@visit
async def test_a_needle_moves_only_while_its_page_asks_for_frames(server, page) -> None:
    assert (await page.say("move", speed_mm_s=100, to_mm=8))["depth_mm"] == 0
    await asyncio.sleep(0.05)
    first = await page.say("frame")
    assert 3 < first["depth_mm"] <= 8 and first["step"] == 1
    await asyncio.sleep(0.05)
    last = await page.say("frame")
    assert last["depth_mm"] == 8 and last["moving"] == 0
    assert (await page.say("frame"))["step"] == last["step"]
    await page.say("move", speed_mm_s=-100)
    await asyncio.sleep(0.03)
    halted = await page.say("halt")  # no frame was asked for since
    assert (halted["moving"], halted["depth_mm"]) == (0, 8)
    assert (await page.say("undo"))["depth_mm"] == 0  # the whole stroke is one gesture
    await page.say("move", speed_mm_s=100)
    await asyncio.sleep(0.3)
    assert (await page.say("frame"))["depth_mm"] == pytest.approx(10)  # it does not leap after a pause


@visit
async def test_inputs_change_while_the_needle_goes_in(server, page) -> None:
    """b, the bevel's side and the base change during a stroke, which goes on, and is undone with them."""
    await page.say("move", speed_mm_s=50, to_mm=20)
    moved = [["bevel_offset_mm", None, 0.02], ["bevel_side", None, -1], ["base_y_mm", None, 0.3]]
    for change in moved:
        await asyncio.sleep(0.02)
        assert (await page.say("frame"))["moving"] == 50
        assert (await page.say("change", set=[change], gesture=77))["moving"] == 50
    while (state := await page.say("frame"))["moving"]:
        await asyncio.sleep(0.01)
    assert state["depth_mm"] == 20 and state["bevel"] == {"side": -1, "offset_mm": 0.02}
    assert (await page.say("undo"))["step"] == state["step"] + 1
    assert (await page.say("frame"))["depth_mm"] == 0
    await page.say("move", speed_mm_s=50)
    assert (await page.say("change", insert_mm=1))["moving"] == 0  # the hand takes over


@visit
async def test_what_is_recorded_is_there_at_every_moment_and_replays(server, page) -> None:
    path = server.folder / page.scene["recording"]
    assert not path.exists()
    for n in range(1, 6):
        state = await page.say("change", insert_mm=3.3, set=[["base_slope", None, 0.001 * n]])
        steps = list(replay(read_recording(path)))
        assert len(steps) == n + 1
        assert steps[-1].state.shape.tip_lateral == state["tip"]["lateral_mm"]
    again = await page.say("replay", times=1000)
    assert again["playing"] and page.scene["recording"] != path.name
    await asyncio.sleep(0.02)
    done = await page.say("frame")
    assert done["tip"] == state["tip"] and not done["playing"]


@pytest.mark.sweep
@visit
async def test_a_replay_keeps_time_can_be_halted_and_goes_on(server, page) -> None:
    await page.say("change", insert_mm=5)
    await asyncio.sleep(0.45)
    await page.say("undo")
    await asyncio.sleep(0.45)
    last = await page.say("change", insert_mm=7)
    assert (await page.say("replay", times=0.01))["playing"]
    await asyncio.sleep(0.05)
    assert (await page.say("frame"))["step"] == 1
    halted = await page.say("halt")
    assert halted["paused"] and not halted["playing"]
    await asyncio.sleep(0.05)
    assert (await page.say("frame"))["step"] == 1
    recording = page.scene["recording"]
    assert (await page.say("replay", times=1000))["playing"]
    await asyncio.sleep(0.02)
    done = await page.say("frame")
    assert (done["tip"], done["step"], page.scene["recording"]) == (last["tip"], 3, recording)
    assert (await page.say("undo"))["depth_mm"] == 0  # as recorded: the pauses part gestures
    assert (await page.say("undo"))["depth_mm"] == 5


@visit
async def test_a_replay_that_was_left_can_be_begun_anew_whole(server, page) -> None:
    for _ in range(3):
        last = await page.say("change", insert_mm=5)
        await asyncio.sleep(0.02)
    await page.say("replay", times=0.01)
    await asyncio.sleep(0.01)
    assert (await page.say("frame"))["step"] == 1
    await page.say("frame")
    await page.socket.close()
    back = await server.page(page.scene["needle"])
    await back.say("replay", times=1000)
    await asyncio.sleep(0.02)
    assert (await back.say("frame"))["tip"] == last["tip"]


@visit
async def test_two_windows_have_two_needles_and_a_page_that_comes_back_finds_its_own(server, page) -> None:
    one, two = page, await server.page()
    await one.say("change", insert_mm=10)
    assert (await two.say("change", insert_mm=20))["depth_mm"] == 20
    assert (await one.say("frame"))["depth_mm"] == 10
    await one.socket.close()
    back = await server.page(one.scene["needle"])
    assert back.first["depth_mm"] == 10 and back.scene["recording"] == one.scene["recording"]
    assert back.first["undo"]


@visit
async def test_a_needle_has_one_window_the_newest(server, page) -> None:
    await page.say("change", insert_mm=10)
    two = await server.page(page.scene["needle"])
    assert two.first["depth_mm"] == 10
    assert json.loads((await page.socket.receive()).data) == {"kind": "taken"}
    assert (await page.socket.receive()).type is aiohttp.WSMsgType.CLOSE
    assert (await two.say("change", insert_mm=1))["depth_mm"] == 11


@pytest.mark.sweep
@partial(visit, name="twin/phantom1-02")
async def test_a_needle_taken_while_its_window_looks_for_another_has_one_window(server, page) -> None:
    """A asks for another insertion, which takes a while; B takes A's needle, and then C takes it from B."""
    read_on = threading.Event()
    reopen = server.trials._reopen
    server.trials._reopen = lambda insertion: read_on.wait(10) and reopen(insertion)
    await page.say("change", insert_mm=10)
    await page.socket.send_str('{"do": "show", "id": 99, "insertion": "phantom1-05"}')
    await asyncio.sleep(0.05)
    two = await server.page(page.scene["needle"])
    read_on.set()
    await asyncio.sleep(0.3)
    three = await server.page(page.scene["needle"])
    assert json.loads((await two.socket.receive(timeout=5)).data) == {"kind": "taken"}
    assert (await three.say("change", insert_mm=1))["depth_mm"] == 11


@visit
async def test_so_many_windows_and_no_more_but_each_finds_its_needle(server, page) -> None:
    pages = [page, *[await server.page() for _ in range(MAX_WINDOWS - 1)]]
    socket = await server.connect()
    await socket.send_json({"do": "hello", "id": 0, "token": server.access.token})
    assert (await socket.receive()).data == 1013
    assert (await server.page(pages[3].scene["needle"])).first["depth_mm"] == 0


@pytest.mark.sweep
def test_only_idle_needles_are_dropped(tmp_path) -> None:
    viewed_scene = open_target("study2")
    trials = TrialRegistry(viewed_scene, tmp_path, lambda insertion: viewed_scene)
    steered, left = trials.open(""), trials.open("")
    trials.close(left)
    for _ in range(MAX_TRIALS):
        trials.close(trials.open(""))
    assert trials.known(steered.name) is steered and trials.known(left.name) is None


@pytest.mark.parametrize(
    "text",
    [
        "needle",
        '{"do": [], "id": 9}',
        '{"do": {}, "id": 9}',
        "[1]",
        '{"do": "dance", "id": 9}',
        '{"do": "change"}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, NaN]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, Infinity]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, 1e999]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, "1"]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, true]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", 1, 1]]}',
        '{"do": "change", "id": 9, "set": [["mu_pa", null, 1]]}',
        '{"do": "change", "id": 9, "set": [["guide_x_mm", 33, 1]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null]]}',
        '{"do": "change", "id": 9, "set": 7}',
        '{"do": "change", "id": 9, "set": ' + str([["base_y_mm", 0, 1]] * 65).replace("'", '"') + "}",
        "[" * 5000,
        "[" * 15_000,
        '{"do": "markups", "id": 9, "name": "a.fcsv", "text": "\\ud800"}',
        '{"do": "change", "id": 9, "set": [["tip_held", null, 1], ["tip_y_mm", null, -1e308]]}',
        '{"do": "change", "id": 9, "set": [["alpha", 1, 1e16]]}',
        '{"do": "change", "id": 9, "set": [["base_y_mm", null, ' + "9" * 400 + "]]}",
    ],
)
def test_a_faulty_message_is_refused(text: str) -> None:
    assert read_message(text).fault


@visit
async def test_what_is_refused_changes_nothing(server, page) -> None:
    before = await page.say("change", insert_mm=30)
    for do, arguments in (
        ("change", {"set": [["base_y_mm", None, float("inf")]]}),
        ("change", {"insert_mm": float("nan")}),
        ("change", {"set": [["return_to", None, 0]]}),
        ("change", {"set": [["mu_pa", 1, -3]]}),
        ("change", {"set": [["guide_x_mm", 1, -140], ["guide_y_mm", 1, 0]]}),
        ("move", {"speed_mm_s": "fast"}),
        ("move", {"speed_mm_s": 1e9}),
        ("show", {"insertion": "../../etc"}),
        ("no such thing", {}),
    ):
        state = await page.say(do, **arguments)
        assert page.refused, (do, arguments)
        assert state | {"answers": 0, "time_s": 0} == before | {"answers": 0, "time_s": 0}


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
            assert answer.status in (403, 404)
    async with server.client.get(server.base) as answer:
        assert server.access.token not in await answer.text()
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]


@pytest.mark.sweep
@visit
async def test_too_large_and_too_fast_is_cut_off_and_the_needle_is_not_lost(server, page) -> None:
    server.patch.setattr(
        "needlefit.viewer.server.MAX_MESSAGES_PER_S", 0.0
    )  # however slowly this machine sends
    await page.say("change", insert_mm=10)
    await page.socket.send_str("x" * (MAX_MESSAGE_BYTES + 1))
    assert (await page.socket.receive()).data == 1009
    back = await server.page(page.scene["needle"])
    assert back.first["depth_mm"] == 10
    with pytest.raises(ConnectionError):
        for _ in range(int(MAX_BURST_MESSAGES) + 1):
            await back.socket.send_str('{"do": "frame", "id": 1}')
        while (await back.socket.receive(timeout=10)).type is aiohttp.WSMsgType.TEXT:
            pass
        raise ConnectionError
    assert back.socket.close_code in (1008, 1006)
    assert (await server.page(page.scene["needle"])).first["depth_mm"] == 10


def test_a_pause_allows_a_burst_and_no_more() -> None:
    pace = RateLimit()
    assert (
        MAX_BURST_MESSAGES
        <= sum(pace.allows() for _ in range(int(2 * MAX_BURST_MESSAGES)))
        < 1.2 * MAX_BURST_MESSAGES
    )


@visit
async def test_inputs_can_be_taken_away_as_they_were_recorded(server, page) -> None:
    await page.say("change", insert_mm=10)
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
                assert answer.status == 404


@visit
async def test_requests_that_are_not_sent_to_their_end_time_out(server, page) -> None:
    """Half the headers, half a body; a connection that has sent a whole request is kept."""
    server.patch.setattr(server_module, "REQUEST_TIMEOUT_S", 0.3)
    server.patch.setattr(server_module, "CHECK_INTERVAL_S", 0.1)
    place = ("127.0.0.1", server.access.port)
    reader, writer = await asyncio.open_connection(*place)
    writer.write(b"GET / HTTP/1.1\r\nHo")
    assert await reader.read() == b""
    writer.close()
    reader, writer = await asyncio.open_connection(*place)
    head = f"POST /export/shape.csv HTTP/1.1\r\nHost: 127.0.0.1:{place[1]}\r\nOrigin: {server.base}\r\n"
    head += f"Authorization: Bearer {server.access.token}\r\nContent-Length: 100\r\n\r\n"
    writer.write(head.encode() + b"{")
    assert (await reader.readline()).split()[1] == b"408"
    writer.close()
    await asyncio.sleep(0.6)
    assert (await page.say("change", insert_mm=1))["depth_mm"] == 1


@visit
async def test_a_recording_that_cannot_be_written_ends_with_a_message(server, page) -> None:
    await page.say("change", insert_mm=10)
    path = server.folder / page.scene["recording"]
    kept = path.read_bytes()
    path.unlink()
    path.mkdir()
    await page.say("change", insert_mm=1)
    assert "cannot be written" in page.refused
    path.rmdir()
    path.write_bytes(kept)
    await page.say("change", insert_mm=1)
    assert "has ended" in page.refused
    assert path.read_bytes() == kept


@partial(visit, name="twin/phantom1-02")
async def test_another_insertion_is_another_needle(server, page) -> None:
    assert page.scene["measured"]["id"] == "phantom1-02" and page.scene["synthetic"]
    state = await page.say("change", set=[["depth_mm", None, page.scene["depth_mm"]]])
    assert state["errors"]["whole"] and 0 < state["errors"]["te_mm"] < 5
    first = page.scene["needle"]
    await page.say("show", insertion="phantom1-05")
    assert page.scene["measured"]["id"] == "phantom1-05" and page.scene["needle"] != first
    back = await page.say("show", insertion="phantom1-02")
    assert page.scene["needle"] == first and back["tip"] == state["tip"] and back["undo"]


@pytest.mark.sweep
@visit
async def test_goals_plans_and_their_faults_reach_the_page(server, page) -> None:
    await page.say("change", insert_mm=5.0)
    for bad in (
        {"target": [1]},
        {"target": [1, "2"]},
        {"target": [40, 1], "radius": 0},
        {"obstacles": [[1, 2, -1]]},
        {"obstacles": [3]},
        {"obstacles": [[1, 2, 3, "bone", 4]]},
        {"obstacles": 17 * [[20, 4, 1]]},
    ):
        await page.say("aim", **bad)
        assert page.refused
    await page.say("plan")
    assert page.refused  # there is no target
    await page.say("run")
    assert page.refused  # nor a plan
    await page.say("aim", target=[35.0, 0.5], radius=0.5, obstacles=[[20, 4, 1]])
    aim = await page.hear("aim")
    assert aim["target"] == [35.0, 0.5] and aim["obstacles"] == [[20.0, 4.0, 1.0, "obstacle 1"]]
    region = await page.hear("reach")
    assert region["x"][0] > 5 and len(region["low"]) == 3
    await page.say("plan")
    plan = await page.hear("plan")
    assert plan["hits"] == plan["draws"] == 1 and plan["touched"] == {"obstacle 1": 0.0}
    assert plan["nominal_miss_mm"] < 0.5 and plan["steps"][-1][0] == pytest.approx(35, abs=1)
    assert len(plan["fan"][0][0]) == len(plan["fan"][0][1]) > 10
    state = await page.say("run", speed_mm_s=1000.0, one=True)
    assert state["playing"]
    await page.say("aim", target=[3.0, 0.5])
    await page.say("plan")
    assert (await page.hear("plan"))["fault"]["what"]  # the target is behind the tip
    page.kept.clear()
    await page.say("aim", target=None)
    assert (await page.hear("aim"))["target"] is None


@pytest.mark.sweep
@partial(visit, name="phantom2")
async def test_a_plan_shifts_the_entry_as_the_command_does_and_begins_there(server, page) -> None:
    await page.say("change", insert_mm=5.0)
    first = page.scene["needle"]
    await page.say("aim", target=[40.0, 7.0], radius=0.5, obstacles=[[20, 4, 1, "bone"]])
    for bad in (-1.0, "far", 1e6):
        await page.say("plan", entry_mm=bad)
        assert page.refused
    await page.say("plan", entry_mm=5.0)
    plan = await page.hear("plan")
    bone = ObstacleRecord(name="bone", centre_mm=(20, 4), radius_mm=1)
    goal = Goal((40.0, 7.0), 0.5, (bone,))
    same = plan_steering(begin_insertion(open_target("phantom2")), goal, PlanLimits(5.0), threads=1)
    assert plan["anew"] and plan["entry_mm"] == same.entry_mm and abs(same.entry_mm) > 1
    assert plan["steps"] == [
        [one.depth, one.bevel.side, one.controls.base_y, one.controls.base_slope] for one in same.steps
    ]
    page.kept.clear()
    state = await page.say("run", speed_mm_s=1000.0)
    assert page.scene["needle"] != first and state["playing"]
    aim = await page.hear("aim")
    assert aim["target"] == [40.0, 7.0 - same.entry_mm]
    assert aim["obstacles"] == [[20.0, 4.0 - same.entry_mm, 1.0, "bone"]]
    assert (await page.hear("plan"))["anew"] is False
    while state["playing"]:
        await asyncio.sleep(0.02)
        state = await page.say("frame")
    miss = math.hypot(state["tip"]["x"] - 40, state["tip"]["y"] - aim["target"][1])
    assert state["depth_mm"] == same.end.depth and miss == pytest.approx(same.nominal_miss, abs=1e-3)
    recording = read_recording(server.folder / page.scene["recording"])
    assert recording.head.scene.entry.y_mm == same.entry_mm


def test_a_needle_at_the_entry_of_its_plan_keeps_parameters_set_by_hand(tmp_path) -> None:
    trials = TrialRegistry(open_target("phantom2"), tmp_path, lambda insertion: open_target("phantom2"))
    trial = trials.open("")
    trial.act((Change("mu_pa", 2, 3e7), Change("offset_throughout_mm", None, 0.05)))
    trial.act((Change("depth_mm", None, 10.0),))
    with pytest.raises(ModelError):
        trials.entered(trial)  # there is no plan
    trial.aim.set((40.0, 2.0), 1.0, ())
    trial.aim.entry_mm = 3.0
    trial.aim.plan = plan_steering(trial.planned_insertion, trial.aim.goal, PlanLimits(3.0), threads=1)
    other = trials.entered(trial)
    assert other.steering.now.step.depth == 0
    assert other.steering.now.tissue.mu == pytest.approx(trial.steering.now.tissue.mu, rel=1e-14)
    assert other.aim.plan.steps[0].bevel.offset == 0.05
    assert other.aim.goal.target == (40.0, 2.0 - trial.aim.plan.entry_mm)


@pytest.mark.sweep
@partial(visit, name="twin/phantom2-05")
async def test_a_fit_sends_its_mode_and_its_draws(server, page) -> None:
    assert page.scene["fit"]["insertion"] == 1 < page.scene["fit"]["dataset"]
    for do, wrong in (
        ("fit", {}),
        ("fit", {"scope": "x"}),
        ("points", {"scope": "insertion", "offsets": [1]}),
    ):
        await page.say(do, **wrong)
        assert page.refused
    page.kept.clear()
    await page.say("points", scope="insertion", offsets=[0, 0, 0, 0, 0, 0.1])
    measured = await page.hear("measured")
    before = page.scene["measured"]["y"]
    assert measured["y"][-1] - before[-1] == pytest.approx(0.1, abs=0.01)
    mode = await page.hear("fit")
    assert len(mode["layers"]) == 4 and mode["offset_mm"] > 0
    ridge = await page.hear("ridge")
    assert len(ridge["mu_pa"]) == len(ridge["offset_mm"]) == 100
    await page.say("change", insert_mm=20.0)
    while not (await page.hear("band"))["x"]:  # the first may be that of first contact
        pass


@visit
async def test_without_a_measured_needle_there_is_no_fit(server, page) -> None:
    await page.say("fit", scope="insertion")
    assert page.refused and page.scene["fit"] is None


@visit
async def test_aligned_constraint_points_give_the_tip_of_simulate(server, page) -> None:
    scene = Scene.from_record(open_target("study2").record)
    step = replace(scene.steps[0], depth=40.0)
    wanted = simulate_steps(scene.needle, scene.tissue, (step,), scene.rules).tip_lateral
    await page.say("align")
    assert page.refused  # at the entry
    before = await page.say("change", insert_mm=40.0)
    assert abs(before["tip"]["lateral_mm"] - wanted) > 1e-3
    state = await page.say("align")
    assert page.scene["first_cell_mm"] == pytest.approx(1.0) and state["depth_mm"] == 40.0
    assert state["tip"]["lateral_mm"] == pytest.approx(wanted, abs=1e-9)
    await page.say("change", set=[["mu_pa", 1, 3e5]])
    await page.say("align")
    assert page.refused  # parameters of the scene alone
