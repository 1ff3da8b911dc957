"""A line of containers from compose.site.yaml: certificates, access rules, a network namespace each; all get killed.

The compose file's own settings are used (deploy/trial/compose.py). Different are: the camera replays a recording
instead of asking a RealSense, encoder and receiver are simulated, and what waits for a person in a live line waits for
it as a replay does.
Everything runs in a network namespace made for it, so that no port and no rule of this machine is touched.
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from aggregator.ledger.export import canonical_lines
from aggregator.ledger.reader import reading, the_run
from conveyor.errors import TuberlineError
from deploy.trial.compose import command_of, podman_words, services
from deploy.trial.engine import GATEWAY, LIMITS, SPACE, Engine
from deploy.trial.field import DEVICES
from deploy.trial.tools import ROOT, TrialError, say, table, until

ORDER = (
    *("router", "aggregator", "regressor", "segmenter-left", "camera-left", "metrics", "page", "viewer"),
    *("encoder", "gnss", "alarms"),
)
IMAGE = {
    "tuberline-edge:local": "edge",
    "tuberline:local": "node",
    "tuberline-camera:local": "camera",
    "tuberline-alarms:local": "alarms",
    "tuberline-viewer:local": "viewer",
}
"""The image that a service names, as the target that it is built from."""
UID = 10001
WATCH = ("metrics", "page", "viewer", "encoder", "gnss", "alarms")
"""Whether the line still counts when they are killed does not matter: a recording brings its own travel."""
RECORDING = ("--seed", "1607", "--tubers", "60", "--scene", "singulated", "--fps", "10", "--speed-mps", "0.1")
"""A minute of belt, so that the line is counting while it is hurt."""
AS_A_REPLAY = {
    'source = "realsense"': 'path = "/recordings/belt"\nspeed = 1.0',
    "belt_distance_m = 0.46\n": "",  # the recording says its own
    "[segmenter]": "[segmenter]\nweigh_deadline_s = 600.0",
    "[aggregator]": "[aggregator]\ncamera_stall_s = 600.0",
}
TOKEN = "a-token-of-this-trial"
HOOK = f"http://{GATEWAY}:9190/alarms"
ALARMS = f"""
[alarms]
channels = ["{HOOK}"]
after_s = 1.0
"""
"""In the line's file; what is killed is away for some seconds at most."""
RECEIVER = """
import http.server, json
class Hook(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["content-length"])))
        print(body["event"], body["key"], flush=True)
        self.send_response(204)
        self.end_headers()
    def log_message(self, *words):
        pass
http.server.ThreadingHTTPServer(("", 9190), Hook).serve_forever()
"""
ORDER_TO_PAGE = """
import sys, urllib.error, urllib.request
asked = urllib.request.Request("http://127.0.0.1:9180/order", b"{}", {"x-tuberline-token": sys.argv[1]})
try:
    urllib.request.urlopen(asked)
except urllib.error.HTTPError as error:
    print(error.code)
"""
Named = Callable[[str], str]


class Line:
    """The services of the site's compose file as containers; `project` keeps one line's volumes from another's."""

    def __init__(self, engine: Engine, name_of: Named, folder: Path, project: str) -> None:
        self._engine, self._name_of, self._project = engine, name_of, project
        self._site = folder / "site.toml"
        variables = {"RUN": project, "CERTS": str(folder / "certs"), "PAGE_TOKEN": str(folder / "page-token")}
        self.services = services(ROOT / "deploy/docker/compose.site.yaml", variables)
        for service in self.services.values():
            # The harvester's services ask the site's name server; here there is none. Old podman lacks host-gateway.
            hosts = service.get("extra_hosts", ["edge.field.internal:host-gateway"])
            service["extra_hosts"] = [host.replace("host-gateway", GATEWAY) for host in hosts]
        camera = self.services["camera-left"]
        for live in ("device_cgroup_rules", "group_add"):
            del camera[live]
        shared = [volume for volume in camera["volumes"] if volume != "/dev:/dev"]
        camera["volumes"] = [*shared, f"{folder / 'recordings'}:/recordings:ro"]

    def up(self) -> dict[str, float]:
        """Start all, the camera last, so that the load begins when the line is there; seconds until each was well."""
        camera = "camera-left"
        return {service: self._start(service) for service in [*(name for name in ORDER if name != camera), camera]}

    def _start(self, name: str) -> float:
        service = self.services[name]
        entrypoint, words = command_of(service)
        start = monotonic()
        self._engine.podman(
            *("run", "--detach", "--name", self._container(name), "--network", SPACE),
            *podman_words(service, configs={"line": self._site}, project=self._project),
            *LIMITS,
            *(*entrypoint, self._name_of(IMAGE[service["image"]]), *words),
        )
        if "healthcheck" in service and name != "camera-left":
            until(lambda: self.well(name), f"{name} well")
        return monotonic() - start

    def _container(self, name: str) -> str:
        return f"{self._project}-{name}"

    def well(self, name: str) -> bool:
        """What the service's own health check says, as an engine would ask it."""
        return self._engine.podman("healthcheck", "run", self._container(name), check=False).returncode == 0

    def kill(self, name: str) -> float:
        """SIGKILL the container's first process from outside; seconds until its restart policy had it well again."""
        pid, count = self._state(name)
        os.kill(pid, signal.SIGKILL)
        start = monotonic()
        until(lambda: self._state(name)[1] > count and self._state(name)[0] > 0, f"{name} back")
        if "healthcheck" in self.services[name]:
            until(lambda: self.well(name), f"{name} well again")
        return monotonic() - start

    def _state(self, name: str) -> tuple[int, int]:
        form = "{{.State.Pid}} {{.RestartCount}}"
        said = self._engine.podman("inspect", "--format", form, self._container(name), check=False).stdout.split()
        return (int(said[0]), int(said[1])) if len(said) == 2 else (0, 0)

    def page_takes_orders(self) -> None:
        """The page has the token of its secret: it refuses another one, and with the right one reads the order."""
        for token, wanted in (("another-token-of-no-one", "401"), (TOKEN, "400")):
            words = (self._container("page"), "python", "-c", ORDER_TO_PAGE, token)
            said = self._engine.podman("exec", *words, check=False).stdout.strip()
            if said != wanted:
                raise TrialError(f"an empty order with the token '{token}' was answered by '{said}', not {wanted}")

    def picture_mb(self) -> float:
        """What the viewer has drawn into its volume."""
        return sum(file.stat().st_size for file in self._volume("pictures").glob("*.rrd")) / 1e6

    def _volume(self, name: str) -> Path:
        words = ("volume", "inspect", "--format", "{{.Mountpoint}}", f"{self._project}-{name}")
        return Path(self._engine.podman(*words).stdout.strip())

    def ledger(self) -> Path:
        return self._volume("ledger") / "ledger" / "ledger.db"

    def counted(self) -> bool:
        """The run in the ledger is finished."""
        try:
            with reading(self.ledger()) as view:
                return the_run(view, self.ledger(), None).finished
        except (TuberlineError, OSError, sqlite3.Error):
            return False

    def canonical(self) -> list[str]:
        with reading(self.ledger()) as view:
            return list(canonical_lines(view, the_run(view, self.ledger(), None)))

    def down(self) -> None:
        for name in reversed(ORDER):
            self._engine.podman("rm", "--force", "--time", "5", self._container(name), check=False)


def trial(engine: Engine, name_of: Named, shut: Sequence[str]) -> str:
    """Run the line calm and run it with every container killed; the table of both. Raises where a ledger differs."""
    folder = engine.folder / "site"
    shutil.rmtree(folder, ignore_errors=True)
    prepare(engine, name_of, folder, shut)
    reference = replayed(engine, name_of, folder, shut)
    engine.within_own_network()
    try:
        rows = [calm(Line(engine, name_of, folder, "calm"), reference)]
        with engine.start_within(sys.executable, "-c", RECEIVER) as hook:
            try:
                rows.append(shaken(Line(engine, name_of, folder, "shaken"), reference))
            finally:
                hook.terminate()
            tell_alarms(hook.communicate()[0])
    finally:
        engine.leave_own_network()
    return table(("seconds until", *ORDER, "ledger"), rows)


def calm(line: Line, reference: list[str]) -> tuple[object, ...]:
    """Start everything, let it count: the table's row."""
    well = line.up()
    line.page_takes_orders()
    took = until(line.counted, "the calm line")
    compare("calm line", line.canonical(), reference)
    if not line.picture_mb():
        raise TrialError("the viewer has drawn nothing")
    say(
        f"containers: calm line counted in {took:.0f} s, ledger as the replay's, {line.picture_mb():.0f} MB of pictures"
    )
    line.down()
    return ("all well after start", *(f"{well[name]:.1f}" for name in ORDER), "same")


def shaken(line: Line, reference: list[str]) -> tuple[object, ...]:
    """Kill each container, those that count while they do."""
    line.up()
    back = {}
    for name in ORDER:
        if name not in WATCH and line.counted():
            raise TrialError(f"the load was over before {name} was killed: it needs a longer recording")
        back[name] = line.kill(name)
        say(f"containers: {name} killed, well again after {back[name]:.1f} s")
    until(line.counted, "the shaken line")
    compare("shaken line", line.canonical(), reference)
    say("containers: each killed once, ledger as the replay's")
    line.down()
    return ("well again after SIGKILL", *(f"{back[name]:.1f}" for name in ORDER), "same")


def tell_alarms(said: str) -> None:
    """What the line's alarms sent while its containers were killed."""
    begun = [line.partition(" ")[2] for line in said.splitlines() if line.startswith("begin ")]
    if not begun:
        raise TrialError(f"containers were killed and no alarm came to {HOOK}: {said[:300]}")
    say(f"containers: {len(begun)} alarms came: {', '.join(sorted(set(begun)))}")


def compare(what: str, found: list[str], wanted: list[str]) -> None:
    if found != wanted:
        pair = next(((a, b) for a, b in zip(found, wanted, strict=False) if a != b), (len(found), len(wanted)))
        raise TrialError(f"{what}: its ledger differs from the replay's: {pair[0]} / {pair[1]}")


def prepare(engine: Engine, name_of: Named, folder: Path, shut: Sequence[str]) -> None:
    """Certificates, config and recording, made with the images themselves."""
    for name in ("certs", "recordings", "reference"):
        (folder / name).mkdir(parents=True)
        os.chown(folder / name, UID, UID)
    text = (ROOT / "deploy/docker/site.toml").read_text(encoding="utf-8")
    for old, new in AS_A_REPLAY.items():
        text = text.replace(old, new)
    (folder / "site.toml").write_text(text + DEVICES + ALARMS, encoding="utf-8")
    (folder / "page-token").write_text(TOKEN, encoding="utf-8")
    (folder / "page-token").chmod(0o400)
    os.chown(folder / "page-token", UID, UID)
    made: tuple[tuple[str, Any], ...] = (
        ("edge", ("certs", "make", "/site/site.toml", "--out", "/site/certs/made")),
        ("edge", ("simulate", "--out", "/site/recordings/belt", *RECORDING)),
    )
    for target, words in made:
        engine.podman("run", "--rm", *shut, f"--volume={folder}:/site", "--network=none", name_of(target), *words)
    for file in (folder / "certs/made").iterdir():
        shutil.move(file, folder / "certs")


def replayed(engine: Engine, name_of: Named, folder: Path, shut: Sequence[str]) -> list[str]:
    """The canonical ledger of `tuberline replay` of the same recording, in one container.

    A recording calls its camera front, the compose file calls it left.
    """
    words = ("replay", "/site/recordings/belt", "--out", "/site/reference/run")
    mounted = ("run", "--rm", *shut, f"--volume={folder}:/site", "--network=none")
    engine.podman(*mounted, name_of("node"), *words)
    path = folder / "reference/run/ledger.db"
    with reading(path) as view:
        return [line.replace('"front', '"left') for line in canonical_lines(view, the_run(view, path, None))]
