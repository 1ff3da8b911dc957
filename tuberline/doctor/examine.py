"""All findings of the doctor: the machine's, the configuration's, the cameras' and the running line's."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from conveyor import __version__
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.endpoints import host_and_port
from conveyor.errors import InputError, TuberlineError
from conveyor.files import told
from conveyor.lines import seen_beside
from conveyor.messages import Counters
from conveyor.observer import Observer
from tuberline.doctor.finding import Finding, fault, ok, warning
from tuberline.doctor.places import check_agreement, check_exchanged, check_places

LISTEN_S = 2.5
LOOK_AT_FRAMES = 5


@dataclass(slots=True)
class Live:
    """What was heard of the running line; `unreachable` says why nothing was."""

    nodes: dict[str, Counters] = field(default_factory=dict)
    alive: set[str] = field(default_factory=set)
    lines: dict[str, set[str]] = field(default_factory=dict)
    clocks_s: dict[str, float] = field(default_factory=dict)
    totals: dict[str, Any] | None = None
    weights: list[Finding] = field(default_factory=list)
    unreachable: str = ""


def look(config: LineConfig, *, listen_s: float = LISTEN_S) -> Live:
    """Listen to the line for a moment."""
    from tuberline.doctor.line import ClockWatch

    link = config.link.model_copy(update={"connect_timeout_s": 3.0})
    try:
        with Observer(link, line=config.name) as observer:
            clocks = ClockWatch(observer)
            time.sleep(listen_s)
            totals, alive = observer.totals(), observer.alive()
            return Live(
                nodes=observer.nodes(),
                alive=alive,
                lines=seen_beside(observer.session, config.name, alive),
                clocks_s=clocks.offsets_s(),
                totals=asdict(totals) if totals else None,
                weights=_running_weights(observer),
            )
    except TuberlineError as error:
        return Live(unreachable=str(error))


def examine(
    config: LineConfig,
    *,
    offline: bool = False,
    live: Live | None = None,
    on_work: Callable[[str, int, int | None], None] = lambda words, done, of: None,
) -> list[Finding]:
    """All findings, the machine's first. `on_work` is told what is looked at, how much is done, and of how much."""
    from tuberline.doctor import link, machine
    from tuberline.doctor.gpu import check_gpu
    from tuberline.doctor.weights import check_tickets

    on_work("looking at this machine", 0, 4)
    findings = machine.check_disk(config.aggregator.out, what="the ledger")
    if config.segmenter.state_dir:
        findings += machine.check_disk(config.segmenter.state_dir, what="the camera log")
    now = datetime.now(UTC)
    findings += machine.check_clock(config.aggregator.out, now_s=now.timestamp())
    findings += machine.check_processors(config) + machine.check_locked_memory() + machine.check_usb(config)
    findings += check_places(config) + link.check_certificates(config, now=now)
    on_work("weighing the reference clouds", 1, 4)
    findings += _weights(config) + check_tickets(config) + check_gpu(config)
    on_work("listening to the line", 2, 4)
    heard = Live() if offline else live or look(config)
    on_work("looking through the cameras", 3, 4)
    findings += _cameras(config, heard)
    if not offline:
        port = link.check_port(config.link)
        findings += port + (link.no_router(config.link, port, heard.unreachable) or _running(config, heard))
    return findings


def _running(config: LineConfig, live: Live) -> list[Finding]:
    from tuberline.doctor.alarms import check_alarms
    from tuberline.doctor.belt import check_running_belts
    from tuberline.doctor.depth import check_running_noise, trained_range
    from tuberline.doctor.encoder import check_encoder
    from tuberline.doctor.line import check_clocks, check_name, check_nodes, check_versions

    named = check_name(config.name, live.lines)
    if not live.alive and not live.nodes:
        return [
            fault(
                "nodes",
                f"no process of line '{config.name}' is running",
                "start it: `tuberline run` or its systemd target",
            ),
            *named,
        ]
    return [
        *named,
        *check_nodes(config, live.nodes, alive=live.alive),
        *check_running_belts(config, live.nodes, alive=live.alive),
        *check_encoder(config, live.nodes, alive=live.alive),
        *check_agreement(live.totals),
        *check_exchanged(live.totals),
        *check_running_noise(config, live.nodes, trained_range(config), alive=live.alive),
        *live.weights,
        *check_alarms(config, live.nodes, alive=live.alive),
        *check_versions({name: c for name, c in live.nodes.items() if name in live.alive}, own=__version__),
        *check_clocks({name: s for name, s in live.clocks_s.items() if name in live.alive}, live.nodes),
    ]


def _running_weights(observer: Observer) -> list[Finding]:
    """All regressors of the line weigh with the same weights, and with those that they were given last."""
    from regressor.serve.link import states
    from tuberline.doctor.weights import check_running_weights, models_of_run

    return check_running_weights(states(observer.session, observer.line), models_of_run(observer))


def _weights(config: LineConfig) -> list[Finding]:
    file = config.regressor.weights

    def load() -> str:
        from regressor.serve.check import check_weights
        from regressor.weigh.weigher import Weigher

        if file is not None and not file.exists() and config.regressor.processes == 0:
            return f"{file} is not here; nor do regressors run here (regressor.processes = 0)"
        weigher = Weigher.load(file)
        worst_off = max(abs(a.weight_g / a.true_g - 1) for a in check_weights(weigher, config))
        where = file or "the shipped ones"
        return f"{where}: {weigher.sidecar.model_id}, reference clouds within {100 * worst_off:.0f} %"

    return [_tried("weights", load, "set regressor.weights to a .safetensors or .pth that `tuberline evaluate` takes")]


def _cameras(config: LineConfig, live: Live) -> list[Finding]:
    found = []
    for name, camera in sorted(config.cameras.items()):
        node = f"camera/{name}"
        at_work = node in live.alive
        if at_work and camera.source != "recording":
            found.append(ok(f"camera {name}", "in use by its node, not touched"))
            continue
        told = live.nodes.get(node)
        if at_work and told and told.host != socket.gethostname() and not (camera.path and camera.path.exists()):
            found.append(ok(f"camera {name}", f"its node plays a recording on {told.host}, which is not on this host"))
            continue
        try:
            found += _camera(config, name)
        except (TuberlineError, OSError) as error:
            fix = f"correct [cameras.{name}] in the config, or the recording or device it names"
            if _may_hang_elsewhere(config, camera):
                found.append(warning(f"camera {name}", _in_words(error), f"where it hangs on this host: {fix}"))
            else:
                found.append(fault(f"camera {name}", _in_words(error), fix))
    return found


def _may_hang_elsewhere(config: LineConfig, camera: CameraConfig) -> bool:
    """Of a line over several hosts a camera of which this one has nothing: until it runs no one says where it hangs."""
    from tuberline.doctor.machine import realsense_mbit

    if host_and_port(config.link.router)[0] in ("", "localhost", "127.0.0.1", "[::1]"):
        return False
    if camera.source == "realsense":
        return not realsense_mbit()
    return camera.path is not None and not os.path.exists(camera.path)


def _camera(config: LineConfig, name: str) -> list[Finding]:
    """Look through a camera: does it give frames, and where do they show the belt?"""
    from camera_sim.configured import configured_source
    from conveyor.formats import Refused
    from conveyor.formats.configured import recorded_source
    from conveyor.geometry import belt_distance_m
    from segmenter.frame.plane import fit_plane
    from tuberline.doctor.belt import check_belt_seen
    from tuberline.doctor.depth import check_depth, trained_range

    source = clocked = configured_source(config, name)
    if config.camera(name).starts_at_s is not None:
        source = recorded_source(config, name)  # by the clock its first frame may come next week
    untimely = [note for note in clocked.description.notes if note not in source.description.notes]
    frames: Any = source.frames(run="doctor")
    with closing(frames):  # a device is let go again
        taken = list(islice(frames, LOOK_AT_FRAMES))
    if not taken or isinstance(taken[0], Refused):
        why = f": {taken[0].text}" if taken else ""
        raise InputError(f"{source.description.origin} gives no frame{why}")
    usable = [frame for frame in taken if not isinstance(frame, Refused)]
    first = usable[0]
    fits = [fit_plane(frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics) for frame in usable]
    given_m = first.belt_distance_m if first.belt_from_camera is None else belt_distance_m(first.belt_from_camera)
    seen_m = [fit.distance_m for fit in fits if fit is not None]
    return [
        ok(f"camera {name}", f"{first.depth.shape[1]}x{first.depth.shape[0]} from {source.description.origin}"),
        check_belt_seen(
            name, given_m=given_m, seen_m=seen_m, frames=len(usable), by_travel=config.belt.gauge == "travel"
        ),
        check_depth(name, usable, trained_range(config)),
        *(warning(f"camera {name}", note, f"correct starts_at_s of [cameras.{name}]") for note in untimely),
    ]


def _tried(check: str, work: Callable[[], str], fix: str) -> Finding:
    try:
        return ok(check, work())
    except (TuberlineError, OSError) as error:
        return fault(check, _in_words(error), fix)


def _in_words(error: Exception) -> str:
    return told(error) if isinstance(error, OSError) else str(error)
