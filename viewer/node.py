"""The viewer's process: subscribe, draw, hand over; and leave within two seconds whatever the hub does."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from conveyor.config import LineConfig
from conveyor.errors import ConfigError, OutputError
from conveyor.files import cause, may_pass
from conveyor.node import Node
from viewer.scene.field_scene import NewCells
from viewer.scene.inputs import Inputs
from viewer.scene.primitives import Entry
from viewer.scene.profiles import Profile
from viewer.scene.show import Show
from viewer.sink import Sink

IDLE_S = 0.02
LEAVE_WITHIN_S = 0.9
DRAIN_S = 0.3
FILE_TICK_S = 0.05
SILENT_S = 15.0
"""By then the processes of a line that runs are seen."""


@dataclass(frozen=True, slots=True)
class Target:
    """Where the picture goes: a file, a hub, Foxglove's app, or several of them."""

    rrd: Path | None
    rrd_limit_bytes: int
    connect: str | None
    foxglove: str | None = None

    def check(self) -> None:
        """Refuse what cannot work, before anything is started.

        Raises:
            ConfigError: nothing to show it in, an unusable URL, a file that cannot be made, a package that is missing.
        """
        if self.rrd is None and self.connect is None and self.foxglove is None:
            raise ConfigError(
                "the viewer has nothing to show the line in: give --rrd FILE, --connect URL (a running Rerun viewer or "
                "hub, e.g. rerun+http://127.0.0.1:9876/proxy), --serve or --foxglove HOST:PORT, or rrd, connect or "
                "foxglove in the config's [viewer]"
            )
        if self.foxglove is not None:
            from viewer.foxglove.server_sink import address_of

            address_of(self.foxglove)
        if self.connect is not None:
            from viewer.rerun.hub_sink import hub_address

            hub_address(self.connect)
        if self.rrd is not None:
            import viewer.rerun.sdk  # noqa: F401  is Rerun there?

            try:
                self.rrd.parent.mkdir(parents=True, exist_ok=True)
                self.rrd.open("ab").close()
            except OSError as error:
                text = f"viewer file {self.rrd} cannot be written: {cause(error)}"
                raise OutputError(text) if may_pass(error) else ConfigError(text) from error


def run_viewer(
    config: LineConfig,
    target: Target,
    *,
    profile: Profile,
    name: str,
    run: str | None,
    until: Callable[[], bool] = lambda: False,
    cells: NewCells | None = None,
) -> list[Sink]:
    """Show the line until stopped, or until `until` says so; `cells`: where the field's yield is put.

    Returns:
        The sinks that hang. Hold on to them and leave by `os._exit`: their destructors wait for the hub forever.
    """
    target.check()
    with Node("viewer", name, config=config, run=run or "any") as node:
        sinks = _sinks(node, target, profile=profile, recording=f"{config.name}-{run or time.time_ns()}")

        def offer(entry: Entry) -> None:
            for sink in sinks:
                sink.offer(entry)

        inputs = Inputs(node, profile)
        show = Show(inputs, offer, profile=profile, run=run, counters=node.counters, cells=cells)
        for sink in sinks:
            sink.start()
        look_s = time.monotonic() + SILENT_S
        while not node.stop.is_set() and not until():
            node.progress()
            if not show.turn():
                node.stop.wait(IDLE_S)
            if time.monotonic() > look_s:
                look_s = float("inf")
                _tell_silence(node, inputs)
        _drain(show)
        return _leave(node, sinks)


def _tell_silence(node: Node, inputs: Inputs) -> None:
    """Where no process of the line is seen, say so. A router lets a certificate in that no rule names, and gives it
    nothing: the picture stayed empty without a word.
    """
    if inputs.alive() - {f"viewer/{node.name}"}:
        return
    access = f", or its [access] does not name '{node.name}' among its viewers" if node.config.link.certs else ""
    node.log.warning(
        "no process of line '%s' is seen at %s after %g s: it does not run there, has another name%s",
        node.line,
        node.config.link.router,
        SILENT_S,
        access,
    )


def _drain(show: Show) -> None:
    """What had arrived before the stop is still shown: at the end of a load, its last tubers and the final totals."""
    deadline = time.monotonic() + DRAIN_S
    while show.turn() and time.monotonic() < deadline:
        pass


def _sinks(node: Node, target: Target, *, profile: Profile, recording: str) -> list[Sink]:
    tick_s = 0.5 / profile.rate_hz  # a line replayed faster than it was recorded: at most twice the profile's rate
    sinks: list[Sink] = []
    if target.rrd is not None:
        from viewer.rerun.file_sink import FileSink

        sinks.append(
            FileSink(
                target.rrd,
                limit_bytes=target.rrd_limit_bytes,
                run=recording,
                tick_s=min(tick_s, FILE_TICK_S),
                counters=node.counters,
                log=node.log,
            )
        )
    if target.connect is not None:
        from viewer.rerun.hub_sink import HubSink

        sinks.append(HubSink(target.connect, run=recording, tick_s=tick_s, counters=node.counters, log=node.log))
    if target.foxglove is not None:
        from viewer.foxglove.server_sink import ServerSink, address_of

        address = address_of(target.foxglove)
        sinks.append(ServerSink(address, run=recording, tick_s=tick_s, counters=node.counters, log=node.log))
    return sinks


def _leave(node: Node, sinks: list[Sink]) -> list[Sink]:
    """Finish what waits; the sinks that do not come to an end in time."""
    for sink in sinks:
        sink.ask_stop()
    deadline = time.monotonic() + LEAVE_WITHIN_S
    hanging = [sink for sink in sinks if not sink.join(max(0.0, deadline - time.monotonic()))]
    for sink in hanging:
        node.log.warning("%s takes nothing: left without it", sink.name)
    return hanging
