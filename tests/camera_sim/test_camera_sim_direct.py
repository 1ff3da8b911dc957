"""Frames that stay on their host: what is promised of them holds, whoever else comes, goes or dies."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from camera_sim import outlet
from conveyor import topics
from conveyor.config import LineConfig, LinkConfig, parse_config
from conveyor.config_camera import CameraConfig
from conveyor.delivery import LatestSubscriber
from conveyor.direct import ENVIRONMENT, LONGEST_PATH, direct_endpoint
from conveyor.errors import ConfigError
from conveyor.formats import describe_recording, open_source
from conveyor.frame_ring import IN_MEMORY, ring_path
from conveyor.messages import Frame
from conveyor.node import Node
from tests.camera_sim.camera_process import RUN, OtherSide, line, other_side, process
from tests.conftest import start_router, wait_until
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor

pytestmark = pytest.mark.graph


@pytest.fixture
def direct(request: pytest.FixtureRequest) -> Iterator[str]:
    """A socket with a short path: that of a test's own folder may be too long. In memory, frames pass by a ring."""
    folder = tempfile.mkdtemp(prefix="tuberline-", dir=getattr(request, "param", IN_MEMORY))
    yield f"unixsock-stream/{folder}/front.sock"
    shutil.rmtree(folder)


def _frames(recording: Path) -> int:
    return describe_recording(recording).cameras[0].frames or 0


def _sent(side: OtherSide, name: str) -> int:
    counters = side.counters()
    return -1 if counters is None else int(counters.values.get(name, -1))


def _first_of_each_tick(few: list[Frame], recording: Path) -> None:
    source = open_source(recording, camera="front", ignore_masks=True).frames(run=RUN)
    ticks = {f.seq: f.captured_ns * topics.FEW_PER_S // 10**9 for f in source if isinstance(f, Frame)}
    firsts = [seq for seq in sorted(ticks) if ticks.get(seq - 1) != ticks[seq]]
    # It may have come when the first one was out already, or the process sent some again.
    assert set(firsts[1:]) <= {frame.seq for frame in few} <= set(firsts)
    assert len(firsts) <= len(ticks) / 2


@pytest.mark.parametrize("direct", [IN_MEMORY, None], indirect=True, ids=["in memory", "on disk"])
def test_the_router_sees_frames_only_while_somebody_beyond_looks(
    link: LinkConfig, small_recording: Path, tmp_path: Path, direct: str
) -> None:
    config, frames = line(link, path=small_recording, speed=0, window=1, direct=direct), _frames(small_recording)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front"):
        few = LatestSubscriber(side.node, topics.FRAME_FEW, Frame, capacity=64, name="few", camera="*")
        side.follow(1, done_seq=-1)
        wait_until(lambda: _sent(side, "frames_direct") >= 3, what="three frames by the direct link")
        assert _sent(side, "frames_by_router") == 0
        viewer = LatestSubscriber(side.node, topics.FRAME, Frame, capacity=64, name="viewer", camera="*")
        # One frame is in flight: it was sent before the viewer came.
        side.follow(2, done_seq=1)
        wait_until(lambda: len(viewer) > 0, what="a frame at the viewer")
        viewer.leave()
        here = len(viewer)
        side.follow(frames - 1, done_seq=2)
        side.wait_for_state("ended")
        assert sorted(set(side.seen)) == list(range(frames))
        wait_until(lambda: _sent(side, "frames_direct") >= frames, what="the camera's last count")
        # What was sent while the word that it left was on its way went there too.
        assert here <= _sent(side, "frames_by_router") <= here + 2 < frames - 4
        assert (_sent(side, "frames_in_memory") >= frames) == direct.startswith("unixsock-stream//dev/shm/")
        _first_of_each_tick(list(iter(lambda: few.get(0.0), None)), small_recording)


def test_a_ring_that_cannot_be_read_costs_no_frame(
    link: LinkConfig, small_recording: Path, tmp_path: Path, direct: str
) -> None:
    """The segmenter leaves it, and the camera sends the frames themselves; those in between it sends again."""
    ring = ring_path(direct)
    assert ring is not None
    config, frames = line(link, path=small_recording, speed=0, window=1, direct=direct), _frames(small_recording)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front"):
        side.follow(1, done_seq=-1)
        ring.unlink()
        assert side._ring is not None
        side._ring._reader.close()  # as one that starts now
        side.follow(frames - 1, done_seq=1)
        side.wait_for_state("ended")
        assert sorted(set(side.seen)) == list(range(frames))
        wait_until(lambda: _sent(side, "frames_direct") > _sent(side, "frames_in_memory") >= 2, what="both ways")


def test_frames_flow_on_while_the_router_is_dead(
    free_port: int, small_recording: Path, tmp_path: Path, direct: str
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    router = start_router(endpoint)
    config = line(LinkConfig(router=endpoint), path=small_recording, speed=0.2, waits=False, direct=direct)
    with other_side(config) as side, process(config, tmp_path, "camera", "--camera", "front"):
        wait_until(lambda: side.take(0.1) != [], what="the first frame")
        router.kill()
        router.wait()
        dead_at = side.seen[-1]
        wait_until(lambda: side.take(0.1) is not None and side.seen[-1] >= dead_at + 4, what="frames without a router")
        router = start_router(endpoint)
        side.wait_for_state("ended")
        last = _frames(small_recording) - 1
        wait_until(lambda: side.take(0.1) is not None and side.seen[-1] == last, what="the last frame")
        assert side.seen == list(range(side.seen[0], last + 1))
    router.terminate()
    router.wait(30)


def test_a_segmenter_that_comes_again_gets_the_frames_from_then_on(
    link: LinkConfig, small_recording: Path, tmp_path: Path, direct: str
) -> None:
    config, frames = line(link, path=small_recording, speed=0, window=2, direct=direct), _frames(small_recording)
    with process(config, tmp_path, "camera", "--camera", "front"):
        with other_side(config) as first:
            first.follow(2, done_seq=-1)
        with other_side(config) as second:
            second.follow(frames - 1, done_seq=2)
            second.wait_for_state("ended")
        assert sorted(set(second.seen)) == list(range(3, frames))


def test_where_frames_go_is_the_configs_or_the_supervisors_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ENVIRONMENT, raising=False)
    assert direct_endpoint(CameraConfig(), "front") is None
    monkeypatch.setenv(ENVIRONMENT, "/run/x")
    assert direct_endpoint(CameraConfig(), "front") == "unixsock-stream//run/x/front.sock"
    assert direct_endpoint(CameraConfig(direct="off"), "front") is None
    assert direct_endpoint(CameraConfig(direct="tcp/127.0.0.1:7001"), "front") == "tcp/127.0.0.1:7001"
    monkeypatch.setenv(ENVIRONMENT, "/" + "x" * LONGEST_PATH)
    assert direct_endpoint(CameraConfig(), "front") is None


@pytest.mark.parametrize("endpoint", ["tcp/10.0.0.1:7001", "tcp/0.0.0.0:7001", "udp/127.0.0.1:7001", "yes"])
def test_the_direct_link_is_of_this_host(endpoint: str) -> None:
    with pytest.raises(ConfigError, match=r"cameras\.front\.direct"):
        parse_config({"cameras": {"front": {"direct": endpoint}}}, where="test")


def test_a_supervisor_gives_its_folder_to_cameras_whose_segmenter_it_runs_too(tmp_path: Path) -> None:
    """Else the two would wait for each other in different folders, and the segmenter would see nothing."""
    config = LineConfig(cameras={"front": CameraConfig(), "rear": CameraConfig()})
    specs = {spec.name: spec for spec in line_processes(config, config_path=tmp_path / "line.toml", run=RUN)}
    whole = Supervisor(list(specs.values()))
    assert {name for name, spec in specs.items() if whole._has_both_ends(spec)} == {
        "camera-front", "camera-rear", "segmenter-front", "segmenter-rear",
    }  # fmt: skip
    apart = Supervisor([specs["camera-front"], specs["segmenter-rear"]])
    assert not apart._has_both_ends(specs["camera-front"])
    assert not apart._has_both_ends(specs["segmenter-rear"])


def test_a_camera_whose_frames_no_one_takes_says_so(
    link: LinkConfig, small_recording: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """One started by hand beside a `run` published forever: the segmenter of a run hears that run's camera."""
    monkeypatch.setattr(outlet, "ALONE_S", 0.0)
    config = line(link, path=small_recording, direct="off")
    frame = next(iter(open_source(small_recording, camera="front").frames(run=RUN)))
    assert isinstance(frame, Frame)
    with Node("camera", "front", config=config, run=RUN) as node, outlet.FrameOutlet(node, config, codec="raw") as out:
        out.put(frame)
        out.put(frame)
        told = [text for text in caplog.messages if "no segmenter takes frames" in text]
        assert len(told) == 1
        assert told[0].startswith("no segmenter takes frames by the router for 0 s: is it running")
        assert told[0].endswith("That of a `tuberline run` takes those of that run's camera alone")
        heard = LatestSubscriber(node, topics.FRAME, Frame, capacity=4, camera="front")
        wait_until(lambda: out.put(frame) or len(heard), what="a frame at the listener")  # type: ignore[func-returns-value]
        heard.leave()
        wait_until(
            lambda: out.put(frame) or len([t for t in caplog.messages if "takes frames" in t]) == 2,  # type: ignore[func-returns-value]
            what="the word again, after it was there",
        )
