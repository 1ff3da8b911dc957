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


GNSS = '[gnss]\nsource = "serial:/dev/{port}?baud=9600"\n'
ENCODER = '[encoder]\nsource = "serial:/dev/{port}"\nmetres_per_pulse = 0.0005\n'


@pytest.fixture(scope="module")
def west(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with line west installed, which reads two ports. No test writes to it."""
    folder = tmp_path_factory.mktemp("west")
    config = line(folder, "west", port=7447)
    config.write_text(config.read_text() + ENCODER.format(port="ttyACM0") + GNSS.format(port="ttyACM1"))
    assert install(folder / "root", "--roles", "encoder,gnss", config=config).returncode == 0
    (folder / "root/dev/serial/by-id").mkdir(parents=True)
    (folder / "root/dev/serial/by-id/usb-1").symlink_to("../../ttyACM0")
    return folder / "root"


@pytest.mark.parametrize(
    ("section", "roles", "port", "said"),
    [
        (ENCODER, "encoder", "ttyACM0", "encoder of line 'south' would read /dev/ttyACM0, which the encoder of line"),
        (GNSS, "gnss", "ttyACM1", "gnss of line 'south' would read /dev/ttyACM1, which the gnss of line 'west' reads"),
        (GNSS, "gnss", "ttyACM0", "which the encoder of line 'west' reads: name a port of its own in gnss.source, or"),
        (GNSS, "gnss", "serial/by-id/usb-1", "gnss of line 'south' would read /dev/serial/by-id/usb-1, which the enc"),
        (GNSS, "gnss", "ttyACM2", ""),
        (GNSS, "camera", "ttyACM0", ""),
        (ENCODER.replace("serial", "counter"), "encoder", "ttyACM0", ""),
    ],
)
def test_two_lines_do_not_read_one_serial_port(
    tmp_path: Path, west: Path, section: str, roles: str, port: str, said: str
) -> None:
    """Each would get a part of what the device sends. A link of udev's is the port that it leads to."""
    root = Path(shutil.copytree(west, tmp_path / "root", symlinks=True))
    south = line(tmp_path, "south", port=7448)
    south.write_text(south.read_text() + section.format(port=port))
    before, done = contents(root), install(root, "--roles", roles, config=south)
    assert (done.returncode, said in done.stderr) == (2 if said else 0, True), done.stderr
    assert not said or contents(root) == before


def test_two_receivers_do_not_write_into_one_folder(tmp_path: Path) -> None:
    """positions.csv is beside the ledger, which may be counted by another host's aggregator."""
    for name, code in (("north", 0), ("south", 2)):
        config = line(tmp_path, name, port=7447, of="north")
        config.write_text(config.read_text() + GNSS.format(port=name))
        done = install(tmp_path / "root", "--roles", "gnss", config=config)
        assert done.returncode == code, done.stderr
    assert "aggregator.out of line 'south' is /var/lib/tuberline/north/ledger, as that of line 'north'" in done.stderr


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
