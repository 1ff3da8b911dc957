"""Nodes of one machine start from one process that has loaded what they need: each is forked from it.

python -m tuberline.forks SOCKET ROLE ...       # how the supervisor starts that process

To load modules and numba takes a node up to a second of a processor, and a small line is eight of them. A forked node
has them at once, shares their memory with the others, and leaves by itself as every node does. The process that forks
holds nothing but modules: no thread, no session, no file. It leaves when its supervisor's end of the socket is closed.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol, Self

from conveyor.errors import FAULT
from tuberline.orphan import ENVIRONMENT

MODULES: Mapping[str, tuple[str, ...]] = {
    "router": ("zenoh", "tuberline.cli.router"),
    "aggregator": ("aggregator.node",),
    "camera": ("camera_sim.node",),
    "regressor": ("regressor.serve.node",),
    "segmenter": ("segmenter.node",),
}
"""What nodes of a role load before they work. Other roles begin with what these share."""
COMPILED = ("regressor", "segmenter")
"""Roles that run kernels."""
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
ANSWER_WITHIN_S = 60.0
"""A disk may be slow while modules are read; a process that says nothing for longer is taken for lost."""


class Process(Protocol):
    """What the supervisor needs of a child: as `subprocess.Popen` has it."""

    pid: int

    def poll(self) -> int | None:
        """Its exit code; None while it runs; -N where signal N ended it."""

    def wait(self, timeout: float | None = None) -> int:
        """The same once it has ended; raises `subprocess.TimeoutExpired`."""

    def send_signal(self, sig: int) -> None:
        """Send a signal, where it has not ended."""

    def kill(self) -> None:
        """SIGKILL."""


class Forked:
    """A process that `ForkServer.start` has forked: a handle of the kernel's, so that no other one of the same number
    is meant. `code_of` asks the server for its exit code once it has ended.
    """

    def __init__(self, pid: int, server: ForkServer) -> None:
        self.pid = pid
        self._server = server
        self._code: int | None = None
        self._handle = -1  # nothing to close where there is none to be had
        self._handle = os.pidfd_open(pid)

    def __del__(self) -> None:
        self._close()

    def poll(self) -> int | None:
        """Its exit code; None while it runs; -N where signal N ended it."""
        if self._code is None and self._ended(0.0):
            self._code = self._server.code_of(self.pid)
            self._close()
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """The same once it has ended.

        Raises:
            subprocess.TimeoutExpired: it runs on after `timeout` seconds.
        """
        if self._code is None and not self._ended(timeout):
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        code = self.poll()
        return FAULT if code is None else code

    def send_signal(self, sig: int) -> None:
        """Send a signal, where it has not ended."""
        if self._code is None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, sig)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def _ended(self, within_s: float | None) -> bool:
        poll = select.poll()
        poll.register(self._handle, select.POLLIN)
        return bool(poll.poll(None if within_s is None else 1000.0 * within_s))

    def _close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


class ForkServer:
    """The supervisor's end of the process that forks. Not for several threads at once. A context manager.

    Args:
        roles: of the nodes that will be started, in their order: what they load is loaded ahead.
    """

    def __init__(self, roles: Sequence[str]) -> None:
        self._channel, theirs = socket.socketpair()
        with theirs:
            self._channel.settimeout(ANSWER_WITHIN_S)
            self._lines = self._channel.makefile("rb")
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tuberline.forks", str(theirs.fileno()), *dict.fromkeys(roles)],
                stdin=subprocess.DEVNULL,
                env={**ONE_THREAD, **os.environ},
                pass_fds=(theirs.fileno(),),
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @classmethod
    def if_usable(cls, roles: Sequence[str]) -> Self | None:
        """One, where the kernel has handles for processes (Linux 5.3 and newer); else each node starts by itself."""
        try:
            os.close(os.pidfd_open(os.getpid()))
        except (AttributeError, OSError):
            return None
        return cls(roles)

    def start(self, args: Sequence[str], *, environment: Mapping[str, str], log: Path | None) -> Forked:
        """Fork a node: `tuberline ARGS`, with more environment than this process, its stderr appended to `log`.

        Raises:
            ConnectionError: the process that forks was killed or is stuck; nodes that it had forked end by themselves.
            OSError: the node cannot be started; the reason is the system's.
        """
        where = str(log.absolute()) if log else None
        told = self._ask({"args": list(args), "environment": dict(environment), "log": where})
        if told is None:
            raise ConnectionError("the process that forks nodes does not answer")
        if "pid" not in told:
            raise OSError(told["number"], told["why"])
        pid: int = told["pid"]
        try:
            return Forked(pid, self)
        except OSError:  # no handle is left: a node that no one looks after must not run
            os.kill(pid, signal.SIGKILL)
            self.code_of(pid)
            raise

    def code_of(self, pid: int) -> int:
        """Exit code of a node that has ended; `FAULT` where the process that forked it is gone."""
        told = self._ask({"ended": pid})
        return FAULT if told is None else int(told["code"])

    def close(self) -> None:
        """End it; its nodes have to be stopped before. It holds nothing that would be lost."""
        self._leave()
        self._process.kill()
        self._process.wait()

    def _leave(self) -> None:
        self._lines.close()
        self._channel.close()

    def _ask(self, question: Mapping[str, Any]) -> dict[str, Any] | None:
        """Its answer; None where it is gone or stuck."""
        try:
            self._channel.sendall(json.dumps(question).encode() + b"\n")
            line = self._lines.readline()
        except (OSError, ValueError):
            return None
        except BaseException:  # of a signal's handler: what is answered now would be taken for the next answer
            self._leave()
            raise
        return json.loads(line) if line.endswith(b"\n") else None


def alone(args: Sequence[str], *, environment: Mapping[str, str], log: Path | None) -> subprocess.Popen[bytes]:
    """A node that starts by itself, where none can be forked; arguments and errors as for `ForkServer.start`."""
    with ExitStack() as stack:
        stderr = stack.enter_context(log.open("ab")) if log else None
        return subprocess.Popen(
            [sys.executable, "-m", "tuberline", *args],
            stdin=subprocess.DEVNULL,
            stderr=stderr,
            env={**ONE_THREAD, **os.environ, **environment, ENVIRONMENT: str(os.getpid())},
        )


def serve(channel: socket.socket, roles: Sequence[str]) -> list[str] | None:
    """Answer until the supervisor has left: None. In each forked process: the arguments of the node that it is."""
    gc.disable()
    ahead = list(roles)
    with channel, channel.makefile("rb", buffering=0) as lines:
        while True:
            while ahead and not select.select([channel], [], [], 0.0)[0]:
                load(ahead.pop(0))
            line = lines.readline()
            if not line:
                return None
            question = json.loads(line)
            if "ended" in question:
                answer = {"code": os.waitstatus_to_exitcode(os.waitpid(question["ended"], 0)[1])}
            elif (answer := forked(question)) == {"pid": 0}:
                return list(question["args"])
            with suppress(BrokenPipeError):
                channel.sendall(json.dumps(answer).encode() + b"\n")


def load(role: str) -> None:
    """Import what a role needs. What cannot be is left to the node, which tells its reason in its log."""
    with suppress(Exception):
        for module in MODULES.get(role, ()):
            importlib.import_module(module)
        if role in COMPILED:
            from conveyor.kernels import load_compiler

            load_compiler()


def forked(question: Mapping[str, Any]) -> dict[str, Any]:
    """Fork a node: the answer for the supervisor, and in the node a process id of 0.

    A signal for the node waits until it no longer has this process's ways with signals, which would lose it.
    """
    load(question["args"][0])
    gc.freeze()  # what is there stays: to look through it would copy the pages that all share
    server = os.getpid()
    with ExitStack() as stack:
        stack.callback(signal.pthread_sigmask, signal.SIG_SETMASK, signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING))
        try:
            log = stack.enter_context(Path(question["log"]).open("ab")) if question["log"] else None
            pid = os.fork()
        except OSError as error:
            return {"number": error.errno, "why": error.strerror}
        if pid == 0:
            become(server, question["environment"], log)
    return {"pid": pid}


def become(server: int, environment: Mapping[str, str], log: BinaryIO | None) -> None:
    """What the process `server` had set for itself, as a node has it."""
    if log is not None:
        os.dup2(log.fileno(), sys.stderr.fileno())
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C before it works ends it, without a traceback
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ.update(environment, **{ENVIRONMENT: str(server)})
    gc.enable()


def main() -> None:
    """Serve; in a forked process: be the node."""
    for number in (signal.SIGINT, signal.SIGTERM):  # meant for the nodes; this process leaves with its supervisor
        signal.signal(number, signal.SIG_IGN)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda *_: None)
    importlib.import_module("tuberline.cli.entry")  # every node needs it
    args = serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2:])
    if args is None:
        os._exit(0)
    from setproctitle import setproctitle

    from tuberline.cli import main as tuberline

    setproctitle(" ".join(["tuberline", *args]))
    sys.argv = ["tuberline", *args]
    tuberline()


if __name__ == "__main__":
    main()
