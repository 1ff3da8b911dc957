"""A disk that is full or read-only: one sentence that names the place, the cause and the fix; nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.files import write_whole
from conveyor.config import dump_toml, parse_config
from conveyor.errors import PASSING, PERMANENT, InputError, OutputError, StorageError
from conveyor.files import check_place, told, unwritable, whole_output
from conveyor.formats.conversion import convert_recording
from tests.belts import here
from tuberline.cli.config import check
from tuberline.doctor import Level
from tuberline.doctor.bundle import write_bundle
from tuberline.doctor.examine import examine
from tuberline.export.binary_files import write_xlsx
from tuberline.export.table import Column, Table
from tuberline.replayer import prepare_out

ROOT = Path(__file__).resolve().parents[2]
ENV = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "TQDM_DISABLE": "1"}
SMALL_FILES = 30_000
"""Bytes: under the limit of file sizes that stands for a full disk where no file system may be mounted."""
BELT = ("--tubers", "2", "--scene", "singulated", "--fps", "5", "--seed", "5", "--camera", "d405-848")
WRITERS = {
    "simulate": lambda out, belt: ("simulate", "--out", out / "belt", *BELT),
    "simulate-mcap": lambda out, belt: ("simulate", "--out", out / "belt.mcap", *BELT),
    "simulate-views": lambda out, belt: ("simulate-views", "--out", out / "views", "--tubers", "15", "--views", "1"),
    "convert": lambda out, belt: ("convert", belt, out / "belt.mcap"),
    "convert-ros2": lambda out, belt: ("convert", belt, out / "belt.mcap", "--format", "ros2"),
    "recover": lambda out, belt: ("recover", belt.with_suffix(".mcap"), "--out", out / "saved.mcap"),
    "export-onnx": lambda out, belt: ("export-onnx", "--out", out / "net.onnx"),
}


def tuberline(*args: object, limit: int | None = None, stdout: int | None = subprocess.PIPE) -> tuple[int, str]:
    """(exit code, stderr) of a command line; `limit`: no file may become larger, bytes."""

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(
        [sys.executable, "-m", "tuberline", *map(str, args)],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env=ENV,
        preexec_fn=limited,
        timeout=170,
    )
    return done.returncode, done.stderr


@pytest.fixture(scope="module")
def belt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small recording, and beside it the same one in an MCAP file."""
    out = tmp_path_factory.mktemp("belt") / "belt"
    here("simulate", "--out", out, *BELT)
    convert_recording(out, out.with_suffix(".mcap"))
    return out


@pytest.fixture(scope="module")
def tiny_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A file system of 300 kB; skipped where none may be mounted."""
    place = tmp_path_factory.mktemp("tiny")
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(place)], capture_output=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(
            f"no file system may be mounted here ({done.stderr.decode().strip()}); the limit of sizes stands for it"
        )
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def assert_one_sentence(code: int, said: str, *words: str, codes: tuple[int, ...] = (1, 2)) -> None:
    lines = [line for line in said.splitlines() if line.startswith("tuberline: ")]
    assert "Traceback" not in said, said
    assert "Exception ignored" not in said, said
    assert code in codes, said
    assert len(lines) == 1, said
    for word in words:
        assert re.search(word, lines[0]), lines[0]
    assert ".partial-" not in lines[0], "the user's own path is named"


@pytest.mark.parametrize("name", WRITERS)
def test_files_that_cannot_grow_leave_nothing_behind(name: str, tmp_path: Path, belt: Path) -> None:
    command = [*WRITERS[name](tmp_path, belt)]
    target = next(arg for arg in command if isinstance(arg, Path) and arg.parent == tmp_path)
    limit = SMALL_FILES if "export" not in name else 3_000_000
    code, said = tuberline(*command, limit=limit)
    assert_one_sentence(code, said, str(target), "cannot be written")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["simulate", "convert"])
def test_a_full_disk_is_told_and_left_clean(name: str, tiny_disk: Path, belt: Path) -> None:
    code, said = tuberline(*WRITERS[name](tiny_disk, belt))
    assert_one_sentence(code, said, str(tiny_disk), "cannot be written", "space|full", codes=(PASSING,))
    assert list(tiny_disk.iterdir()) == []


def test_what_is_there_stays_when_its_successor_cannot_be_written(belt: Path) -> None:
    before = {path: path.read_bytes() for path in belt.rglob("*") if path.is_file()}
    code, said = tuberline("simulate", "--out", belt, *BELT, "--force", limit=SMALL_FILES)
    assert_one_sentence(code, said, str(belt))
    assert {path: path.read_bytes() for path in belt.rglob("*") if path.is_file()} == before


def test_a_place_where_nothing_can_be_made_is_named(belt: Path) -> None:
    for command in (
        ("simulate", "--out", "/proc/belt", *BELT),
        ("convert", belt, "/proc/belt.mcap"),
        ("export-onnx", "--out", "/proc/net.onnx"),
    ):
        with pytest.raises(InputError, match=r"/proc/\S+ cannot be written"):
            here(*command)


def test_an_output_that_takes_nothing_is_told(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(-0.04, 0.04, 60), np.linspace(-0.03, 0.03, 60))
    on_top = (x / 0.04) ** 2 + (y / 0.03) ** 2 < 1
    np.save(tmp_path / "tuber.npy", np.stack([x[on_top], y[on_top], np.full(on_top.sum(), 0.30)], axis=1))
    with open("/dev/full", "w") as full:
        for command in (
            ("weigh", tmp_path / "tuber.npy", "--belt-distance-m", "0.345", "--json"),
            ("topics", "--json"),
        ):
            code, said = tuberline(*command, stdout=full.fileno())
            assert code == 1, said
            assert_one_sentence(code, said, "output: No space left on device; free space")


CRASHES = """
import threading
from conveyor.crash import end_on_faults
end_on_faults()
threading.Thread(target=lambda: 1 / 0).start()
threading.Event().wait()
"""


@pytest.mark.parametrize(
    ("command", "code"), [(("-m", "tuberline", "info", "no-such-place"), 2), (("-c", CRASHES), 70)]
)
def test_a_full_disk_under_the_log_lets_a_process_end(command: tuple[str, ...], code: int) -> None:
    """Its last words could not be written, and it stayed until it was killed: 'ended with code -9', forever."""
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, *command], stderr=full, env=ENV, check=False, timeout=60)
    assert done.returncode == code


def test_a_folder_is_no_file_to_write(tmp_path: Path) -> None:
    """`replay --rrd FOLDER` started the whole line, ended with its viewer's last words and left a run begun."""
    with pytest.raises(InputError, match=f"--rrd {tmp_path} is a folder: name a file"):
        check_place(tmp_path, option="--rrd")


def test_a_device_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    """`export --out /dev/full`, by root, left an ordinary file there for all programs of the machine; it ended with 0.

    A pipe stands for the device, and a link for /dev/stdout, which is one to /proc too.
    """
    pipe, stdout = tmp_path / "pipe.onnx", tmp_path / "stdout.onnx"
    os.mkfifo(pipe)
    stdout.symlink_to("/proc/self/fd/1")
    for place in (pipe, stdout):
        with pytest.raises(InputError, match="is a device or a pipe, not a file: name a file"):
            check_place(place, option="--out")
        with pytest.raises(InputError, match=f"{place} is a device or a pipe"), whole_output(place):
            raise AssertionError("nothing is made")
    code, said = tuberline("export-onnx", "--out", pipe)
    assert_one_sentence(code, said, f"{pipe} is a device or a pipe", codes=(2,))
    assert pipe.is_fifo()
    assert stdout.is_symlink()
    assert sorted(tmp_path.iterdir()) == [pipe, stdout]


def test_a_disk_without_room_is_known_before_the_work(tiny_disk: Path) -> None:
    assert unwritable(tiny_disk) == ""
    ballast = tiny_disk / "ballast"
    ballast.write_bytes(bytes(100_000))
    try:
        assert re.match("No space left on device; free space", unwritable(tiny_disk))
        with pytest.raises(OutputError, match=f"--out {tiny_disk}/run cannot be written: No space left"):
            prepare_out(tiny_disk / "run")
        with pytest.raises(OutputError, match=f"--picture {tiny_disk}/p.png cannot be written: No space left"):
            check_place(tiny_disk / "p.png", option="--picture")
        assert [*tiny_disk.iterdir()] == [ballast]
    finally:
        ballast.unlink()
    assert "check the name" in unwritable(tiny_disk / "nothing")


@pytest.mark.slow
@pytest.mark.graph
@pytest.mark.timeout(300)
def test_a_replay_whose_disk_fills_up_ends_and_is_resumed(tmp_path: Path, belt: Path) -> None:
    """Nodes were started again forever, each 'ended with code -9', and no one said why."""
    small, out = tmp_path / "small", tmp_path / "small" / "run"
    small.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(small)], check=False)
    if mounted.returncode != 0:
        pytest.skip("no file system may be mounted here")
    try:
        (small / "ballast").write_bytes(bytes((4 << 20) - 280_000))
        code, said = tuberline("replay", belt, "--out", out, "--regressors", "1")
        assert code == 75, said
        assert "Traceback" not in said
        assert "code -" not in said, "no node was killed"
        (last,) = [line for line in said.splitlines() if line.startswith("tuberline: ")]
        assert re.search(rf"into {out}: No space left on device; free space .* --resume goes on", last), said
        (small / "ballast").unlink()
        code, said = tuberline("replay", belt, "--out", out, "--resume")
        assert code == 0, said
        summary = json.loads((out / "summary.json").read_text())
        shutil.rmtree(out)
        (small / "ballast").write_bytes(bytes((4 << 20) - 400_000))
        code, said = tuberline("replay", belt, "--out", tmp_path / "out", "--regressors", "1", "--rrd", small / "x.rrd")
        assert code == 0, said
        assert re.search("--rrd .* ends early, its disk takes no more: No space left", said), said
        assert (summary["final"], summary["balanced"], summary["tubers"]["committed"]) == (True, True, 2)
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)


def test_a_workbook_on_a_full_disk_is_a_fault_of_the_disk() -> None:
    """It was one of xlsxwriter's, and ended in a traceback."""
    pytest.importorskip("xlsxwriter")
    table = Table("tubers", (Column("weight_g", "number", "g", "weight"),), [(100.0,)], {})
    with pytest.raises(OSError, match="No space left"):
        write_xlsx([table], Path("/dev/full"))


def test_whole_output_moves_all_or_nothing(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "kept").write_text("kept")
    with whole_output(tmp_path / "there") as partial:
        (partial / "deep").mkdir(parents=True)
        (partial / "deep" / "new").write_text("new")
        assert [path.name for path in (tmp_path / "there").iterdir()] == ["kept"]
    assert {path.name for path in (tmp_path / "there").rglob("*")} == {"kept", "deep", "new"}
    with pytest.raises(InputError, match=r"^/none/there: No such"), whole_output(tmp_path / "there"):
        Path("/none/there").read_bytes()  # it was said of what is written
    with whole_output(tmp_path / "a" / "b.mcap") as partial:
        partial.write_text("frames")
        partial.with_suffix(".truth.json").write_text("truth")
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"b.mcap", "b.truth.json"}
    with pytest.raises(InputError, match=r"c cannot be written: File exists; a file lies where a folder is needed"):
        _write_half(tmp_path / "a" / "b.mcap" / "c", OSError("never come to"))
    for fault, said in (
        (ZeroDivisionError("a bug"), "a bug"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), f"{tmp_path}/never cannot be written: No space.*free space"),
    ):
        with pytest.raises((ZeroDivisionError, InputError), match=said):
            _write_half(tmp_path / "never", fault)
    assert {path.name for path in tmp_path.iterdir()} == {"there", "a"}


def test_a_folder_that_is_a_disk_of_its_own_or_the_one_worked_in_is_written_to(
    tiny_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From beside a disk nothing can be moved onto it, and '.' has no name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tiny_disk)
    for target, there in ((tiny_disk, tiny_disk), (Path("link"), tiny_disk), (Path(), tmp_path)):
        with whole_output(target) as partial:
            partial.mkdir()
            (partial / "made").write_text("whole")
        assert (there / "made").read_text() == "whole"
        (there / "made").unlink()
        with pytest.raises(InputError, match=re.escape(f"{target}/x is odd")), whole_output(target) as partial:
            raise InputError(f"{partial}/x is odd")
    assert ([*tiny_disk.iterdir()], [*tmp_path.iterdir()]) == ([], [tmp_path / "link"])


@pytest.mark.parametrize(
    ("number", "code"),
    [
        *((number, PASSING) for number in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ESTALE)),
        *((number, PERMANENT) for number in (errno.EACCES, errno.EPERM, errno.ENOENT, errno.ENOTDIR, errno.EFBIG)),
    ],
)
def test_a_disk_may_do_better_at_another_try_and_a_right_or_a_name_may_not(
    tmp_path: Path, number: int, code: int
) -> None:
    """All exited with 2, where only a change helps: a timer that exports never tried again after a full disk."""
    with pytest.raises(InputError, match=r"out\.csv cannot be written") as caught:
        _write_half(tmp_path / "out.csv", OSError(number, os.strerror(number)))
    assert caught.value.exit_code == code
    with (
        pytest.raises(InputError, match=re.escape(f"{tmp_path}/in.csv is odd")) as refused,
        whole_output(tmp_path / "in.csv") as partial,
    ):
        raise OutputError(f"{partial} is odd")
    assert refused.value.exit_code == PASSING, "what the block says is kept"


def test_a_read_only_disk_is_one_that_may_be_mounted_for_writing(tiny_disk: Path, belt: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(tiny_disk)], check=True)
    try:
        code, said = tuberline("convert", belt, tiny_disk / "belt.mcap")
    finally:
        subprocess.run(["mount", "-o", "remount,rw", str(tiny_disk)], check=True)
    assert_one_sentence(code, said, "belt.mcap cannot be written: Read-only file system", codes=(PASSING,))


def _write_half(path: Path, fault: Exception) -> None:
    with whole_output(path) as partial:
        partial.write_text("half")
        raise fault


def test_a_summary_on_a_read_only_disk_is_a_fault_of_storage(tiny_disk: Path) -> None:
    """The half that never was could not be removed, and that was told instead."""
    subprocess.run(["mount", "-o", "remount,ro", str(tiny_disk)], check=True)
    try:
        with pytest.raises(StorageError, match=r"summary\.json cannot be written: Read-only file system; that file"):
            write_whole(tiny_disk / "summary.json", "{}")
    finally:
        subprocess.run(["mount", "-o", "remount,rw", str(tiny_disk)], check=True)


def test_every_sentence_has_path_cause_and_mend() -> None:
    assert told(FileNotFoundError(errno.ENOENT, "No such file or directory", "a/b")) == (
        "a/b: No such file or directory; check the name and that its folder exists"
    )
    assert told(OSError(errno.EADDRINUSE, "Address already in use"), "port 9180").startswith(
        "port 9180: Address already"
    )
    assert told(OSError("odd")) == "a file or device: odd"


def test_folders_that_cannot_be_looked_into_are_findings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One that this user may not enter ended `doctor`, `bundle` and `config check`; a disk that fails `alarms`."""
    closed = tmp_path / ("x" * 300)  # no system call takes it, as root can enter all others
    config = parse_config(
        {
            "cameras": {"left": {"path": str(closed / "belt")}},
            "segmenter": {"state_dir": str(closed)},
            "regressor": {"weights": str(closed / "net.safetensors")},
            "aggregator": {"out": str(closed)},
        },
        where="test",
    )
    faults = {f.check for f in examine(config, offline=True) if f.level is Level.FAULT}
    assert faults == {"disk of the ledger", "disk of the camera log", "weights", "camera left"}
    packed = write_bundle(tmp_path / "help.tar.gz", config, reports={}, journal_within_s=0.1)
    assert {"results/summary.json.unread", "results/tubers.csv.unread"} <= set(packed)
    (tmp_path / "line.toml").write_text(dump_toml(config), encoding="utf-8")
    check(tmp_path / "line.toml")
    assert "is accepted, with 3 warnings" in capsys.readouterr().out
