"""deploy/install.sh with the file of a line that ran in a folder of its own: what units could not use is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.deploy.test_deploy_systemd import LEDGER, TUBERLINE, contents, install

pytestmark = pytest.mark.skipif(not TUBERLINE.exists(), reason=f"{TUBERLINE} is not installed")

LIVE = 'name = "field"\n[cameras.left]\nsource = "realsense"\nbelt_distance_m = 0.46\n'


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        (
            "",
            "aggregator.out of line 'field' is runs/latest, beside a file that is copied to /etc/tuberline/lines:",
        ),
        ('[link]\ncerts = "certs"\n' + LEDGER, "link.certs of line 'field' is certs, beside a file that is copied"),
        (
            '[aggregator]\nout = "/data/ledger"\n',
            "aggregator.out of line 'field' is /data/ledger, where no unit may write: name a folder in /var",
        ),
        (
            LEDGER + '[regressor]\nstate_dir = "/srv/w"\n',
            "regressor.state_dir of line 'field' is /srv/w, where no",
        ),
    ],
)
def test_a_path_that_units_cannot_use_is_refused_and_nothing_installed(
    tmp_path: Path, sections: str, said: str
) -> None:
    """The file that `tuberline init` writes was installed and started, and its units failed for ever: what they read is
    /etc/tuberline/lines, and all of the system but one folder is read-only to them."""
    (file := tmp_path / "line.toml").write_text(LIVE + sections)
    done = install(tmp_path / "root", config=file)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "root").exists()
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_that_a_drop_in_opens_may_be_written(tmp_path: Path) -> None:
    (file := tmp_path / "line.toml").write_text(LIVE + '[aggregator]\nout = "/data/ledger"\n')
    for role in ("aggregator", "segmenter"):
        own = tmp_path / f"root/etc/systemd/system/tuberline-{role}@.service.d/50-disk.conf"
        own.parent.mkdir(parents=True)
        own.write_text("[Service]\nReadWritePaths=-/data\n")
    done = install(tmp_path / "root", config=file)
    assert (done.returncode, done.stderr) == (0, "")
    assert "etc/tuberline/lines/field.toml" in contents(tmp_path / "root")
