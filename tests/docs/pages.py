"""What each page takes for granted when its blocks are typed, and the few lines that are not typed here, with why."""

from __future__ import annotations

from dataclasses import dataclass, field

CLONE = "the test begins with a clone, and with the packages installed: tests/tuberline/test_tuberline_wheel.py"
SUITE = "the suite itself, typed on a fresh clone before anything lands: .ci/run"
MACHINE = (
    "changes a machine as root; python -m deploy.trial types it in one of its own: tests/deploy/test_deploy_trial.py"
)
CLUSTER = "needs a Kubernetes cluster; its files are checked by tests/deploy/test_deploy_containers.py"
DEVICE = "needs a RealSense on this machine; a simulated SDK stands in: tests/camera_sim/test_camera_sim_realsense.py"
DISPLAY = "needs a display; the file is opened by tests/viewer/test_viewer_file.py"
PROXY = "writes to /etc and needs a host's certificate: tests/deploy/test_deploy_remote.py types it elsewhere"
HOSTS = "needs a second host; hosts of their own: tests/deploy/test_deploy_remote_graph.py, python -m benchmarks site"
SCALE = "needs a load that met a scale: tests/aggregator/test_aggregator_calibrate_commands.py weighs one"
DAEMON = "zenohd is in no package index; its files are opened by tests/deploy/test_deploy_access.py"


@dataclass(frozen=True, slots=True)
class Page:
    """How a page is typed.

    Attributes:
        given: what its reader has already; functions of tests/docs/given.py, called in this order.
        words: what of the page stands for something of the reader's own, and what the test puts there.
        shown: beginnings of lines that are not typed, each with one of the reasons above.
        line: name of the line that runs beside the page, from the file line.toml; none where it is empty.
        codes: exit codes of a command, by its beginning, where others than 0 are as good.
    """

    given: tuple[str, ...] = ()
    words: dict[str, str] = field(default_factory=dict)
    shown: dict[str, str] = field(default_factory=dict)
    line: str = ""
    codes: dict[str, tuple[int, ...]] = field(default_factory=dict)


BUSY = {"tuberline doctor": (0, 1)}
"""What doctor finds of a machine depends on its load."""

PAGES: dict[str, Page] = {
    "README.md": Page(given=("cloud",), shown={"git clone": CLONE, "make test": SUITE}),
    "CONTRIBUTING.md": Page(
        given=("packs",),
        shown={"git clone": CLONE, "make test": SUITE, "make lint": SUITE, "make wheel": CLONE},
    ),
    "deploy/zenohd/README.md": Page(shown={"zenohd": DAEMON}),
    "docs/alarms.md": Page(),
    "docs/calibrate.md": Page(given=("recording", "run", "line_file", "bucket"), codes=BUSY),
    "docs/cameras.md": Page(given=("recording",)),
    "docs/config.md": Page(given=("line_file",)),
    "docs/deploy.md": Page(
        shown={
            "sudo python3 -m venv": MACHINE,
            "sudo /opt/tuberline": MACHINE,
            "sudo ln": MACHINE,
            "pip wheel": MACHINE,
            "sudo deploy/install.sh": MACHINE,
            "docker build": MACHINE,
            "cd deploy/docker": MACHINE,
            "for role in": CLUSTER,
            "kubectl": CLUSTER,
        }
    ),
    "docs/design.md": Page(),
    "docs/encoder.md": Page(given=("line_file",), codes=BUSY),
    "docs/evaluation-real.md": Page(given=("shared",)),
    "docs/evaluation-segmentation.md": Page(),
    # A batch of the paper's recipe is 32 views. The equals sign keeps the size from being limited.
    "docs/evaluation.md": Page(
        words={
            "PACK": "packs/test-field",
            "TRAIN": "packs/easy",
            "VAL": "packs/field",
            "--tubers 1250": "--tubers=20",
        }
    ),
    "docs/exports.md": Page(given=("recording", "run", "contract", "today")),
    "docs/first-line.md": Page(
        given=("recordings_folder",),
        shown={
            "git clone": CLONE,
            "source .venv": CLONE,
            "pip install": CLONE,
            **dict.fromkeys(
                (f"tuberline {word}" for word in ("init line.toml --realsense", "config check line.toml")), DEVICE
            ),
            **{
                f"tuberline {word} --config line.toml": DEVICE
                for word in ("doctor", "top", "page", "watch", "recorder")
            },
            "tuberline run line.toml": DEVICE,
        },
        codes=BUSY,
    ),
    "docs/fleet.md": Page(given=("recording", "run", "database")),
    "docs/formats.md": Page(given=("recording", "foreign_frames", "clouds")),
    "docs/index.md": Page(given=("recording",)),
    "docs/layers.md": Page(),
    "docs/ledger.md": Page(given=("recording", "run_today", "bucket")),
    "docs/loads.md": Page(
        given=("recording", "run_today"),
        line="line",
        shown={'tuberline calibrate load runs/today --load "trailer 7"': SCALE},
    ),
    "docs/map.md": Page(given=("recording", "run", "track")),
    "docs/operate.md": Page(given=("recording", "other_weights"), line="line"),
    "docs/otherworld.md": Page(),
    "docs/performance.md": Page(given=("recording",)),
    # A batch of the paper's recipe is 32 views here, too.
    "docs/pointraft.md": Page(
        given=("checkpoint", "twin", "apples", "packs", "cloud", "shared"), words={"--tubers 2500": "--tubers=20"}
    ),
    "docs/remote.md": Page(
        given=("recording", "two_lines"),
        line="north",
        words={"10.0.0.1:9180": "127.0.0.1:9181"},
        shown={
            "tuberline watch tls/": HOSTS,
            "sudo deploy/proxy/make": PROXY,
            "printf": PROXY,
            "sudo cp deploy/proxy": PROXY,
            "sudo systemctl enable --now proxy": PROXY,
            "TUBERLINE_SCREENSHOT": SUITE,
        },
    ),
    "docs/reproduce.md": Page(given=("checkpoint", "twin", "shared")),
    "docs/scale.md": Page(
        given=("recording", "two_lines", "router", "graphviz"),
        shown={
            "pip install": CLONE,
            "scp": HOSTS,
            "tuberline regressor --config /etc": HOSTS,
        },
    ),
    "docs/security.md": Page(given=("line_file",)),
    "docs/segmentation.md": Page(given=("recording",)),
    "docs/sizes.md": Page(given=("recording", "contract")),
    # Twenty recordings of 25 tubers without soil. The equals sign keeps the size from being limited.
    "docs/train.md": Page(given=("cloud",), words={"--tubers 4000": "--tubers=1050"}),
    "docs/troubleshoot.md": Page(given=("recording", "run"), line="line", codes=BUSY),
    "docs/viewer.md": Page(
        given=("recording", "run", "two_lines", "page_token", "hub"),
        line="north",
        shown={"rerun load.rrd": DISPLAY, "ssh -L": HOSTS},
    ),
    "docs/worlds.md": Page(),
    "docs/yield.md": Page(),
    "docs/reliability.md": Page(),
}
"""Every page that has a block to type or to run, and those whose figures other blocks write."""

ELSEWHERE = {
    "docs/api.md": "tests/tuberline/test_tuberline_api.py runs docs/examples, which the page shows",
    "docs/commands.md": "tests/conveyor/test_conveyor_docs.py: what each command is given, nothing to type",
    "docs/walks.md": "tests/walks/test_walks.py",
}
"""Pages that another test types."""
