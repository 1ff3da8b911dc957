"""`make images`: the base, the images, what is in them, and a line of them. See --help."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from time import monotonic

from deploy.trial import base, containers, contents
from deploy.trial.engine import LIMITS, SPACE, TOOLS, Engine
from deploy.trial.pipsettings import write_settings
from deploy.trial.tools import (
    ROOT,
    TrialError,
    alone,
    ended,
    into_docs,
    need_root,
    need_tools,
    say,
    table,
    version,
    workdir,
)

BASE = "docker.io/library/python:3.11-slim-bookworm"
OWN_BASE = "localhost/tuberline-base:bookworm"
IMAGES = {
    "edge": "tuberline-edge",
    "node": "tuberline",
    "camera": "tuberline-camera",
    "alarms": "tuberline-alarms",
    "viewer": "tuberline-viewer",
}
FOR = {
    "edge": "segmenter, aggregator, page, metrics, recordings as cameras",
    "node": "regressor, and all the rest",
    "camera": "RealSense and ROS 2 cameras, encoder, GNSS receiver",
    "alarms": "alarms by MQTT, mail, telephones and chats",
    "viewer": "viewer",
}
BUILT_WITH = ("buildah", "podman", "runc")
MOST_MB = {"edge": 740}
"""It was 700 until the classifier went to onnxruntime, which answers in half the time and takes 35 MB."""
SHUT = ("--read-only", "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--tmpfs", "/tmp:size=64m", *LIMITS)
INSIDE = """
import os, pathlib
status = dict(line.split(":\\t", 1) for line in open("/proc/self/status") if ":\\t" in line)
assert os.getuid() == 10001 and os.getgid() == 10001, "not root"
assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0, "no capability"
assert status["NoNewPrivs"].strip() == "1"
for folder in ("/", "/opt/tuberline", "/etc", "/usr/bin"):
    try:
        pathlib.Path(folder, "written").write_text("x")
    except OSError:
        continue
    raise SystemExit(f"{folder} can be written")
for folder in ("/var/lib/tuberline", "/var/cache/tuberline", "/tmp"):
    pathlib.Path(folder, "written").write_text("x")
print("shut")
"""


def make_base(engine: Engine) -> str:
    """Name of the base image: the public one where it can be pulled, else a Debian root of our own."""
    if engine.has(OWN_BASE):
        return OWN_BASE
    engine.buildah("pull", BASE, check=False)
    if engine.has(BASE):
        return BASE
    say(f"{BASE} cannot be pulled: making a base")
    root = base.debian_root(engine.folder / "base", base.FOR_IMAGES)
    container = engine.buildah("from", "scratch")
    engine.buildah("add", "--quiet", container, root, "/")
    engine.buildah("commit", "--quiet", "--rm", container, OWN_BASE)
    return OWN_BASE


def build(engine: Engine, target: str, base_image: str) -> float:
    """Build one image with its version as tag; returns seconds."""
    conf = engine.folder / "pip.conf"
    mounts = [f"{path}:{path}:ro" for path in write_settings(conf)] + [f"{conf}:/etc/pip.conf:ro"]
    words: list[str | Path] = ["build", "--isolation", "chroot", "--layers", "--pull-never", "--target", target]
    for mount in mounts:
        words += ["--volume", mount]
    words += ["--build-arg", f"BASE={base_image}", "--ignorefile", ROOT / "deploy/docker/Dockerfile.dockerignore"]
    words += ["--label", f"org.opencontainers.image.version={version()}", "--file", ROOT / "deploy/docker/Dockerfile"]
    start = monotonic()
    engine.buildah(*words, "--tag", name_of(target), ROOT)
    return monotonic() - start


def name_of(target: str) -> str:
    return f"localhost/{IMAGES[target]}:{version()}"


def check_image(engine: Engine, target: str) -> None:
    """Run it as it is meant to run, and try what must not be possible."""
    name = name_of(target)
    said = engine.podman("run", "--rm", *SHUT, name, "--version").stdout.strip()
    if said != version():
        raise TrialError(f"{name} says version {said}, not {version()}")
    done = engine.podman("run", "--rm", *SHUT, "--entrypoint", "python", name, "-c", INSIDE, check=False)
    if done.stdout.strip() != "shut":
        raise TrialError(f"{name} is not shut: {done.stderr.strip()[-300:]}")
    size = engine.size_mb(name)
    if size > MOST_MB.get(target, size):
        raise TrialError(f"{name} takes {size} MB, more than {MOST_MB[target]}")
    if target == "edge":
        words = ("train", "--data", "/none", "--val", "/none", "--out", "/var/lib/tuberline/none")
        refused = engine.podman("run", "--rm", *SHUT, name, *words, check=False)
        if refused.returncode != 2 or "needs torch" not in refused.stderr or len(refused.stderr.splitlines()) > 1:
            raise TrialError(f"the edge image should refuse to train in a sentence, said: {refused.stderr[-300:]}")
        say(f"edge: {refused.stderr.strip()}")
    if target == "camera":
        words = ("init", "/var/lib/tuberline/line.toml", "--realsense")
        asked = engine.podman("run", "--rm", *SHUT, name, *words, check=False)
        if "no RealSense camera is connected" not in asked.stderr:
            raise TrialError(f"the camera image should look for cameras and find none, said: {asked.stderr[-300:]}")
        engine.podman("run", "--rm", *SHUT, "--entrypoint", "python", name, "-c", "import pynmeagps, rosbags, serial")
        say("camera: the SDK looks for cameras; what ROS 2 and serial ports need is there")
    if target == "alarms":
        engine.podman("run", "--rm", *SHUT, "--entrypoint", "python", name, "-c", "import apprise, paho.mqtt.client")


def demo(engine: Engine) -> tuple[str, float]:
    """`tuberline demo` inside the node image: (what it counted, seconds)."""
    start = monotonic()
    done = engine.podman(
        *("run", "--rm", *SHUT, "--network", "none", name_of("node"), "demo", "--out", "/var/lib/tuberline/demo")
    )
    line = next(text for text in (done.stdout + done.stderr).splitlines() if "48" in text)
    return line.strip(), monotonic() - start


def make_images(engine: Engine) -> str:
    """Build, check and look into each image; the table."""
    base_image = make_base(engine)
    rows = []
    for target, image in IMAGES.items():
        seconds = build(engine, target, base_image)
        check_image(engine, target)
        found = contents.bill(engine, name_of(target), engine.folder / f"{image}.cdx.json")
        rows.append((f"`{image}`", FOR[target], engine.size_mb(name_of(target)), round(seconds), *found))
        say(f"{name_of(target)}: {rows[-1][2]} MB in {seconds:.0f} s")
    say(contents.audit(engine, name_of("node"), engine.folder / "audit.json"))
    return table(("image", "for", "size MB", "built in s", "Python packages", "Debian packages"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(prog="make images", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="keep the storage, so that a next build is quick")
    parser.add_argument("--only", choices=("images", "line"), help="build and look into the images, or run them")
    given = parser.parse_args()
    need_tools({**TOOLS, "debootstrap": "debootstrap"})
    folder = workdir("images")
    need_root("make images", f"it builds under {folder} and runs containers in a network namespace of its own")
    engine = Engine(folder)
    with alone(SPACE):
        try:
            if given.only in (None, "images"):
                into_docs("images", make_images(engine), BUILT_WITH)
            if given.only in (None, "line"):
                counted, seconds = demo(engine)
                say(f"demo in the image: {counted} ({seconds:.0f} s)")
                into_docs("containers", containers.trial(engine, name_of, SHUT), BUILT_WITH)
        finally:
            engine.close()
            if not given.keep:
                engine.remove()
                shutil.rmtree(folder / "base", ignore_errors=True)
                (folder / "base.ready").unlink(missing_ok=True)


if __name__ == "__main__":
    ended(main)
