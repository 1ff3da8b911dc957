"""One live line with faults: real processes under the product's own supervisor, cameras that wait for no one."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aggregator.ledger.reader import read_runs, read_sums, reading
from benchmarks.chaos_live_belt import Passed
from benchmarks.chaos_live_faults import Case, Fault
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.taken_port import free_port
from tuberline.cli.run import summarise_late
from tuberline.processes import line_processes
from tuberline.replayer import recording_cameras
from tuberline.supervisor import ProcessSpec, Supervisor

OVER_S = 70.0
"""The line is stopped, or its recording ends, this long after it was started."""
ENDS_WITHIN_S = 75.0
"""After its cameras ended, a line is done by then: a process stopped for 40 s near the end included."""
RUN = "chaos"
SPEED = 0.5
"""Times real time at which the belt is played: on a busy machine a line takes 10 to 40 s to start."""
BACK_WITHIN_S = 30.0
"""What failed longer ago than this has to be there again when the line is stopped."""
LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class Belt:
    """A recording, what passed on it, and what an undisturbed run weighs of a gram."""

    recording: Path
    passed: Passed
    bias: float


def live_line(case: Case, belt: Belt, out: Path) -> dict[str, Any]:
    """Run a case in the folder `out`; what the line said at the end, beside the truth."""
    out.mkdir(parents=True)
    load_before = os.getloadavg()[0]
    launched_s = time.time()
    lasts_s = belt.passed.lasts_s / SPEED
    lead_s = lasts_s - OVER_S if case.ends == "by itself" else 5.0
    config = _config(belt.recording, out, starts_at_s=launched_s - lead_s, ends=case.ends)
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    specs = line_processes(config, config_path=config_path, run=RUN)
    with Supervisor(specs, log_dir=out / "logs") as supervisor:
        hurting = [threading.Thread(target=_hurt, args=(fault, specs, supervisor)) for fault in case.faults]
        for thread in hurting:
            thread.start()
        over_s, down = _wait_for_end(case, supervisor, launched_s)
        restarts = {name: n for name, n in supervisor.restarts.items() if n}
        stopped_s = time.time()
    if case.ends == "stopped":
        summarise_late(config, RUN, stopped_s)  # as `tuberline run` does
    for thread in hurting:
        thread.join()
    found = _told(out)
    if "began_s" in found:
        from_s = found["began_s"] - launched_s + lead_s
        to_s = min(over_s + lead_s, lasts_s + 1.0)
        passed, passed_g = belt.passed.between(from_s * SPEED, to_s * SPEED)
        found |= {"true_count": passed, "true_g": passed_g, "true_weighed_g": passed_g * belt.bias}
    return {
        **case.as_dict(),
        **found,
        "down": down,
        "restarts": restarts,
        "machine_load": [round(load_before, 1), round(os.getloadavg()[0], 1)],
        "took_s": round(time.time() - launched_s, 1),
    }


def _config(recording: Path, out: Path, *, starts_at_s: float, ends: str) -> LineConfig:
    camera = {"path": str(recording.resolve()), "waits": False, "speed": SPEED, "starts_at_s": starts_at_s}
    raw: dict[str, Any] = {
        "name": "chaos",
        "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
        "cameras": dict.fromkeys(recording_cameras(recording), camera),
        "segmenter": {"state_dir": str(out.resolve() / "state")},
        "regressor": {"processes": 2, "state_dir": str(out.resolve() / "weights")},
        "aggregator": {"out": str(out.resolve()), "exit_when_final": ends == "by itself"},
    }
    return parse_config(raw, where="of this run")


def _hurt(fault: Fault, specs: list[ProcessSpec], supervisor: Supervisor) -> None:
    """Wait for the fault's time, then kill or stop the first process of its role."""
    name = next(spec.name for spec in specs if spec.args[0] == fault.role)
    time.sleep(fault.at_s)
    pid = supervisor.pid(name)
    if pid is None:  # it is down already
        return
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL if fault.freeze_s is None else signal.SIGSTOP)
        if fault.freeze_s is not None:
            time.sleep(fault.freeze_s)
            os.kill(pid, signal.SIGCONT)


def _wait_for_end(case: Case, supervisor: Supervisor, launched_s: float) -> tuple[float, list[str]]:
    """Until the line is to be stopped, or has ended; when that was (seconds after its start), and what is down."""
    while time.time() < launched_s + OVER_S:
        time.sleep(LOOK_S)
    if case.ends == "by itself":
        deadline_s = time.time() + ENDS_WITHIN_S
        while not supervisor.finished("aggregator") and time.time() < deadline_s:
            time.sleep(LOOK_S)
        ended = supervisor.finished("aggregator")
        return OVER_S, sorted(supervisor.failures) + ([] if ended else ["did not end"])
    over_s = time.time() - launched_s
    hurt_late = {fault.role for fault in case.faults if fault.at_s + (fault.freeze_s or 0) > over_s - BACK_WITHIN_S}
    down = [
        name for name in supervisor.restarts if supervisor.pid(name) is None and name.partition("-")[0] not in hurt_late
    ]
    return over_s, sorted({*supervisor.failures, *down})


def _told(out: Path) -> dict[str, Any]:
    """What the line said of its load, and when it had begun by its ledger."""
    found: dict[str, Any] = {}
    if (out / "ledger.db").is_file():
        with reading(out / "ledger.db") as view:
            runs = read_runs(view)
            if runs:  # a load begins with its run, or with a frame that a camera had sent by then
                sights = read_sums(view, runs[0].run).sights.values()
                first_ns = [sight.published.first_ns for sight in sights if sight.published.first_ns is not None]
                found["began_s"] = min([runs[0].started_ns, *first_ns]) / 1e9
    if (out / "summary.json").is_file():
        summary = json.loads((out / "summary.json").read_text())
        totals = summary["totals"]
        found |= {name: summary[name] for name in ("state", "reason", "coverage", "balanced", "belt_m", "unseen_m")}
        found |= {"count": totals["count"], "seen_g": totals["weight_g"]}
        found |= {name: totals[f"estimated_{name}"] for name in ("weight_g", "low_g", "high_g")}
    return found
