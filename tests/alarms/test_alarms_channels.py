"""Channels against what they talk to in life: an HTTP server, mosquitto, apprise."""

from __future__ import annotations

import base64
import json
import queue
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from conveyor.config import parse_config
from conveyor.config_alarms import AlarmsConfig
from conveyor.errors import ConfigError
from tests.alarms.alarm_words import message, receiving
from tests.conftest import wait_until
from tuberline.alarms.channels import Address, Channel, ChannelError, RefusedError, open_channels, tls_context
from tuberline.alarms.machine import AlarmMachine, Timing
from tuberline.alarms.outbox import Outbox
from tuberline.alarms.sender import Sender
from tuberline.alarms.webhook import Webhook

PASSWORD = "moss, quite secret"


def channels(folder: Path, *urls: str) -> tuple[Channel, ...]:
    """Channels from a file that only its owner reads."""
    file = folder / "alarms.txt"
    file.write_text("# where alarms go\n" + "\n".join(urls) + "\n")
    file.chmod(0o600)
    return open_channels(AlarmsConfig(channels_file=file))


def test_a_webhook_gets_a_json_post_with_the_message_id(tmp_path: Path) -> None:
    """An umlaut in the address ended the process at the first alarm, and again at each start."""
    with receiving() as server:
        (hook,) = channels(tmp_path, server.url.replace("//", "//harvester:p%40ss@") + "/Höfe 1?an=Büro%20a")
        hook.send(message(1), lost_before=2)
        (taken,) = server.taken
        assert server.paths == ["/alarms/H%C3%B6fe%201?an=B%C3%BCro%20a"]
        (headers,) = server.asked
    assert taken["id"] == headers["Idempotency-Key"] == "box-1-begin"
    assert (taken["event"], taken["lost_before"], taken["fix"]) == ("begin", 2, "Repair it.")
    assert headers["Content-Type"] == "application/json"
    assert base64.b64decode(headers["Authorization"].removeprefix("Basic ")) == b"harvester:p@ss"
    assert "p@ss" not in hook.shown
    assert "p%40ss" not in hook.shown


@pytest.mark.parametrize(
    ("answer", "kind"), [(302, ChannelError), (404, ChannelError), (503, ChannelError), (422, RefusedError)]
)
def test_an_answer_that_is_no_yes_is_an_error(answer: int, kind: type[Exception], tmp_path: Path) -> None:
    with receiving() as server:
        server.answer = answer
        (hook,) = channels(tmp_path, server.url)
        with pytest.raises(ChannelError, match=str(answer)) as caught:
            hook.send(message(1), lost_before=0)
        assert type(caught.value) is kind
        assert server.taken == []
        assert len(server.asked) == 1


@contextmanager
def dripping(at_once: bytes) -> Iterator[str]:
    """A server that answers `at_once` and then a byte every 50 ms, for as long as it is listened to: its address."""
    left = threading.Event()

    def serve() -> None:
        with suppress(OSError):
            asker, _ = server.accept()
            with asker:
                asker.sendall(at_once)
                while not left.wait(0.05):
                    asker.sendall(b"x")
        left.set()

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/alarms"
        assert left.wait(10), "the link was not closed"


@pytest.mark.parametrize("at_once", [b"", b"HTTP/1.1 503 Busy\r\nX-Wait: ", b"HTTP/1.1 200 OK\r\nX-Wait: "])
def test_an_answer_that_drips_is_not_waited_for(at_once: bytes, tmp_path: Path) -> None:
    """Each byte came within the time limit, so the sender waited for as long as they came. A 200 is a yes by then."""
    with dripping(at_once) as url:
        hook = Webhook(Address(url), tls_context(None), within_s=1.5)
        begun_s = time.monotonic()
        if b"200" in at_once:
            hook.send(message(1), lost_before=0)
        else:
            with pytest.raises(ChannelError, match="503" if at_once else r"it does not answer within 1\.5 s"):
                hook.send(message(1), lost_before=0)
        assert time.monotonic() - begun_s < 5


def test_what_waits_arrives_in_order_once_the_network_is_back(tmp_path: Path) -> None:
    """No server, then one that answers 503, then one that refuses one message for good."""
    with receiving() as server:
        port = server.port
    (hook,) = channels(tmp_path, f"http://127.0.0.1:{port}/alarms")
    with Outbox(tmp_path, channels=[hook.id], keep=10) as box:
        lives = AlarmMachine("north", Timing(), "box")
        box.put([message(n) for n in range(13)], lives, now_s=0, unix_s=1.8e9)
        sender = Sender(hook, box, first_wait_s=0.05)
        assert not sender.send_next()
        assert box.waiting(hook.id) == 10
        with receiving(port) as server:
            server.answer = 503
            sender.start()
            wait_until(lambda: server.asked, what="a try")
            assert box.waiting(hook.id) == 10
            server.answer = 422
            wait_until(lambda: box.waiting(hook.id) < 10, what="a message refused for good")
            server.answer = 200
            wait_until(lambda: not box.waiting(hook.id), what="an empty outbox")
            ids = [taken["id"] for taken in server.taken]
            losses = [taken["lost_before"] for taken in server.taken]
        sender.stop()
        sender.join(5)
    assert ids == [f"box-{n}-begin" for n in range(13 - len(ids), 13)]
    assert losses == [3] + [0] * (len(ids) - 1)


def test_an_error_that_no_channel_knows_ends_no_channel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine that had no thread left for a moment the channel's own ended, and none of its alarms left again."""
    plain, tries = threading.Timer.start, list[int]()

    def no_thread(timer: threading.Timer) -> None:
        tries.append(1)
        if len(tries) == 1:
            raise RuntimeError("can't start new thread")
        plain(timer)

    monkeypatch.setattr(threading.Timer, "start", no_thread)
    with receiving() as server:
        (hook,) = channels(tmp_path, f"http://127.0.0.1:{server.port}/alarms")
        with Outbox(tmp_path, channels=[hook.id], keep=10) as box:
            box.put([message(1)], AlarmMachine("north", Timing(), "box"), now_s=0, unix_s=1.8e9)
            sender = Sender(hook, box, first_wait_s=0.05)
            sender.start()
            wait_until(lambda: not box.waiting(hook.id), what="an empty outbox")
            sender.stop()
            sender.join(5)
        assert [taken["id"] for taken in server.taken] == ["box-1-begin"]
    assert len(tries) == 2


@pytest.fixture
def broker(tmp_path: Path, free_port: int) -> Iterator[int]:
    """A real mosquitto with a password; its port."""
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
    keys = shutil.which("mosquitto_passwd")
    if program is None or keys is None:
        pytest.skip("mosquitto is not installed (apt install mosquitto): MQTT is not tested here")
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed: MQTT is not tested here")
    passwords = tmp_path / "passwords"
    subprocess.run([keys, "-b", "-c", str(passwords), "north", PASSWORD], check=True, capture_output=True)
    passwords.chmod(0o644)
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {free_port} 127.0.0.1\nallow_anonymous false\npassword_file {passwords}\nuser root\n")
    process = subprocess.Popen([program, "-c", str(config)], stderr=subprocess.DEVNULL)
    yield free_port
    process.terminate()
    process.wait(30)


def test_mqtt_arrives_at_a_real_broker_and_a_wrong_password_is_told(broker: int, tmp_path: Path) -> None:
    from paho.mqtt import client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    secret = PASSWORD.replace(" ", "%20").replace(",", "%2C")
    (channel,) = channels(tmp_path, f"mqtt://north:{secret}@127.0.0.1:{broker}/farm/north/alarms")
    arrived: queue.Queue[Any] = queue.Queue()
    ready: queue.Queue[bool] = queue.Queue()
    listener = mqtt.Client(CallbackAPIVersion.VERSION2)
    listener.username_pw_set("north", PASSWORD)
    listener.on_connect = lambda client, *_: client.subscribe("farm/north/alarms", qos=1)
    listener.on_subscribe = lambda *_: ready.put(True)
    listener.on_message = lambda _client, _data, sample: arrived.put(sample)
    wait_until(lambda: connected(listener, broker), what="mosquitto")
    listener.loop_start()
    try:
        assert ready.get(timeout=60)
        channel.send(message(1), lost_before=0)
        channel.send(message(1, event="end"), lost_before=4)
        begin, end = (arrived.get(timeout=60) for _ in range(2))
    finally:
        listener.disconnect()
        listener.loop_stop()
    assert [json.loads(s.payload)["id"] for s in (begin, end)] == ["box-1-begin", "box-1-end"]
    assert json.loads(end.payload)["lost_before"] == 4
    assert begin.qos == 1
    (wrong,) = channels(tmp_path, f"mqtt://north:wrong@127.0.0.1:{broker}/farm/north/alarms")
    with pytest.raises(ChannelError, match="refuses") as caught:
        wrong.send(message(2), lost_before=0)
    assert "wrong" not in wrong.shown

    assert caught.value.lasting, "a wrong password stays wrong"


def connected(client: Any, port: int) -> bool:
    """A connection to the broker on `port`."""
    try:
        client.connect("127.0.0.1", port)
    except OSError:
        return False
    return True


def test_mqtt_without_a_broker_is_an_error_within_its_time(free_port: int, tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed: MQTT is not tested here")
    (channel,) = channels(tmp_path, f"mqtt://127.0.0.1:{free_port}/alarms")
    begun = time.monotonic()
    with pytest.raises(ChannelError):
        channel.send(message(1), lost_before=0)
    assert time.monotonic() - begun < 30


def test_apprise_delivers_title_and_what_to_do(tmp_path: Path) -> None:
    pytest.importorskip("apprise", reason="apprise is not installed: its channels are not tested here")
    with receiving() as server:
        (service,) = channels(tmp_path, f"json://127.0.0.1:{server.port}/x")
        service.send(message(1), lost_before=0)
        service.send(message(1, event="end"), lost_before=2)
        begin, end = server.taken
        assert (begin["title"], begin["type"]) == ("north: Alarm 1.", "failure")
        assert "Repair it." in begin["message"]
        assert end["type"] == "success"
        assert "2 older messages were given up" in end["message"]
        server.answer = 500
        with pytest.raises(ChannelError):
            service.send(message(2), lost_before=0)
    assert service.shown == "json://..."


@pytest.mark.parametrize("url", ["tgram://123:secret/456", "https://user:secret@host/x", "mailto://a:b@c.d"])
def test_a_secret_in_the_lines_file_is_refused(url: str) -> None:
    with pytest.raises(ConfigError, match=r"channels_file"):
        parse_config({"alarms": {"channels": [url]}}, where="line.toml")


def test_addresses_that_cannot_be_used_are_refused_without_being_shown(tmp_path: Path) -> None:
    for url, words in (
        ("nobody://secret", "apprise"),
        ("mqtt://host", "topic"),
        ("mqtt://host/a/#", "topic"),
        ("http:///path", "no host"),
        ("http://host:99999/", "port"),
        ("https://a..secret/", "host's name"),
        ("http://user:secret", "port a number"),
    ):
        pytest.importorskip("apprise", reason="apprise is not installed: its channels are not tested here")
        with pytest.raises(ConfigError, match=r"(?i)" + words) as caught:
            channels(tmp_path, url)
        assert "secret" not in str(caught.value)
    with pytest.raises(ConfigError, match="twice"):
        channels(tmp_path, "http://host/a", "http://host/a")
    with pytest.raises(ConfigError, match="1 to 16"):
        channels(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        open_channels(AlarmsConfig(channels_file=tmp_path / "none.txt"))
    with pytest.raises(ConfigError, match="where alarms go"):
        parse_config({"alarms": {}}, where="line.toml")
