"""The files that a line's config names, looked at before anything starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from conveyor.access import router_access
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.errors import ConfigError, InputError, TuberlineError
from conveyor.files import told


def unreadable_files(line: LineConfig) -> list[str]:
    """What cannot be used of them, in words; a process of the line would give up at each of these.

    A recording or a camera's device that is not there at all is left to its camera: it is started again when that
    comes. Nothing is imported that `tuberline run` would keep in memory for as long as it runs, as torch.
    """
    found = []
    for key, read in _looks(line):
        try:
            read()
        except (TuberlineError, OSError) as error:
            words = told(error) if isinstance(error, OSError) else str(error)
            found.append(words if words.startswith(key) else f"{key}: {words}")
    return found


def _looks(line: LineConfig) -> Iterator[tuple[str, Callable[[], object]]]:
    """(key, what raises a TuberlineError where the file that it names cannot be used)."""
    if line.aggregator.tickets is not None:
        from aggregator.calibration.tickets import read_tickets

        yield "aggregator.tickets", partial(read_tickets, line.aggregator.tickets)
    if line.aggregator.contract is not None:
        from conveyor.contract import read_contract

        yield "aggregator.contract", partial(read_contract, line.aggregator.contract)
    if line.regressor.weights is not None and line.regressor.processes:
        from regressor.network.stored import check_weights

        yield "regressor.weights", partial(check_weights, line.regressor.weights)
    if line.segmenter.weights is not None and line.segmenter.method != "classical":
        from segmenter.classify.network import check_there

        yield "segmenter.weights", partial(check_there, line.segmenter.weights)
    for name, camera in sorted(line.cameras.items()):
        yield f"cameras.{name}.camera", partial(_check_camera, camera, name)
    if line.alarms is not None:
        from tuberline.alarms.channels import check_addresses

        yield "alarms", partial(check_addresses, line.alarms)
    if line.gnss is not None:
        from camera_sim.gnss.receivers import check_receiver

        yield "gnss.source", partial(check_receiver, line.gnss.source)


def check_access(line: LineConfig, file: Path) -> None:
    """Refuse what the line's router would refuse when it starts.

    Raises:
        ConfigError: access control on endpoints that prove no identity.
    """
    try:
        router_access(line)
    except ConfigError as error:
        raise ConfigError(f"config {file}: {error}") from error


def _check_camera(camera: CameraConfig, name: str) -> None:
    """Raises InputError: its recording is there and has no such camera, or several of which none is named."""
    from conveyor.formats.detect import camera_names, choose_camera

    if camera.path is None or not camera.path.exists() or (camera.camera or "").startswith("/"):
        return
    try:
        known = camera_names(camera.path)
    except InputError:  # no recording: as where it is not there
        return
    choose_camera(camera.path, known, camera.camera or (name if name in known else None))
