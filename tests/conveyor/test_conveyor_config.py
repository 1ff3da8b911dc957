"""A config is refused, never corrected, and every fault is named."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from conveyor.config import LineConfig, dump_toml, load_config, parse_config
from conveyor.errors import ConfigError
from tuberline.cli.address import LineAddress
from tuberline.cli.config import check


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "line.toml"
    path.write_text(text)
    return path


def test_defaults_need_no_file() -> None:
    assert LineConfig().segmenter.views_per_tuber == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[segmenter]\nview_per_tuber = 3", "did you mean 'views_per_tuber'"),
        ("[segmentor]\nring = 3", "did you mean 'segmenter'"),
        ("[cameras.front]\nbelt_distance = 0.4", "did you mean 'belt_distance_m'"),
        ("processes = 1", r"processes: unknown key here; it belongs to \[regressor\]$"),
        ("[regressor]\nmerge_gate_mm = 20", r"regressor\.merge_gate_mm: .* belongs to \[aggregator\]$"),
        ("[cameras.a]\nrouter = 'tcp/a:1'", r"cameras\.a\.router: .* belongs to \[link\]$"),
        ("[cameras.a]\ngain = 3", r"cameras\.a\.gain: .* belongs to \[cameras\.NAME\.realsense\]$"),
        ("[viewer]\nweights = 'a'", r"viewer\.weights: .* belongs to \[segmenter\] or \[regressor\]$"),
        ("[link]\nname = 'a'", r"link\.name: .* belongs to the top of the file or \[gnss\] or \[encoder\]$"),
        ("[segmenter]\nring = 0", r"ring: must be at least 1 \(got 0\)"),
        ("[segmenter]\nviews_per_tuber = true", r"views_per_tuber: true and false are not allowed here .got true"),
        ("[cameras.front.realsense]\nlaser = true\nlaser_mw = true", r"laser_mw: true and false are not allowed here"),
        ('[cameras.front]\nwaits = "yes"', r"cameras\.front\.waits: must be true or false \(got 'yes'\)"),
        ("[aggregator]\nexit_when_final = 1", r"aggregator\.exit_when_final: must be true or false \(got 1\)"),
        ('[cameras.front]\nspeed = "1.0"', r"cameras\.front\.speed: must be a number \(got '1\.0'\)"),
        ('[segmenter]\nring = "4"', r"segmenter\.ring: must be a whole number \(got '4'\)"),
        ('[belt]\nresting_sd_mm = "1.5"', r"belt\.resting_sd_mm: must be a number \(got '1\.5'\)"),
        ('[belt]\ngauge = "bar"\ngauge_size_mm = [40, "30"]', r"gauge_size_mm: must be a number \(got \[40, '30'"),
        ('[belt]\ngauge = "bar"\ngauge_size_mm = [40, true]', r"belt\.gauge_size_mm: true and false are not allowed"),
        ('name = "two words"', "two words"),
        ("[belt]\nresting_offset_mm = 0.0055", r"belt.resting_offset_mm: .*cannot be known; 0.0055 m are 5.5 mm"),
        ("[cameras.front]\nbelt_distance_m = 345", r"belt_distance_m: must be at most 10 m \(got 345\)"),
        ("name = ", "is not TOML"),
        ('[regressor]\ndevice = "cuda"\nprecision = "bfloat16"', "a GPU weighs in float32 with all centroids"),
        ('[regressor]\ndevice = "cuda"\ncentroids = 32', 'device is "cuda" and centroids is 32'),
    ],
)
def test_a_fault_is_named_with_its_mend(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=said) as caught:
        load_config(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["link.listen", "cameras.front.ros_router"])
def test_every_endpoint_of_a_config_is_checked(text: str) -> None:
    """`certs make` ended with a traceback where `link.listen` named none."""
    section, _, key = text.rpartition(".")
    value: object = ["edge"] if key == "listen" else "edge"
    raw: dict[str, object] = {key: value}
    for name in reversed(section.split(".")):
        raw = {name: raw}
    with pytest.raises(ConfigError, match=rf"{text}[.0]*: 'edge' is no router's endpoint: write it like tcp/edge:7447"):
        parse_config(raw, where="test")


@pytest.mark.parametrize(
    "endpoint",
    [
        "tls/0.0.0.0:7447",
        "tcp/[::]:7447",
        "tcp/10.0.0.1:7447#iface=eth0",
        "udp/a.b:1?rel=0",
        "unixsock-stream//run/a.sock",
    ],
)
def test_what_zenoh_calls_an_endpoint_is_taken(endpoint: str) -> None:
    link = parse_config({"link": {"router": endpoint, "listen": [endpoint]}}, where="test").link
    assert (link.router, link.listen) == (endpoint, (endpoint,))


@pytest.mark.parametrize("source", ["realsense", "ros2"])
def test_a_device_takes_no_path(source: str) -> None:
    """`config check` said that it is fine; the camera said at its start that it is not."""
    with pytest.raises(ConfigError, match=rf"cameras.front: source '{source}' takes no path \(belt\)"):
        parse_config({"cameras": {"front": {"source": source, "path": "belt"}}}, where="test")


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (
            {"serial": "7"},
            "serial of source = 'realsense', but the source is 'recording': correct source, or remove it",
        ),
        ({"source": "realsense", "speed": 2.0}, "speed of source = 'recording', but the source is 'realsense'"),
        ({"source": "ros2", "window": 3, "camera": "a"}, "camera and window of source = 'recording', .* remove them$"),
        ({"source": "realsense", "topic": "/depth"}, "topic of source = 'ros2', but the source is 'realsense'"),
        ({"source": "realsense", "waits": False, "starts_at_s": 1.8e9}, "starts_at_s of source = 'recording', but"),
    ],
)
def test_a_key_of_another_source_is_refused(camera: dict[str, object], said: str) -> None:
    """Each was left out in silence, as a misspelt key never was."""
    with pytest.raises(ConfigError, match=rf"cameras\.front: {said}"):
        parse_config({"cameras": {"front": camera}}, where="test")


def test_what_holds_for_every_source_is_no_key_of_another_one() -> None:
    written = parse_config({"cameras": {"front": {"source": "realsense", "waits": False}}}, where="test")
    assert parse_config(tomllib.loads(dump_toml(written)), where="test") == written, "with every default in it"


def test_two_cameras_of_one_device_are_refused() -> None:
    """One of them gave frames, the other waited for its device for ever."""
    front = {"source": "realsense", "serial": "7", "belt_distance_m": 0.4}
    cameras = {"front": front, "rear": {**front, "across_m": 0.5}}
    with pytest.raises(ConfigError, match=r"cameras: cameras front, rear all have serial '7': a device gives its"):
        parse_config({"cameras": cameras}, where="test")
    cameras["rear"]["serial"] = "8"
    parse_config({"cameras": cameras}, where="test")
    for camera in cameras.values():
        del camera["serial"]
    parse_config({"cameras": cameras}, where="each on a computer of its own")


@pytest.mark.parametrize(
    ("router", "fix"),
    [
        ("edge", "tcp/edge:7447"),
        ("10.0.0.1:7447", "tcp/10.0.0.1:7447"),
        ("tcp/", "tcp/HOST:7447"),
        ("tcp/10.0.0.1", "tcp/HOST:7447"),
        ("tls/edge:99999", "tls/edge:7447"),
        ("tcp/[::1]:x", "tcp/[::1]:7447"),
        ("http://10.0.0.1:7447", "tcp/10.0.0.1:7447"),
        ("tpc/edge:7447", "tcp/edge:7447"),
        ("wss/edge:7447", "tcp/edge:7447"),
        ("tcp/edge:0", "tcp/edge:7447"),
    ],
)
def test_a_router_that_is_no_endpoint_is_refused_at_once(tmp_path: Path, router: str, fix: str) -> None:
    """`config check` said that it is fine, and `tuberline watch edge` ended in a traceback of Zenoh."""
    told = f"'{router}' is no router's endpoint: write it like {fix}"
    if router.partition("/")[0] in ("http:", "tpc", "wss"):
        told += "; protocols are tcp, tls, udp, quic, ws, unixsock-stream"
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, f'[link]\nrouter = "{router}"'))
    assert str(caught.value).splitlines()[1] == f"  link.router: {told}"
    for address in (LineAddress(connect=router).watched, LineAddress(connect=router).link):
        with pytest.raises(ConfigError) as caught:
            address()
        assert str(caught.value) == told


def test_two_devices_are_not_read_from_one_port() -> None:
    port = {"source": "serial:/dev/ttyACM0?baud=9600"}
    raw = {"gnss": port, "encoder": {"source": "serial:/dev/ttyACM0", "metres_per_pulse": 0.0005}}
    with pytest.raises(ConfigError, match=r"both /dev/ttyACM0: each needs its own port"):
        parse_config(raw, where="test")
    raw["encoder"]["source"] = "serial:/dev/ttyACM1"
    assert parse_config(raw, where="test").encoder is not None


def test_an_encoder_tells_the_cameras_of_today(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cameras = {
        "a": {"source": "realsense"},
        "b": {"path": "monday", "waits": False},
        "c": {"path": "monday", "waits": False, "starts_at_s": 1.8e9},
        "d": {"source": "ros2", "topic": "/depth"},
    }
    encoder = {"source": "simulated:", "metres_per_pulse": 0.0005}
    assert parse_config({"cameras": cameras, "encoder": encoder}, where="test").hears_encoder == ("a", "c", "d")
    assert parse_config({"cameras": cameras}, where="test").hears_encoder == ()
    file = tmp_path / "line.toml"
    file.write_text(dump_toml(parse_config({"cameras": {"b": cameras["b"]}, "encoder": encoder}, where="test")))
    check(file)
    told = capsys.readouterr()
    assert "warning: encoder: no camera of this line is live" in told.err
    assert told.out.startswith(f"{file} is accepted, with 2 warnings: line ")


@pytest.mark.parametrize("pose", [[], [[1, 0, 0, 0]], [[1, 0, 0]] * 4, [1, 2, 3, 4], [[1, 0, 0, 0]] * 5])
def test_a_pose_of_another_shape_is_one_fault(pose: list[object]) -> None:
    """It was one for each row that was missing: `belt_from_camera.1: is missing (got [[1, 0, 0, 0]])`."""
    with pytest.raises(ConfigError) as caught:
        parse_config({"cameras": {"front": {"belt_from_camera": pose}}}, where="test")
    told = str(caught.value).splitlines()
    assert len(told) == 2, told
    assert told[1].startswith("  cameras.front.belt_from_camera: must be four rows of four numbers, as `tuberline cal")


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, "[segmenter]\nring = 0\ncredit = 1\n[viewers]\n"))
    assert {"segmenter.ring", "segmenter.credit", "viewers"} <= {
        line.strip().split(":")[0] for line in str(caught.value).splitlines()[1:]
    }


def test_relative_paths_start_at_the_file(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, '[cameras.front]\npath = "rec"\n[aggregator]\nout = "/abs"'))
    assert config.camera("front").path == tmp_path / "rec"
    assert config.aggregator.out == Path("/abs")
    for given, meant in (("file:a/b.nmea", f"file:{tmp_path}/a/b.nmea"), ("file:/abs.nmea", "file:/abs.nmea")):
        gnss = load_config(write(tmp_path, f'[gnss]\nsource = "{given}"')).gnss
        assert gnss is not None
        assert gnss.source == meant, "it started where the process was started, which for a service is /"


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    """As some editors save it: it was refused as "Invalid statement (at line 1, column 1)"."""
    assert load_config(write(tmp_path, '\ufeffname = "left"')).name == "left"


def test_effective_config_reads_back_equal() -> None:
    config = parse_config(
        {"name": "x", "cameras": {"front": {"path": '/a "b"\\c', "speed": 0}}, "viewer": {"rrd": "/x.rrd"}}, where="t"
    )
    assert parse_config(tomllib.loads(dump_toml(config)), where="t") == config


def test_unknown_camera_lists_the_known() -> None:
    config = parse_config({"cameras": {"front": {}, "rear": {}}}, where="t")
    with pytest.raises(ConfigError, match=r"'left'.*front, rear"):
        config.camera("left")


def test_the_command_exits_2_with_one_clear_text(tmp_path: Path) -> None:
    path = write(tmp_path, "[segmenter]\nview_per_tuber = 3")
    done = subprocess.run(
        [sys.executable, "-m", "tuberline", "config", "check", str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "did you mean 'views_per_tuber'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_recording_that_is_not_here_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It may be on another computer of the line; `run` was the first to say so. The file was called fine beside it."""
    file = write(tmp_path, '[cameras.front]\npath = "gone.mcap"\n[cameras.rear]\npath = "."\n[cameras.side]')
    check(file)
    told = capsys.readouterr()
    assert told.out == f"{file} is accepted, with 2 warnings: line 'line', cameras front, rear, side\n"
    assert told.err == (
        f"warning: cameras.front.path: {tmp_path / 'gone.mcap'} is not on this computer\n"
        "warning: cameras.side has no path: a camera that replays a recording cannot start\n"
    )
    for here, verdict in (("", "is accepted, with 1 warning"), ('path = "."', "is fine")):
        check(write(tmp_path, f"[cameras.side]\n{here}"))
        assert capsys.readouterr().out == f"{file} {verdict}: line 'line', cameras side\n"


def test_a_ledger_s_folder_that_is_none_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(write(tmp_path, '[aggregator]\nout = "/dev/null"\n[cameras.front]\npath = "."'))
    told = capsys.readouterr()
    assert "is accepted, with 1 warning" in told.out
    assert told.err.startswith("warning: aggregator.out: /dev/null is no folder on this computer")


def test_a_segmenter_keeps_its_log_on_disk_where_its_file_names_no_folder(tmp_path: Path) -> None:
    """Without it a segmenter that was killed left 151 of 160 tubers, a load 60 % too heavy, and books that did not
    balance.
    """
    line = write(tmp_path, '[cameras.front]\npath = "rec"\n[aggregator]\nout = "runs/north"')
    assert load_config(line).segmenter.state_dir == tmp_path / "runs" / "north" / "state"
    stated = write(tmp_path, '[segmenter]\nstate_dir = "kept"\n[aggregator]\nout = "runs/north"')
    assert load_config(stated).segmenter.state_dir == tmp_path / "kept"


def test_a_tilde_is_home_in_every_section(tmp_path: Path) -> None:
    """Only a camera's path knew it: a ledger went to a folder named ~ beside the file."""
    line = load_config(write(tmp_path, '[cameras.front]\npath = "~/rec"\n[aggregator]\nout = "~/runs"'))
    assert (line.cameras["front"].path, line.aggregator.out) == (Path.home() / "rec", Path.home() / "runs")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[gnss]\nsource = "simulate:?row_m=70"', "gnss.source: 'simulate:.row_m=70' is no GNSS receiver; allowed are"),
        ('[gnss]\nsource = "tcp://10.0.0.9"', "allowed are serial:.*, tcp://host:port"),
        ('[gnss]\nsource = "gpsd://here:99999"', "gnss.source: .*allowed are"),
        ('[gnss]\nsource = "serial:/dev/ttyACM0?baud=fast"', "gnss.source: .*allowed are serial:/dev/ttyACM0.baud="),
        ('[aggregator]\nout = ""', 'aggregator.out: "" names no file and no folder: give a path, or leave the key out'),
        ('[cameras.front]\npath = ""', "cameras.front.path: .*no file and no folder"),
        ('[cameras.front]\npath = "~no one/rec"', "front.path: .*no home is known for '~no one': write the whole path"),
        ("[access]\nenabled = true", "config .*line.toml: access.enabled needs an endpoint with certificates"),
    ],
)
def test_what_every_machine_of_the_line_can_tell_is_refused(tmp_path: Path, text: str, said: str) -> None:
    """`config check` said that it is fine; a receiver gave up with its line, a router with all."""
    with pytest.raises(ConfigError, match=said):
        check(write(tmp_path, text))


@pytest.mark.parametrize(
    "source",
    ["serial:/dev/ttyACM0", "serial:/dev/a?baud=115200", "tcp://a:1", "gpsd://a", "gpsd://[::1]:7", "simulated:"],
)
def test_receivers_that_there_are_are_taken(source: str) -> None:
    gnss = parse_config({"gnss": {"source": source}}, where="test").gnss
    assert gnss is not None
    assert gnss.source == source


def test_the_folder_of_the_file_may_be_named(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, '[aggregator]\nout = "."')).aggregator.out == tmp_path
