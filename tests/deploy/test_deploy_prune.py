"""deploy/lib/prune: the oldest recordings go, and none that is being written."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT

PRUNE = ROOT / "deploy" / "lib" / "prune"
HOUR_S = 3600


def recordings(folder: Path, *newest_first: str) -> None:
    """Files of 10 kB, each an hour older than the one before; a name that ends in / is a folder with such a file."""
    for hours, name in enumerate(newest_first, start=1):
        file = folder / name / "frames" if name.endswith("/") else folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"x" * 10_000)
        at = time.time() - hours * HOUR_S
        os.utime(file, (at, at))
        os.utime(file.parent, (at, at))


def prune(folder: Path, *, quota_gb: str = "0", free_gb: str = "0") -> subprocess.CompletedProcess[str]:
    """Run it as its unit does, over a quota of nothing."""
    environment = {**os.environ, "TUBERLINE_RECORDINGS_GB": quota_gb, "TUBERLINE_FREE_GB": free_gb}
    return subprocess.run([PRUNE, folder], env=environment, capture_output=True, text=True, check=False, timeout=10)


def left(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def test_the_oldest_recordings_go_first_and_the_newest_stays(tmp_path: Path) -> None:
    recordings(tmp_path, "new.mcap", "middle.mcap", "old.mcap")
    assert prune(tmp_path, quota_gb="1").returncode == 0
    assert len(left(tmp_path)) == 3
    done = prune(tmp_path)
    assert left(tmp_path) == ["new.mcap"]
    assert done.stdout.index("old.mcap") < done.stdout.index("middle.mcap")


def test_a_disk_that_is_nearly_full_costs_old_recordings_not_the_ledger(tmp_path: Path) -> None:
    """A quota of 200 GB on a disk of 128 filled it, and the aggregator could write no more."""
    recordings(tmp_path, "new.mcap", "old.mcap")
    assert prune(tmp_path, quota_gb="1").returncode == 0
    assert len(left(tmp_path)) == 2
    more_than_any_disk_gb = "999999999"
    done = prune(tmp_path, quota_gb="1", free_gb=more_than_any_disk_gb)
    assert left(tmp_path) == ["new.mcap"]
    assert "of the disk free" in done.stdout
    assert "give it more room" in done.stderr


def test_a_recording_that_is_written_stays_with_its_positions(tmp_path: Path) -> None:
    recordings(tmp_path, "new.positions.csv", "new.mcap", "old.positions.csv", "old.mcap")
    done = prune(tmp_path)
    assert left(tmp_path) == ["new.mcap", "new.positions.csv"]
    assert "with what it keeps alone" in done.stderr


def test_the_newest_of_each_line_stays_with_its_parts(tmp_path: Path) -> None:
    """Of two lines on one machine, the one that had written last kept its recording, the other lost the open one."""
    north, south = "north-20260914T080000Z", "south.b-20260914T060000Z"
    recordings(
        tmp_path,
        f"{north}-2.mcap",
        f"{north}.positions.csv",
        f"{north}.mcap",
        "south.a-20260914T070000Z.mcap",
        f"{south}.mcap",
        "north-20260913T080000Z.mcap",
        "north-20260913T080000Z.positions.csv",
        "south.b-20260913T060000Z-2.mcap",
    )
    assert prune(tmp_path).returncode == 0
    stays = [f"{north}-2.mcap", f"{north}.positions.csv", f"{north}.mcap", "south.a-20260914T070000Z.mcap"]
    assert left(tmp_path) == sorted([*stays, f"{south}.mcap"])


def test_what_was_written_just_now_stays(tmp_path: Path) -> None:
    """Two recorders of one line, and a copy into the folder: the time of a folder is that of what is in it."""
    recordings(
        tmp_path, "field-20260914T080000Z.mcap", "field-20260914T070000Z.mcap", "copy/", "field.mcap", "old.mcap"
    )
    written = (tmp_path / "field-20260914T070000Z.mcap", tmp_path / "copy" / "frames")
    for file in written:
        os.utime(file)
    assert prune(tmp_path).returncode == 0
    assert left(tmp_path) == ["copy", "field-20260914T070000Z.mcap"]


def test_a_wrong_clock_keeps_no_room_and_removes_nothing_by_age(tmp_path: Path) -> None:
    """What was dated later than now was taken for being written, and the ledger's disk filled. And systemd removed what
    was 30 days old, without a word: all of them at once, when the clock was set right."""
    recordings(tmp_path, "new.mcap", "old.mcap")
    for name, hours in (("later.mcap", 9000), ("latest.mcap", 9001)):
        (tmp_path / name).write_bytes(b"x" * 10_000)
        os.utime(tmp_path / name, (time.time() + hours * HOUR_S,) * 2)
    done = prune(tmp_path)
    assert left(tmp_path) == ["latest.mcap"]
    assert done.stdout.index("old.mcap") < done.stdout.index("new.mcap") < done.stdout.index("later.mcap")
    aged = (ROOT / "deploy/systemd/tmpfiles.conf").read_text(encoding="utf-8").splitlines()
    assert {line.split()[-1] for line in aged if not line.startswith("#")} == {"-"}


def test_names_with_blanks_line_ends_and_signs_are_taken_as_they_are(tmp_path: Path) -> None:
    """A name with a line end was never found, and prune went round forever; one with a sign was a pattern to it."""
    odd = ("-rf", "two words.mcap", "[a-z]*.mcap", "*", "a+b/", "back\\slash", " blank ", "ümlaut.mcap")
    recordings(tmp_path, "new.mcap", *odd, "line\nend", "of\n1 new/", ".hidden")
    (tmp_path / "link").symlink_to(ROOT)
    os.utime(tmp_path / "link", (1, 1), follow_symlinks=False)
    done = prune(tmp_path)
    assert done.returncode == 0, done.stderr
    assert left(tmp_path) == [".hidden", "line\nend", "new.mcap", "of\n1 new"]
    assert PRUNE.exists()
    assert f"removed {tmp_path}/two words.mcap" in done.stdout


def test_what_cannot_be_removed_stops_no_other(tmp_path: Path) -> None:
    """lost+found of a disk of its own is root's: it was tried first, and its refusal ended prune each time."""
    with tempfile.TemporaryDirectory() as place:  # pytest's own are closed to other users
        folder, script = Path(place) / "recordings", shutil.copy(PRUNE, place)
        recordings(folder, "new.mcap", "old.mcap", "stuck/", "lost+found/")
        closed = [folder / "stuck", folder / "lost+found"]
        as_one = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"] if os.geteuid() == 0 else []
        for path in [place, folder, *folder.iterdir()]:
            os.chown(path, 65534, 65534) if as_one else None
        for path, mode in zip(closed, (0o500, 0o000), strict=True):
            path.chmod(mode)
        words = [*as_one, script, folder]
        environment = {**os.environ, "TUBERLINE_RECORDINGS_GB": "0"}
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False, timeout=60)
        for path in closed:
            path.chmod(0o700)
        assert left(folder) == ["lost+found", "new.mcap", "stuck"]
    assert done.returncode == 1
    assert "stuck" in done.stderr
    assert "lost+found" not in done.stderr


def test_it_works_when_its_own_words_find_no_room(tmp_path: Path) -> None:
    """It said first what it was about to remove: on a full disk it could not, and removed nothing."""
    recordings(tmp_path, "new.mcap", "old.mcap")
    with Path("/dev/full").open("w") as full:
        words, environment = [PRUNE, tmp_path], {**os.environ, "TUBERLINE_RECORDINGS_GB": "0"}
        subprocess.run(words, env=environment, stdout=full, stderr=full, check=False, timeout=60)
    assert left(tmp_path) == ["new.mcap"]


def test_an_empty_folder_a_link_and_none_at_all(tmp_path: Path) -> None:
    """The folder may be a link to a larger disk: that was taken for empty."""
    disk = tmp_path / "disk"
    disk.mkdir()
    (tmp_path / "recordings").symlink_to(disk)
    for folder in (disk, tmp_path / "none"):
        done = prune(folder)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    recordings(disk, "new.mcap", "old.mcap")
    assert prune(tmp_path / "recordings").returncode == 0
    assert left(disk) == ["new.mcap"]


@pytest.mark.parametrize("quota", ["200GB", "1.5", "-1", "0200", "99999999999999999999"])
def test_a_quota_that_is_no_number_is_refused(tmp_path: Path, quota: str) -> None:
    """What sh made of them: an error of its own, 128 GB of 0200, less than nothing of very much."""
    recordings(tmp_path, "new.mcap", "old.mcap")
    done = prune(tmp_path, quota_gb=quota)
    assert done.returncode == 2
    assert f"TUBERLINE_RECORDINGS_GB is '{quota}'; allowed are whole gigabytes" in done.stderr
    assert left(tmp_path) == ["new.mcap", "old.mcap"]
