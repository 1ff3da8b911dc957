"""What Foxglove gets, read by others: the mcap package with protobuf's decoder, and a plain WebSocket client."""

from __future__ import annotations

import itertools
import json
import shutil
import struct
import time
from collections import defaultdict
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import viewer_line as line

from aggregator.ledger.writer import Ledger
from conveyor import topics
from conveyor.config import CameraConfig, LineConfig, dump_toml
from conveyor.delivery import KeptPublisher, LatestPublisher, ReliablePublisher
from conveyor.errors import ConfigError, InputError, LedgerError
from conveyor.formats.conversion import write_recording
from conveyor.formats.source import CameraDescription
from conveyor.messages import Frame
from tests.written_run import CAMERA, write_run
from tuberline.cli.recordings import convert

pytest.importorskip("foxglove")
pytest.importorskip("mcap_protobuf")
client = pytest.importorskip("websockets.sync.client")

WEIGHTS_G = (91.0, 203.5, 148.25)
CROSSED_S = (0.4, 0.7, 0.9)
BELT_MPS = 0.8
"""Of `tests.written_run`, which begins at 1 m."""
Decoded = dict[str, list[tuple[int, Any]]]


class Filmed:
    """A recording of 40 frames, held in memory, whose belt is that of `written_run`."""

    description = CameraDescription(
        CAMERA, "test", line.LENS, line.SCALE_M, line.BELT_DISTANCE_M, None, line.FPS, frames=40
    )

    def frames(self, *, run: str, after: int = -1) -> Any:
        jpeg = cv2.imencode(".jpg", np.full((line.LENS.height, line.LENS.width, 3), 90, np.uint8))[1].ravel()
        for seq in range(after + 1, 40):
            seen: Frame = line.frame(seq, line.potatoes(6, seed=21), camera=CAMERA, run=run)
            since_s = (line.moment_ns(seq) - line.START_NS) / 1e9 - CROSSED_S[0]
            yield replace(seen, travel_m=since_s * BELT_MPS + 1.0, color_jpeg=jpeg)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(recording, run) of the same belt."""
    folder = tmp_path_factory.mktemp("filmed")
    write_recording([Filmed()], folder / "recording", files={})
    crossed_ns = np.array([line.START_NS + int(s * 1e9) for s in CROSSED_S])
    write_run(folder / "run", run="monday", crossed_ns=crossed_ns, weight_g=np.array(WEIGHTS_G))
    return folder / "recording", folder / "run"


def decoded(path: Path) -> Decoded:
    """(log time, message) by topic, as the mcap package and protobuf's decoder read them; times never go back."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: Decoded = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.message_encoding == "json":
                found[channel.topic].append((message.log_time, json.loads(message.data)))
            else:
                assert schema.name.startswith("foxglove."), schema.name
                decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
                found[channel.topic].append((message.log_time, decode(message.data)))
    for messages in found.values():
        times = [at_ns for at_ns, _ in messages]
        assert times == sorted(times)
    return found


def test_a_run_becomes_pictures_boxes_weights_and_totals(filmed: tuple[Path, Path], tmp_path: Path) -> None:
    recording, run = filmed
    convert(run, tmp_path / "run.mcap", format="foxglove", recording=recording)
    found = decoded(tmp_path / "run.mcap")

    images = found[f"/{CAMERA}/depth/image"]
    assert len(images) == len(found[f"/{CAMERA}/color/image"]) == 40
    at_ns, image = images[17]
    depth = np.frombuffer(image.data, "<u2").reshape(image.height, image.width)
    expected = next(itertools.islice(Filmed().frames(run="r"), 17, None))
    assert np.array_equal(depth, expected.depth), "depth is lossless"
    assert (at_ns, image.encoding, image.frame_id) == (expected.captured_ns, "16UC1", f"camera/{CAMERA}")
    calibration = found[f"/{CAMERA}/depth/calibration"][0][1]
    k = line.LENS
    assert list(calibration.K) == [k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0]
    cloud = found[f"/{CAMERA}/points"][0][1]
    points = np.frombuffer(cloud.data, "<f4").reshape(-1, 3)
    assert len(points) * 12 == len(cloud.data)
    assert cloud.point_stride == 12
    assert points[:, 2].max() == pytest.approx(line.BELT_DISTANCE_M, abs=1e-3)

    boxes = {e.id: (at, e) for at, update in found["/tubers"] for e in update.entities if "/tuber/" in e.id}
    assert [e.texts[0].text for _, e in boxes.values()] == ["91 g", "204 g", "148 g"]
    assert all(e.frame_id == "riding" for _, e in boxes.values())
    values = [{pair.key: float(pair.value) for pair in e.metadata} for _, e in boxes.values()]
    assert [value["weight_g"] for value in values] == list(WEIGHTS_G)
    for (at, _), crossed_s in zip(boxes.values(), CROSSED_S, strict=True):
        assert at < line.START_NS + crossed_s * 1e9, "its box is there before it crosses"

    dots = found["/tuber/weight_g"]
    assert [(at, value["value"]) for at, value in dots] == [
        (line.START_NS + int(s * 1e9), g) for s, g in zip(CROSSED_S, WEIGHTS_G, strict=True)
    ]
    assert [value["value"] for _, value in found["/load/counted_kg"]] == pytest.approx(np.cumsum(WEIGHTS_G) / 1000)
    (total,) = [value for _, value in found["/load/weight_kg"]]
    assert total["value"] == pytest.approx(sum(WEIGHTS_G) / 1000)
    assert total["low_90"] < total["value"] < total["high_90"]
    transforms = [(at, t) for at, t in found["/tf"] if t.child_frame_id == "riding"]
    at, last = transforms[-1]
    assert last.translation.x == pytest.approx(1.0 + BELT_MPS * ((at - line.START_NS) / 1e9 - CROSSED_S[0]), abs=1e-6)


def test_a_recording_alone_is_shown_and_read_back(filmed: tuple[Path, Path], tmp_path: Path) -> None:
    from conveyor.formats import open_source

    convert(filmed[0], tmp_path / "frames.mcap", format="foxglove")
    found = decoded(tmp_path / "frames.mcap")
    assert not any("/tuber/" in e.id for _, update in found["/tubers"] for e in update.entities)
    source = open_source(tmp_path / "frames.mcap", belt_distance_m=line.BELT_DISTANCE_M, depth_scale_m=line.SCALE_M)
    ours = [frame for frame in source.frames(run="r") if isinstance(frame, Frame)]
    assert len(ours) == 40
    assert np.array_equal(ours[9].depth, next(itertools.islice(Filmed().frames(run="r"), 9, None)).depth)


class Later(Filmed):
    """Another recording, whose first frame came when all of the run's tubers had crossed."""

    def frames(self, *, run: str, after: int = -1) -> Any:
        for frame in super().frames(run=run, after=after):
            yield replace(frame, captured_ns=frame.captured_ns + 3_600_000_000_000)


def test_a_run_is_not_shown_over_another_ones_pictures(filmed: tuple[Path, Path], tmp_path: Path) -> None:
    run = filmed[1]
    write_recording([Later()], tmp_path / "later", files={})
    with pytest.raises(InputError, match=r"all tubers of the run crossed \d{4}\.\d s and more before its first frame"):
        convert(run, tmp_path / "run.mcap", format="foxglove", recording=tmp_path / "later")
    (tmp_path / "two").mkdir()
    with Ledger(tmp_path / "two" / "ledger.db") as ledger:
        ledger.open_run("both", line="line", cameras=("left", "right"), version="1", started_ns=line.START_NS)
    one = CameraConfig(path=tmp_path / "gone")
    (tmp_path / "two" / "line.toml").write_text(dump_toml(LineConfig(cameras={"left": one, "right": one})))
    with pytest.raises(InputError, match=rf"its cameras are {CAMERA}, and the run counted with left, right"):
        convert(tmp_path / "two", tmp_path / "run.mcap", format="foxglove", recording=filmed[0])
    assert {path.name for path in tmp_path.iterdir()} == {"later", "two"}
    other = CameraConfig(path=tmp_path / "right")
    (tmp_path / "two" / "line.toml").write_text(dump_toml(LineConfig(cameras={"left": one, "right": other})))
    convert(tmp_path / "two", tmp_path / "run.mcap", format="foxglove", recording=filmed[0])  # that of one of them


def test_what_cannot_be_shown_is_refused_and_nothing_is_left(filmed: tuple[Path, Path], tmp_path: Path) -> None:
    recording, run = filmed
    with pytest.raises(InputError, match="--recording RECORDING"):
        convert(run, tmp_path / "run.mcap", format="foxglove")
    with pytest.raises(InputError, match=r"must end in \.mcap"):
        convert(recording, tmp_path / "frames", format="foxglove")
    with pytest.raises(LedgerError, match="known: monday"):
        convert(run, tmp_path / "run.mcap", format="foxglove", recording=recording, run="tuesday")
    with pytest.raises(InputError, match="--format foxglove"):
        convert(recording, tmp_path / "frames.mcap", run="monday")
    assert list(tmp_path.iterdir()) == []
    blank = shutil.copytree(recording, tmp_path / "blank")
    for image in blank.glob("*/depth/*"):
        image.write_bytes(b"")
    with pytest.raises(InputError, match=r"blank.*: no frame can be read; the first: frame 0"):
        convert(blank, tmp_path / "frames.mcap", format="foxglove")
    assert list(tmp_path.iterdir()) == [blank], "it was a file without pictures, with exit code 0"


@pytest.mark.parametrize("address", ["here/there", "127.0.0.1:notaport", "127.0.0.1:70000", "127.0.0.1:\u00b2", "8765"])
def test_an_address_that_is_none_is_refused_with_the_form_of_one(address: str) -> None:
    from viewer.node import Target

    with pytest.raises(ConfigError, match="HOST:PORT"):
        Target(rrd=None, rrd_limit_bytes=0, connect=None, foxglove=address).check()


class App:
    """What Foxglove's app does: takes the channels that are told, subscribes to all, keeps what comes."""

    def __init__(self, stack: ExitStack, port: int) -> None:
        url = f"ws://127.0.0.1:{port}"
        self._socket = stack.enter_context(client.connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None))
        self._channels: dict[int, dict[str, Any]] = {}
        self.found: Decoded = defaultdict(list)

    def heard(self, seconds: float) -> Decoded:
        """What was found until so much later."""
        self.listen(seconds)
        return self.found

    def listen(self, seconds: float) -> None:
        """Take what comes within so many seconds."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                message = self._socket.recv(timeout=0.05)
            except TimeoutError:
                continue
            if isinstance(message, str):
                self._told(json.loads(message))
            elif message[0] == 1:
                subscription, at_ns = struct.unpack_from("<IQ", message, 1)
                self._take(self._channels[subscription], at_ns, message[13:])

    def _told(self, told: dict[str, Any]) -> None:
        if told["op"] != "advertise":
            return
        self._channels |= {channel["id"]: channel for channel in told["channels"]}
        wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in told["channels"]]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _take(self, channel: dict[str, Any], at_ns: int, data: bytes) -> None:
        self.found[channel["topic"]].append((at_ns, _decoded(channel, data)))


def _decoded(channel: dict[str, Any], data: bytes) -> Any:
    import base64

    from mcap.records import Schema
    from mcap_protobuf.decoder import DecoderFactory

    if channel["encoding"] == "json":
        return json.loads(data)
    schema = Schema(
        id=channel["id"],
        data=base64.b64decode(channel["schema"]),
        encoding=channel["schemaEncoding"],
        name=channel["schemaName"],
    )
    return DecoderFactory().decoder_for("protobuf", schema)(data)


@pytest.mark.graph
def test_the_app_sees_the_line_live_and_one_that_comes_late_gets_the_scene(tmp_path: Path) -> None:
    tubers = line.potatoes(4, seed=11)
    with (
        line.router() as link,
        line.viewer(link, tmp_path, "--foxglove", "127.0.0.1:0") as watcher,
        ExitStack() as apps,
    ):
        node = watcher.observer
        line.within(10, lambda: watcher.gauge("foxglove_port") > 0, "the server listens")
        port = int(watcher.gauge("foxglove_port"))
        info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
        frames = LatestPublisher(node, topics.FRAME_FEW, camera="front")
        counted = ReliablePublisher(node, topics.TUBER)
        totals = KeptPublisher(node, topics.TOTALS)
        info.put(line.camera_info())
        line.within(10, lambda: frames.has_listener, "the viewer subscribes to frames")
        app = App(apps, port)
        for seq in range(30):
            frames.put(line.frame(seq, tubers))
            app.listen(0.02)
        for tuber in tubers:
            counted.put(line.counted(tuber))
        totals.put(line.totals(tubers, final=True))
        line.within(10, lambda: watcher.counter("tuber_shown") == len(tubers), "all tubers are shown")
        line.within(10, lambda: watcher.settled("foxglove"), "the server has everything")
        line.within(10, lambda: "/load/weight_kg" in app.heard(0.1), "the load's weight is there")
        app.listen(0.5)
        late = App(apps, port)
        late.listen(1.5)
        apps.close()
        watcher.stop()
    assert len(app.found["/front/depth/image"]) >= 2
    assert app.found["/front/depth/image"][0][1].width == line.LENS.width // 2
    expected = {f"{tuber.weight_g:.0f} g" for tuber in tubers}
    for found in (app.found, late.found):
        entities = [e for _, update in found["/tubers"] for e in update.entities]
        assert {e.texts[0].text for e in entities if "/tuber/" in e.id} == expected
        assert any(e.id == "/load/page" and "4 tubers" in e.texts[0].text for e in entities)
    assert app.found["/load/weight_kg"][-1][1]["value"] == pytest.approx(sum(t.weight_g for t in tubers) / 1000)
