"""The commands: what they refuse, and that `watch` really shows a line."""

from __future__ import annotations

import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import viewer_line as line
from test_viewer_file import values

from conveyor import topics
from conveyor.delivery import KeptPublisher, LatestPublisher, ReliablePublisher
from conveyor.observer import Observer

CALL_WATCH = """
import sys
from tuberline.cli.viewer import watch
watch(sys.argv[1], profile="full", web=True, hub_port=int(sys.argv[2]), page_port=int(sys.argv[3]))
"""


def refused(tmp_path: Path, *options: str, python: tuple[str, ...] = ("-m", "tuberline")) -> str:
    """What `tuberline viewer` says on stderr before it exits with 2."""
    config = tmp_path / "line.toml"
    config.write_text(f'[link]\nrouter = "tcp/127.0.0.1:{line.free_port()}"\nconnect_timeout_s = 0.2\n')
    command = [sys.executable, *python, "viewer", "--config", str(config), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2, done.stderr
    return done.stderr


def test_without_rerun_the_error_is_the_command_that_mends_it(tmp_path: Path) -> None:
    hidden = "import sys; sys.modules['rerun'] = None; from tuberline.cli import main; main()"
    assert ".venv/bin/pip install -e '.[viewer]'" in refused(tmp_path, "--rrd", "x.rrd", python=("-c", hidden))


def test_nothing_to_show_it_in_is_refused_with_what_to_give(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    text = refused(tmp_path)
    assert "--rrd FILE" in text
    assert "--connect URL" in text


@pytest.mark.parametrize("url", ["http://127.0.0.1:9876", "127.0.0.1:9876", "rerun+http://127.0.0.1:notaport/proxy"])
def test_a_url_that_is_no_hub_is_refused_with_the_form_of_one(url: str) -> None:
    pytest.importorskip("rerun")
    from conveyor.errors import ConfigError
    from viewer.node import Target

    with pytest.raises(ConfigError, match=r"rerun\+http://HOST:9876/proxy") as refusal:
        Target(rrd=None, rrd_limit_bytes=0, connect=url).check()
    assert url in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "is empty: write a token of 16 to 256 ASCII characters into it"),
        (" \n", "is empty: write a token"),
        ("short", "holds 5 characters; give 16 to 256 ASCII ones"),
    ],
)
def test_a_file_without_a_token_is_refused(content: str, told: str, tmp_path: Path) -> None:
    """With an empty one the page only looked, without a word; containers give the null device for that."""
    from conveyor.errors import ConfigError
    from tuberline.cli.page import _token

    (file := tmp_path / "token").write_text(content)
    with pytest.raises(ConfigError, match=told) as refusal:
        _token(file)
    assert str(refusal.value).startswith(f"--token-file {file} ")
    file.write_text("a-token-of-this-test\n")
    assert _token(file) == "a-token-of-this-test"
    assert _token(Path("/dev/null")) == ""


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    from conveyor.errors import ConfigError
    from viewer.node import Target

    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        Target(rrd=tmp_path / "file" / "load.rrd", rrd_limit_bytes=0, connect=None).check()


def test_watch_without_a_line_is_refused() -> None:
    from conveyor.errors import ConfigError
    from tuberline.cli.viewer import watch

    with pytest.raises(ConfigError, match="--config"):
        watch()


def test_watch_is_the_viewer_whose_certificate_is_here(tmp_path: Path) -> None:
    """Where [access] names its viewers nothing could watch: it asked for the certificate of viewer/watch-laptop-12806,
    a name that was another one at each start.
    """
    from conveyor.errors import ConfigError
    from tuberline.cli.viewer import name_here, watch

    def certificate(stem: str) -> None:
        for suffix in ("pem", "key"):
            (tmp_path / f"{stem}.{suffix}").touch()

    (tmp_path / "office.toml").write_text(f'name = "north"\n[link]\ncerts = "{tmp_path}"\n')
    with pytest.raises(ConfigError, match=r"none is there; .*viewer\.office\.pem"):
        watch("tls/127.0.0.1:7447", config=tmp_path / "office.toml")
    certificate("viewer.office")
    assert name_here(tmp_path) == "office"
    certificate("viewer.cab")
    with pytest.raises(ConfigError, match="those of cab, office are there"):
        watch("tls/127.0.0.1:7447", config=tmp_path / "office.toml")
    certificate("viewer")
    assert name_here(tmp_path).startswith("watch-")
    assert name_here(None).startswith("watch-")


@pytest.mark.graph
def test_watch_serves_a_page_on_this_machine_and_feeds_its_hub(tmp_path: Path) -> None:
    """The page answers, and what the hub hands to a second reader is what the line said."""
    pytest.importorskip("rerun")
    from viewer.rerun.launch import native_program

    tubers = line.potatoes(3, seed=31)
    hub, page = line.free_port(), line.free_port()
    with line.router() as link, Observer(link, line="line") as node:
        command = [sys.executable, "-c", CALL_WATCH, link.router, str(hub), str(page)]
        watching = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        frames = LatestPublisher(node, topics.FRAME, camera="front")
        info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
        counted = ReliablePublisher(node, topics.TUBER)
        info.put(line.camera_info())
        line.within(30, lambda: frames.has_listener, "watch subscribes to frames")
        frames.put(line.frame(0, tubers))
        for tuber in tubers:
            counted.put(line.counted(tuber))
        line.within(15, lambda: sent(node) > 10, "the hub is fed")
        with urllib.request.urlopen(f"http://127.0.0.1:{page}/", timeout=30) as answer:
            assert answer.status == 200
        copy = tmp_path / "copy.rrd"
        url = f"rerun+http://127.0.0.1:{hub}/proxy"
        reader = subprocess.Popen(
            [str(native_program()), "--save", str(copy), "--bind", "127.0.0.1", "--port", str(line.free_port()), url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        line.within(15, lambda: copy.exists() and len(weights(copy)) == 3, "the hub hands the weights on")
        reader.terminate()
        reader.wait(30)
        assert sorted(weights(copy)) == pytest.approx(sorted(t.weight_g for t in tubers))
        watching.send_signal(signal.SIGTERM)
        _, said = watching.communicate(timeout=60)
        assert watching.returncode == 0, said
        assert f"open http://127.0.0.1:{page}/?theme=dark&url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{hub}%2Fproxy" in said
        with pytest.raises(OSError):
            urllib.request.urlopen(f"http://127.0.0.1:{page}/", timeout=2)


def sent(node: Observer) -> int:
    """Entries that the watching viewer handed to its hub."""
    return sum(report.values.get("hub_sent", 0) for name, report in node.nodes().items() if "/watch-" in name)


def weights(path: Path) -> list[float]:
    """Weights in a file that is still being written."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return values(path, "/tuber/weight_g", "Scalars:scalars")
        except (ValueError, OSError, RuntimeError):
            return []


@pytest.mark.graph
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits a file's size from outside: Linux only")
def test_a_full_disk_ends_the_file_and_not_the_viewer(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    import resource

    rrd = tmp_path / "load.rrd"
    rrd.write_bytes(b"earlier")
    with line.router() as link, line.viewer(link, tmp_path, "--rrd", str(rrd), "--profile", "full") as watcher:
        line.within(
            10,
            lambda: [p.read_bytes() for p in tmp_path.glob("load-until-*.rrd")] == [b"earlier"],
            "an earlier file is kept",
        )
        resource.prlimit(watcher.process.pid, resource.RLIMIT_FSIZE, (100_000, 100_000))
        node = watcher.observer
        info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
        info.put(line.camera_info())
        frames = LatestPublisher(node, topics.FRAME, camera="front")
        line.within(10, lambda: frames.has_listener, "the viewer subscribes to frames")
        seq = iter(range(10_000))

        def failed() -> bool:
            frames.put(line.frame(next(seq), []))
            return watcher.counter("file_dropped_failed") > 10

        line.within(20, failed, "what the file does not take is counted")
        line.within(10, lambda: watcher.settled("file"), "every entry is accounted for")
        assert watcher.counter("frame_shown") > 5
        watcher.stop()
