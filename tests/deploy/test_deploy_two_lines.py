"""deploy/install.sh for a second line on the same machine: what only one of the two could have is refused."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.deploy.test_deploy_systemd import DEPLOY, TUBERLINE, contents, install

pytestmark = pytest.mark.skipif(not TUBERLINE.exists(), reason=f"{TUBERLINE} is not installed")

ROLES = "router,aggregator,camera,segmenter,regressor,recorder,metrics,page"
STEMS = ("ca", "operator", "router", "aggregator", "camera", "segmenter", "regressor", "recorder")


def line(folder: Path, name: str, *, port: int, of: str = "") -> Path:
    """The example of a site under another name, with folders of its own or those of line `of`."""
    text = (DEPLOY / "examples" / "site.toml").read_text().replace('name = "field"', f'name = "{name}"')
    text = text.replace("7447", str(port)).replace("/var/lib/tuberline/field", f"/var/lib/tuberline/{of or name}")
    (file := folder / f"{name}.toml").write_text(text.replace('/certs"', f'/certs/{of or name}"'))
    return file


def certs(folder: Path, name: str) -> Path:
    """What `tuberline certs make` gives: the same names for each line."""
    (made := folder / f"certs-{name}").mkdir()
    for stem in STEMS:
        for end in ("pem", "key"):
            (made / f"{stem}.{end}").write_text(f"{stem}.{end} of {name}")
    return made


@pytest.fixture(scope="module")
def north(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with line north installed, of which each test has a copy. No test writes to it."""
    folder = tmp_path_factory.mktemp("north")
    config, made = line(folder, "north", port=7447), certs(folder, "north")
    done = install(folder / "root", "--roles", ROLES, "--certs", str(made), config=config)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def root(tmp_path: Path, north: Path) -> Path:
    """A folder of the test's own with line north installed; its config and certificates lie beside it."""
    shutil.copytree(north, tmp_path, symlinks=True, dirs_exist_ok=True)
    return tmp_path / "root"


def listening(root: Path, name: str, at: str) -> None:
    (root / f"etc/tuberline/lines/{name}.environment").write_text(f"TUBERLINE_METRICS={at}8\nTUBERLINE_PAGE={at}9\n")


def test_a_second_line_leaves_the_first_as_it_is(tmp_path: Path, root: Path) -> None:
    """Its certificates replaced those of the first, in a folder that its config does not name."""
    before = contents(root)
    listening(root, "south", "127.0.0.1:918")
    words = ("--roles", ROLES, "--certs", str(certs(tmp_path, "south")))
    done = install(root, *words, "--program", str(TUBERLINE), config=line(tmp_path, "south", port=7448))
    assert done.returncode == 0, done.stderr
    after = contents(root)
    changed = {name for name in before if after[name] != before[name]}
    assert changed <= {"etc/tuberline/environment"}
    assert after["etc/tuberline/certs/south/router.pem"] == b"router.pem of south"
    assert after["etc/tuberline/certs/north/router.pem"] == b"router.pem of north"
    assert "restart   tuberline@north.target when it suits" in done.stdout
    again = install(root, "--roles", ROLES, config=tmp_path / "north.toml")
    assert (again.returncode, contents(root)) == (0, after), again.stderr


@pytest.mark.parametrize(
    ("shared", "said"),
    [
        (
            "router",
            "router of line 'south' would listen on 0.0.0.0:7447, which that of line 'north' takes: give it another",
        ),
        (
            "metrics",
            "listen on 127.0.0.1:9108, which that of line 'north' takes: write TUBERLINE_METRICS=HOST:PORT into",
        ),
        ("page", "leave page out of --roles and let tuberline-page@north:south.service show both"),
        ("aggregator", "aggregator.out of line 'south' is /var/lib/tuberline/north/ledger, as that of line 'north' is"),
        ("regressor", "each needs its own, such as /var/lib/tuberline/south/weights"),
        ("camera", "which line 'north' uses: name a folder of its own in link.certs of line 'south'"),
    ],
)
def test_what_two_lines_cannot_share_is_refused_and_installs_nothing(
    tmp_path: Path, root: Path, shared: str, said: str
) -> None:
    before = contents(root)
    config = line(tmp_path, "south", port=7447, of="north")
    given = ("--certs", str(certs(tmp_path, "south"))) if shared == "camera" else ()
    done = install(root, "--roles", shared, *given, config=config)
    assert done.returncode == 2
    assert said in done.stderr
    assert contents(root) == before


def test_a_second_line_may_use_the_router_of_the_first(tmp_path: Path, root: Path) -> None:
    config = line(tmp_path, "south", port=7447, of="north")
    assert install(root, "--roles", "camera,segmenter", config=config).returncode == 0


def test_each_line_has_its_own_place_for_its_figures(root: Path) -> None:
    """A drop-in that comes after the machine's, for systemd takes the later of two files."""
    for role in ("metrics", "page"):
        (own,) = (root / f"etc/systemd/system/tuberline-{role}@.service.d").iterdir()
        (common,) = (root / "etc/systemd/system/tuberline-.service.d").iterdir()
        assert own.name > common.name
        assert "EnvironmentFile=-/etc/tuberline/lines/%i.environment" in own.read_text()
    words = [str(root / "usr/local/lib/tuberline/node"), "metrics", "north"]
    echo = {"PATH": os.environ["PATH"], "TUBERLINE": "/bin/echo", "TUBERLINE_ETC": str(root / "etc/tuberline")}
    for at in ("127.0.0.1:9108", "127.0.0.1:9188"):
        said = subprocess.run(words, env=echo, capture_output=True, text=True, check=True).stdout
        assert said.endswith(f"--listen {at}\n")
        echo["TUBERLINE_METRICS"] = "127.0.0.1:9188"
