"""A tracked needle: what is streamed and taken, frames, what freezes it, and peers that send anything."""

import asyncio
import json
import struct
import time
from dataclasses import replace

import numpy as np
import pyigtl
import pytest
from openigtlink_cases import (
    IDENTITY,
    connected,
    pack,
    read_polydata,
    record,
    served,
    tip_path,
    transform,
    until,
)
from pydantic import ValidationError
from server_cases import asynchronous
from test_cli import run
from test_viewer_server import Page

from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame, Placement, to_lps
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.shape import compute_positions
from needlefit.viewer import openigtlink
from needlefit.viewer.openigtlink import MAX_PEERS, MAX_SKIPPED_BYTES, pack_needle, read_pose
from needlefit.viewer.opening import open_target
from needlefit.viewer.recording import read_recording, replay
from needlefit.viewer.tracking import TrackedTrial, is_rigid, register_tracker
from needlefit.viewer.trials import TrialRegistry

HEADER = struct.Struct(">H12s20sIIQQ")
STREAMED = {
    ("NeedlefitNeedle", "POLYDATA"),
    ("NeedlefitTip", "TRANSFORM"),
    ("NeedlefitBand", "POLYDATA"),
    ("NeedlefitTipBand", "POINT"),
    ("NeedlefitStatus", "STRING"),
}


def split(packed: bytes) -> dict[str, tuple[str, bytes]]:
    """Return type and body of each message by its device."""
    found = {}
    while packed:
        _, kind, name, _, _, size, _ = HEADER.unpack(packed[:58])
        found[name.rstrip(b"\0").decode()] = kind.rstrip(b"\0").decode(), packed[58 : 58 + size]
        packed = packed[58 + size :]
    return found


class Poses:
    """A tracked needle without sockets, whose clock is set."""

    def __init__(self, folder, name="phantom2", viewed_scene=None, **changes) -> None:
        viewed_scene = viewed_scene or open_target(name)
        self.trials = TrialRegistry(viewed_scene, folder, lambda insertion: viewed_scene)
        self.tracked, self.now = TrackedTrial(record(**changes), self.trials), 1000.0

    @property
    def step(self):
        return self.tracked.trial.steering.now.step

    def send(self, seconds: float = 0.1, **poses) -> bool:
        """Send poses, each a point of C or (point, axis), and move the needle; whether to estimate."""
        self.now += seconds
        for name, pose in poses.items():
            point, axis = pose if isinstance(pose[0], tuple) else (pose, (1.0, 0.0, 0.0))
            self.tracked.take(name.capitalize(), transform(point, axis), self.now, self.now)
        return self.tracked.advance(self.now)

    def insert(self, tips) -> None:
        for tip in tips:
            if self.send(tip=tuple(tip)):
                self.tracked.apply(self.tracked.compute_estimate(), self.tracked.trial)

    @property
    def frozen(self) -> str:
        return self.tracked.find_frozen(self.now)


def test_base_stage_and_guide_are_inputs(tmp_path) -> None:
    poses = Poses(tmp_path)
    poses.send(base=((-120.0, 0.4), (1.0, 0.05, 0.0)), guide=((-30.0, 0.2), (1.0, 0.01, 0.0)))
    assert poses.step.depth == pytest.approx(30.0, abs=1e-4)
    assert poses.step.controls.base_y == pytest.approx(0.4, abs=1e-5)
    assert poses.step.controls.base_slope == pytest.approx(0.05, abs=1e-5)
    (guide,) = poses.step.controls.guides
    assert (guide.x, guide.y, guide.slope) == pytest.approx((-30.0, 0.2, 0.01), abs=1e-5)
    number = poses.tracked.trial.steering.number
    poses.send(base=((-119.99, 0.401), (1.0, 0.0501, 0.0)))  # jitter is no input
    assert poses.tracked.trial.steering.number == number and poses.frozen == ""
    other = Poses(tmp_path)
    other.send(stage=(500.0, 7.0))
    other.send(0.2, stage=(510.0, 7.3))
    assert other.step.depth == pytest.approx(10.0, abs=1e-4)
    assert other.step.controls.base_y == pytest.approx(0.3, abs=1e-4)


def test_a_jittering_base_makes_no_long_path(tmp_path) -> None:
    poses, rng = Poses(tmp_path), np.random.default_rng(0)
    for depth in np.arange(0.0, 20.0, 0.1):
        poses.send(0.02, base=((depth - 150.0, 0.3 * rng.standard_normal()), (1.0, 0.0, 0.0)))
    path = poses.tracked.trial.steering.input_path()
    assert poses.step.depth == pytest.approx(19.9, abs=0.06) and 10 < len(path) <= 25
    poses.send(0.3, base=((-130.1, 1.0), (1.0, 0.0, 0.0)))  # at rest it acts at once
    assert poses.step.controls.base_y == pytest.approx(1.0, abs=1e-5)


@pytest.mark.sweep
def test_while_it_goes_in_the_base_acts_once_a_millimetre_with_the_mean_of_its_poses(tmp_path) -> None:
    poses, rng, read, acted = Poses(tmp_path), np.random.default_rng(2), [], []
    poses.send(base=((-150.0, 0.0), (1.0, 0.0, 0.0)))
    poses.send(base=((-148.0, 0.0), (1.0, 0.0, 0.0)))
    for depth in np.arange(2.01, 40.0, 0.01):  # a hundred poses per millimetre
        y = 0.3 * rng.standard_normal()
        before = poses.step.controls.base_y
        poses.send(0.01, base=((depth - 150.0, y), (1.0, 0.01 * y, 0.0)))
        read.append(y)
        if poses.step.controls.base_y != before:
            acted.append(poses.step.controls.base_y)
            assert acted[-1] == pytest.approx(np.mean(read), abs=1e-5)
            assert poses.step.controls.base_slope == pytest.approx(0.01 * np.mean(read), abs=1e-5)
            read = []
    assert 30 < len(acted) <= 38 and np.std(acted) < 0.05
    tracked = poses.tracked
    assert all(len(known.recent) <= 256 for known in tracked.devices.values())
    assert len(tracked.trial.steering.input_path()) <= 40


def test_a_tip_estimates_the_parameters_which_the_needle_takes(tmp_path) -> None:
    poses, tips = Poses(tmp_path, tip_sd_mm=0.05, shift_sd_mm=0.05, slope_sd=0.001), tip_path(2.0, 1.3)
    before = poses.tracked.estimate
    assert before.readings == 0 and np.log(2.0) == pytest.approx(before.sd[0], rel=1e-3)
    poses.insert(tips)
    after, state = poses.tracked.estimate, poses.tracked.trial.steering.now
    assert 55 <= after.readings <= 60 and after.sd[-1] < 0.5 * before.sd[-1]
    truth = before.theta + np.log([2.0, 2.0, 2.0, 2.0, 1.3])
    assert np.all(np.abs(after.theta - truth) < 3 * after.sd)
    assert state.tissue.mu == pytest.approx(np.exp(after.theta[:-1]))
    assert state.step.bevel.offset == pytest.approx(np.exp(after.theta[-1]))
    assert compute_positions(state.shape, state.shape.x[-1:])[0] == pytest.approx(tips[-1], abs=0.15)
    spread = poses.tracked.trial.viewed_scene.spread
    assert isinstance(spread, ParameterDraws) and np.log(spread.bevel).std() == pytest.approx(
        after.sd[-1], rel=0.25
    )
    recording = read_recording(poses.tracked.trial.recorder.path)
    assert max(one.tip_offset_mm for one in replay(recording)) == 0
    poses.tracked.forget()
    assert poses.tracked.estimate.readings == 0


def test_the_prior_is_the_posterior_of_a_run_and_survives_a_withdrawal(tmp_path) -> None:
    shown = open_target("phantom2")
    rng = np.random.default_rng(1)
    draws = ParameterDraws(
        np.exp(rng.normal([[-1, 3, -1, 3]], 0.1, (90, 4))),
        np.ones((90, 1, 4)),
        np.exp(rng.normal(-2.4, 0.05, 90)),
    )
    poses = Poses(tmp_path, viewed_scene=replace(shown, spread=draws))
    prior = poses.tracked.estimate
    assert prior.theta == pytest.approx([-1, 3, -1, 3, -2.4], abs=0.05)
    assert prior.sd == pytest.approx([0.1, 0.1, 0.1, 0.1, 0.05], rel=0.3)
    poses.insert(tip_path()[:30])
    first = poses.tracked.estimate
    poses.insert(tip_path()[29::-1])
    assert poses.step.depth < 3 and poses.tracked.estimate is first  # no reading on the way out
    poses.insert(tip_path()[:30])
    assert poses.tracked.estimate.readings > first.readings


def test_what_is_stale_jumps_or_cannot_be_the_needle_freezes_it(tmp_path) -> None:
    poses, tips = Poses(tmp_path), tip_path()
    poses.insert(tips[:20])
    depth, estimate = poses.step.depth, poses.tracked.estimate
    assert poses.frozen == "" and estimate.readings >= 18
    poses.now += 0.6
    assert "stale" in poses.frozen and not poses.tracked.advance(poses.now)
    poses.insert([tips[20]])  # it goes on by itself
    assert poses.frozen == "" and poses.step.depth > depth
    depth, estimate = poses.step.depth, poses.tracked.estimate
    poses.insert([tips[40], tips[40], tips[41]])  # 20 mm in 0.1 s, and it stays there
    assert "jumped" in poses.frozen and poses.step.depth == depth and poses.tracked.estimate is estimate
    assert poses.tracked.status(poses.now)["frozen"] == poses.frozen
    poses.tracked.release()
    poses.insert([tips[41]])
    assert poses.frozen == "" and poses.step.depth > 40
    number = poses.tracked.trial.steering.number
    matrix = transform(tips[42])
    matrix[2, 3] = 6.0
    poses.now += 0.1
    poses.tracked.take("Tip", matrix, poses.now, poses.now)
    assert not poses.tracked.advance(poses.now) and "out of the bending plane" in poses.frozen
    poses.insert([tips[42]])
    poses.send(base=((-105.0, 0.0), (0.0, 1.0, 0.0)), tip=tuple(tips[42]))
    assert "z axis" in poses.frozen
    assert poses.tracked.trial.steering.number <= number + 2


def test_old_and_overtaken_messages_are_not_taken(tmp_path) -> None:
    """Clocks of sender and receiver differ by an hour; age is what a message took longer than the fastest."""
    poses, tracked = Poses(tmp_path), None
    tracked = poses.tracked
    for n, (sent, received, x) in enumerate([(0.0, 0.0, -140.0), (0.1, 0.1, -139.0), (0.2, 1.2, -138.0)]):
        tracked.take("Base", transform((x, 0.0)), 5000.0 + sent, 1000.0 + received)
        tracked.advance(1000.0 + received)
        assert poses.step.depth == pytest.approx([10.0, 11.0, 11.0][n], abs=1e-3)
    tracked.take("Base", transform((-137.0, 0.0)), 5001.2, 1001.21)
    tracked.take("Base", transform((-139.0, 0.0)), 5001.1, 1001.22)
    tracked.advance(1001.22)
    assert poses.step.depth == pytest.approx(13.0, abs=1e-3) and tracked.find_frozen(1001.22) == ""


def test_what_is_no_pose_is_not_taken(tmp_path) -> None:
    tracked = Poses(tmp_path).tracked
    scaled, mirrored, hole = 1.1 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(4)
    hole[0, 3] = np.nan
    for matrix in (scaled, mirrored, hole):
        assert not is_rigid(matrix) and not tracked.take("Tip", matrix, 1.0, 1.0)
    assert not tracked.take("Stranger", np.eye(4), 1.0, 1.0)
    assert tracked.ignored == 4 and tracked.devices == {}


def test_the_stream_is_in_ras_where_the_needle_lies(tmp_path) -> None:
    """World to LPS to RAS: a frame C that is turned in the world, and a patient that is turned, too."""
    frame = Frame(np.array([5.0, -2.0, 7.0]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    patient = Frame(np.array([10.0, 20.0, 30.0]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    placed = replace(open_target("phantom2"), placement=Placement(frame, patient).to_record())
    tracked = Poses(tmp_path, viewed_scene=placed).tracked
    c, world = np.array([[3.0, 4.0]]), np.array([5.0 - 4.0, -2.0 + 3.0, 7.0])
    lps = np.array([world[1] - 20.0, 10.0 - world[0], world[2] - 30.0])
    assert tracked.to_ras(c)[0] == pytest.approx([-lps[0], -lps[1], lps[2]])
    assert tracked._to_c(tracked.to_ras(c))[0] == pytest.approx([3.0, 4.0, 0.0])
    sent = split(pack_needle(tracked))
    assert {(name, kind) for name, (kind, _) in sent.items()} < STREAMED
    points, line = read_polydata(sent["NeedlefitNeedle"][1])
    shape = tracked.trial.steering.now.shape
    there = compute_positions(shape, np.linspace(shape.x[0], shape.x[-1], len(points)))
    assert points == pytest.approx(tracked.to_ras(there), abs=1e-4) and list(line) == list(range(len(points)))
    numbers = np.array(struct.unpack(">12f", sent["NeedlefitTip"][1])).reshape(4, 3).T
    assert is_rigid(np.vstack([numbers, [0, 0, 0, 1]])) and numbers[:, 3] == pytest.approx(points[-1])
    along = tracked.to_ras(np.array([[1.0, 0.0]]))[0] - tracked.to_ras(np.array([[0.0, 0.0]]))[0]
    assert numbers[:, 2] == pytest.approx(along, abs=1e-6)  # z along the needle, x to the bevel's side
    side = tracked.to_ras(np.array([[0.0, 1.0]]))[0] - tracked.to_ras(np.array([[0.0, 0.0]]))[0]
    assert numbers[:, 0] == pytest.approx(tracked.trial.steering.now.step.bevel.side * side, abs=1e-6)


def test_a_tracker_is_registered_by_a_matrix_or_by_markers() -> None:
    motion = np.array([[0, -1, 0, 10.0], [1, 0, 0, -5], [0, 0, 1, 2], [0, 0, 0, 1]])
    placement = Placement(Frame(np.zeros(3), np.eye(3)))
    tracker = np.array([[0.0, 0, 0], [50, 0, 0], [0, 40, 0], [0, 0, 30]])
    ras = tracker @ motion[:3, :3].T + motion[:3, 3]
    markers = [
        {"name": f"m{n}", "tracker_mm": one, "world_mm": other}
        for n, (one, other) in enumerate(zip(tracker.tolist(), to_lps(ras, "RAS").tolist(), strict=True))
    ]
    for given in ({"tracker_to_ras": motion.tolist()}, {"markers": markers}):
        frame = register_tracker(record(**given), placement)
        assert frame.rows == pytest.approx(motion[:3], abs=1e-9)
    right = {"tracker_to_ras": IDENTITY}
    wrong_devices = ({"tip": "Base"}, {"tip": ""}, {"guides": ["g" * 21]})
    for wrong in (
        {},
        {"markers": markers[:2]},
        {"markers": markers} | right,
        *(right | {"devices": one} for one in wrong_devices),
        *(right | {"server": one} for one in ("host", "host:x", ":1 2")),
        right | {"max_speed_mm_s": 0},
        {"markers": [markers[0] | {"tracker_mm": [1e308, 0.0, 0.0]}, *markers[1:]]},
        right | {"tip_sd_mm": 1e16},
    ):
        with pytest.raises(ValidationError):
            type(record()).model_validate({"schema": 1, **wrong})
    line = [m | {"tracker_mm": [float(n), 0.0, 0.0]} for n, m in enumerate(markers)]
    for given in ({"markers": line}, {"tracker_to_ras": (2 * np.eye(4)).tolist()}):
        with pytest.raises(ConfigError):
            register_tracker(record(**given), placement)


def test_poses_come_as_transform_position_or_point() -> None:
    turned = transform((1.0, 2.0), (1.0, 0.5, 0.0))

    def unpack(packed: bytes):
        fields = pyigtl.messages.MessageBase.parse_header(packed[:58])
        return read_pose(fields, packed[58:])

    assert unpack(pack("Tip", turned)) == pytest.approx(turned, abs=1e-6)
    for status, known in (("OK", True), ("MISSING", False)):
        message = pyigtl.TransformMessage(turned, device_name="Tip")
        message.header_version, message.metadata = 2, {"TransformStatus": status}
        assert (unpack(message.pack()) is not None) == known
    point = pyigtl.PointMessage(positions=[1.0, 2.0, 3.0], device_name="Tip").pack()
    assert unpack(point)[:3, 3] == pytest.approx([1, 2, 3])
    half = np.sqrt(0.5)  # a quarter turn about z
    found = read_pose({"message_type": "POSITION"}, struct.pack(">7f", 1, 2, 3, 0, 0, half, half))
    assert found[:3] == pytest.approx(np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3.0]]), abs=1e-6)
    for kind, body in (("POSITION", b"123"), ("POINT", b"1"), ("TRANSFORM", b"12"), ("POINT", b"\xff" * 136)):
        fields = {"message_type": kind, "header_version": 1, "device_name": "", "timestamp": 0.0}
        assert read_pose(fields, body) is None
    assert read_pose({"message_type": "POSITION"}, bytes(28)) is None


@asynchronous
async def test_a_client_of_the_library_moves_the_needle_and_receives_it(tmp_path) -> None:
    async with served(tmp_path, tip_sd_mm=0.05) as server:
        assert server.server.address[0] == "127.0.0.1"
        with connected(server.server.address[1]) as client:
            await until(client.is_connected)
            for tip in tip_path(2.0, 1.3)[:25]:
                client.send_message(pyigtl.TransformMessage(transform(tip), device_name="Tip"), wait=False)
                await asyncio.sleep(0.03)
            await until(lambda: server.tracked.estimate.readings > 15)
            heard, true = {}, [*tip_path(2.0, 1.3)[24], 0.0]
            found = ends = [np.nan] * 3  # the band comes a little later than the tip
            while not (np.allclose(found, true, atol=0.5) and ends[0] < found[1] < ends[1]):
                heard |= {message.device_name: message for message in client.get_latest_messages()}
                if {"NeedlefitTip", "NeedlefitTipBand", "NeedlefitStatus"} <= heard.keys():
                    found = heard["NeedlefitTip"].matrix[:3, 3] * [-1, -1, 1]
                    ends = [-one[1] for one in heard["NeedlefitTipBand"].positions]
                await asyncio.sleep(0.01)
        assert {(name, message.message_type) for name, message in heard.items()} <= STREAMED
        status = json.loads(heard["NeedlefitStatus"].string)
        assert status["research_use"] and status["peers"] == 1 and len(status["mu_pa"]) == 4
        await until(lambda: server.tracked.peers == 0)
        with connected(server.server.address[1]) as client:  # it comes again
            await until(lambda: client.is_connected() and server.tracked.peers == 1)
            client.send_message(pyigtl.TransformMessage(transform(tip_path()[25]), device_name="Tip"))
            await until(lambda: server.depth > 25.5)


@asynchronous
async def test_the_page_shows_the_tracked_needle(tmp_path) -> None:
    async with served(tmp_path) as server:
        base = f"http://127.0.0.1:{server.access.port}"
        page = Page(await server.client.ws_connect(f"{base}/ws", headers={"Origin": base}))
        await page.say("hello", token=server.access.token, needle=None)
        assert page.scene["needle"] == server.tracked.trial.name
        _, writer = await asyncio.open_connection(*server.server.address)
        writer.write(pack("Base", transform((-125.0, 0.5))))
        await until(lambda: server.depth == pytest.approx(25.0, abs=1e-3))
        while page.depth != pytest.approx(25.0, abs=1e-3):
            await page.read()
        status = await page.hear("tracking")
        while "base" not in status["devices"]:
            status = await page.hear("tracking")
        assert status["frozen"] == "" and status["research_use"]
        writer.write(pack("Base", transform((-90.0, 0.5))))
        await until(lambda: "jumped" in server.tracked.find_frozen(time.time()))
        assert page.depth == pytest.approx(25.0, abs=1e-3)
        # The program orders the steps: inputs of the page come back as such, and an undo, too.
        before = page.steering.now
        await page.say("change", set=[["bevel_side", None, -before.step.bevel.side]], gesture=7)
        assert page.steering.now.step.bevel.side == -before.step.bevel.side and not page.refused
        await page.say("change", set=[["return_to", None, page.steering.number - 1]], gesture="undo")
        assert page.steering.now.step == before.step
        assert page.steering.now.shape.tip_lateral == before.shape.tip_lateral
        await page.say("steps", steps=[[99, 0.0, None, [["depth_mm", None, -1.0]], 0.0]])
        assert page.refused
        await page.say("release_tracker")
        writer.write(pack("Base", transform((-90.0, 0.5))))
        await until(lambda: server.depth == pytest.approx(60.0, abs=1e-3))
        await page.say("forget_estimate")
        writer.close()


@asynchronous
async def test_garbage_and_wrong_messages_move_nothing(tmp_path) -> None:
    rng = np.random.default_rng(4)
    pose = pack("Base", transform((-130.0, 0.0)))
    image = pyigtl.ImageMessage(np.zeros((8, 64, 64), np.uint8), device_name="Base").pack()
    damaged = pose[:-1] + bytes([pose[-1] ^ 1])
    huge = HEADER.pack(1, b"TRANSFORM", b"Base", 0, 0, MAX_SKIPPED_BYTES + 1, 0)
    too_long = HEADER.pack(1, b"TRANSFORM", b"Base", 0, 0, 20_000, 0) + bytes(20_000)
    unknown = HEADER.pack(1, b"STT_TDATA", b"", 0, 0, 0, 0)
    text = pyigtl.StringMessage("go", device_name="Base").pack()
    ends = [
        rng.bytes(3000),
        huge,
        b"\xff" * 58,
        pose[:30],
        pose[:-5],
        HEADER.pack(9, b"TRANSFORM", b"", 0, 0, 48, 0),
    ]
    async with served(tmp_path) as server:
        for sent in ends:
            reader, writer = await asyncio.open_connection(*server.server.address)
            writer.write(sent)
            if sent in (pose[:30], pose[:-5]):
                writer.write_eof()
            async with asyncio.timeout(10):
                while await reader.read(1 << 16):  # until it closes the connection
                    pass
            writer.close()
        await until(lambda: server.tracked.peers == 0)
        assert server.depth == 0 and server.tracked.devices == {}
        _, writer = await asyncio.open_connection(*server.server.address)
        for sent in (image, damaged, too_long, unknown, text):
            writer.write(sent)
        await until(lambda: server.tracked.ignored >= 5)
        assert server.depth == 0
        writer.write(pose)  # after all of these the connection still works
        await until(lambda: server.depth == pytest.approx(20.0, abs=1e-3))
        writer.close()


@asynchronous
async def test_it_ends_beside_a_peer_without_a_fault(tmp_path) -> None:
    faults = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: faults.append(context))
    async with served(tmp_path) as server:
        reader, writer = await asyncio.open_connection(*server.server.address)
        await until(lambda: server.tracked.peers == 1)
    async with asyncio.timeout(5):
        while await reader.read(1 << 16):
            pass
    writer.close()
    await asyncio.sleep(0.05)
    assert faults == [] and server.tracked.peers == 0


@pytest.mark.sweep
@asynchronous
async def test_half_a_header_is_cut_off_and_a_peer_that_sends_nothing_is_not(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(openigtlink, "STALLED_S", 0.1)
    async with served(tmp_path) as server:
        _, silent = await asyncio.open_connection(*server.server.address)
        _, half = await asyncio.open_connection(*server.server.address)
        half.write(pack("Base", transform((-130.0, 0.0)))[:20])
        await until(lambda: server.tracked.peers == 2)
        await until(lambda: server.tracked.peers == 1)
        await asyncio.sleep(0.3)
        assert server.tracked.peers == 1
        silent.close()
        half.close()


@asynchronous
async def test_many_messages_and_peers_are_limited(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(openigtlink, "STALLED_S", 0.1)
    monkeypatch.setattr(openigtlink, "MAX_WAITING_BYTES", 1024)
    async with served(tmp_path) as server:
        links = [await asyncio.open_connection(*server.server.address) for _ in range(MAX_PEERS)]
        await until(lambda: server.tracked.peers == MAX_PEERS)
        reader, refused = await asyncio.open_connection(*server.server.address)
        assert await reader.read() == b""
        refused.close()
        for _, writer in links[1:]:
            writer.close()
        await until(lambda: server.tracked.peers == 1)
        _, writer = links[0]
        n = 3000
        writer.write(b"".join(pack("Base", transform((-140.0 + 10 * k / n, 0.0))) for k in range(n + 1)))
        await until(lambda: server.depth > 10.0)
        while server.depth != pytest.approx(20.0, abs=0.06):  # what waited for too long was not taken
            writer.write(pack("Base", transform((-130.0, 0.0))))
            await asyncio.sleep(0.05)
        server.server._broadcast(bytes(60_000_000))  # a peer that reads nothing is dropped
        assert server.tracked.peers == 1
        server.server._broadcast(b"1")
        await asyncio.sleep(0.2)
        server.server._broadcast(b"1")
        assert server.tracked.peers == 0
        writer.close()


@asynchronous
async def test_poses_of_a_server_are_taken_and_nothing_is_sent_to_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(openigtlink, "RECONNECT_INTERVAL_S", 0.02)
    received, links = [], []

    async def attend(reader, writer) -> None:
        links.append(writer)
        writer.write(pack("Base", transform((-140.0 + len(links), 0.0))))
        received.append(await reader.read())
        writer.close()

    source = await asyncio.start_server(attend, "127.0.0.1", 0)
    port = source.sockets[0].getsockname()[1]
    async with served(tmp_path, server=f"127.0.0.1:{port}") as server:
        await until(lambda: server.depth == pytest.approx(11.0, abs=1e-3))
        links[0].close()
        await until(lambda: server.depth == pytest.approx(12.0, abs=1e-3))
    await until(lambda: len(received) == 2)
    assert received == [b"", b""]
    source.close()


def test_the_command_requires_a_registration(tmp_path, capsys, monkeypatch) -> None:
    file = tmp_path / "tracker.toml"
    base = ("view", "phantom2", "--no-browser", "--out", str(tmp_path / "out"))
    assert run(*base, "--openigtlink", "0") == 3
    assert "--tracker" in capsys.readouterr().err
    assert run(*base, "--tracker", str(file)) == 2
    file.write_text("schema = 1\n")
    assert run(*base, "--openigtlink", "0", "--tracker", str(file)) == 3
    assert "tracker_to_ras" in capsys.readouterr().err
    file.write_text("schema = 1\ntracker_to_ras = [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n")
    assert run(*base, "--openigtlink", "0", "--tracker", str(file)) == 3
    assert "rigid" in capsys.readouterr().err
    file.write_text(f"schema = 1\ntracker_to_ras = {np.eye(4).tolist()}\n")
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert run(*base, "--openigtlink", port, "--tracker", str(file)) == 3
        assert port in capsys.readouterr().err
    import sys

    monkeypatch.setitem(sys.modules, "pyigtl", None)
    monkeypatch.setitem(sys.modules, "pyigtl.messages", None)
    monkeypatch.delitem(sys.modules, "needlefit.viewer.openigtlink")
    assert run(*base, "--openigtlink", "0", "--tracker", str(file)) == 3
    assert "openigtlink]" in capsys.readouterr().err
