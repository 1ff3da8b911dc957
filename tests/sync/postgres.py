"""A real PostgreSQL of this test's own: initdb into a folder, listening on a free loopback port."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

from conveyor.taken_port import free_port


def binaries() -> Path:
    """Folder of initdb and postgres; skips loudly where there is none."""
    found = shutil.which("postgres")
    if found:
        return Path(found).parent
    for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True):
        if (folder / "initdb").is_file():
            return folder
    pytest.skip("PostgreSQL is not installed (Debian: apt-get install postgresql): the sync was not tested")


class Postgres:
    """One server that can be killed and started again, in a folder of its own: pytest's are closed to other users."""

    def __init__(self) -> None:
        self._bin = binaries()
        self._root = Path(tempfile.mkdtemp(prefix="tuberline-postgres-"))
        self._folder = self._root / "data"
        # The server refuses to run as root: then it runs as the user that Debian's package made.
        self._as = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"] if os.geteuid() == 0 else []
        if os.geteuid() == 0:
            shutil.chown(self._root, "postgres", "postgres")
        self._run("initdb", "--auth=trust", "--username=tuberline", "--no-sync", "-D", str(self._folder))
        self.port = free_port()
        self.url = f"postgresql://tuberline@127.0.0.1:{self.port}/postgres"
        self._process: subprocess.Popen[bytes] | None = None

    def _run(self, name: str, *arguments: str) -> None:
        done = subprocess.run([*self._as, self._bin / name, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def start(self) -> None:
        """Listening when this returns."""
        import psycopg

        options = ["-D", str(self._folder), "-p", str(self.port), "-k", "", "-c", "listen_addresses=127.0.0.1"]
        self._process = subprocess.Popen(
            [*self._as, self._bin / "postgres", *options], stderr=subprocess.DEVNULL, start_new_session=True
        )
        deadline = time.monotonic() + 60
        while True:
            try:
                psycopg.connect(self.url, connect_timeout=2).close()
            except psycopg.OperationalError:
                assert time.monotonic() < deadline, "PostgreSQL does not listen"
                time.sleep(0.1)
            else:
                return

    def kill(self) -> None:
        """As when the power goes: all of its processes at once."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(30)
            (self._folder / "postmaster.pid").unlink(missing_ok=True)
            self._process = None

    def remove(self) -> None:
        """Kill it and remove its folder."""
        self.kill()
        shutil.rmtree(self._root, ignore_errors=True)
