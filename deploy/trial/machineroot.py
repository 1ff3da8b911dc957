"""A Debian root with systemd and Tuberline installed as docs/deploy.md says: a harvester's computer's disk."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from deploy.trial import base
from deploy.trial.machine import SPACE, TOOLS, make_network, remove_network
from deploy.trial.pipsettings import write_settings
from deploy.trial.tools import ROOT, alone, need_root, need_tools, output, run, say, workdir

SOURCE = "/usr/src/tuberline"
BOOTED_WITH = ("systemd-nspawn",)
TORCH = "torch==2.13.0"


@contextmanager
def machines_on(what: str, *, keep: bool) -> Iterator[tuple[Path, Path]]:
    """(folder, root) for machines of the trial `what`, with their network; all of it goes at the end unless `keep`.

    Raises:
        TrialError: not root, or a tool is missing.
    """
    need_tools({**TOOLS, "debootstrap": "debootstrap"})
    folder = workdir("machine")
    need_root(what, f"it makes a Debian root under {folder}, mounts, boots machines, kills them, adds control groups")
    os.umask(0o022)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with alone(SPACE):
        try:
            root = machine_root(folder)
            make_network()
            yield folder, root
        finally:
            remove_network()
            if not keep:
                shutil.rmtree(folder, ignore_errors=True)


def machine_root(folder: Path) -> Path:
    """The root with this clone installed into /opt/tuberline; made once, the package again where the clone changed."""
    root = base.debian_root(folder / "root", base.FOR_MACHINES)
    copy_clone(root / SOURCE.lstrip("/"))
    # Beside what they tell of: a root that is made again has neither.
    libraries, ours = (root / "opt" / name for name in ("libraries.ready", "installed.version"))
    if not libraries.exists():
        say("installing torch and the libraries into /opt/tuberline of the root")
        in_root(folder, root, "python3", "-m", "venv", "/opt/tuberline")
        pip = ("/opt/tuberline/bin/pip", "install", "--quiet", "--no-cache-dir")
        constraint = ("--constraint", f"{SOURCE}/constraints.txt")
        in_root(folder, root, *pip, *constraint, TORCH)
        in_root(folder, root, *pip, *constraint, f"{SOURCE}[deploy,realsense,encoder,gnss]")
        libraries.touch()
    state = output(["git", "-C", ROOT, "rev-parse", "HEAD"]) + run(["git", "-C", ROOT, "diff", "HEAD"]).stdout
    if not ours.exists() or ours.read_text(encoding="utf-8") != state:
        say("installing this clone into /opt/tuberline of the root")
        options = ("--quiet", "--no-deps", "--force-reinstall", "--no-cache-dir")
        in_root(folder, root, "/opt/tuberline/bin/pip", "install", *options, SOURCE)
        ours.write_text(state, encoding="utf-8")
    return root


def copy_clone(target: Path) -> None:
    """The clone's files as git knows them, and no build output."""
    shutil.rmtree(target, ignore_errors=True)
    listed = run(["git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard"]).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file() and not name.startswith(("tests/", "docs/results/")):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def in_root(folder: Path, root: Path, *words: str, binds: Sequence[str] = ()) -> str:
    """Run one command inside the root, not booted, with this machine's network and pip settings lent to it."""
    conf = folder / "pip.conf"
    lent = [f"--bind-ro={path}" for path in write_settings(conf)] + [f"--bind-ro={conf}:/etc/pip.conf"]
    nspawn = ["systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--pipe", f"--directory={root}"]
    return output([*nspawn, *lent, *binds, *words])
