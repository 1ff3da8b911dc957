"""What is in an image: a CycloneDX bill of materials, and a look at known vulnerabilities where a database answers."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from deploy.trial.engine import LIMITS, Engine
from deploy.trial.pipsettings import settings, write_settings
from deploy.trial.tools import TrialError, say

PACKAGES = ("cyclonedx-bom==7.5.0", "pip-audit==2.10.1")
TOOLS = "/opt/bill"
SITE_PYTHON = "/opt/tuberline/bin/python"
SITE = "/opt/tuberline/lib/python3.11/site-packages"


def bill(engine: Engine, image: str, file: Path) -> tuple[int, int]:
    """Write what `image` holds as CycloneDX JSON; returns how many Python and how many Debian packages."""
    made = _inside(engine, image, "python", "-m", "cyclonedx_py", "environment", "--output-reproducible", SITE_PYTHON)
    document: dict[str, Any] = json.loads(made)
    python = len(document.setdefault("components", []))
    listed = engine.podman(
        *("run", "--rm", *LIMITS, "--entrypoint", "dpkg-query", image),
        *("--show", "--showformat", "${Package}\t${Version}\t${Architecture}\n"),
    ).stdout
    debian = [line.split("\t") for line in listed.splitlines()]
    document["components"] += [
        {
            "type": "library",
            "bom-ref": f"deb:{name}",
            "name": name,
            "version": version,
            "purl": f"pkg:deb/debian/{name}@{version}?arch={architecture}",
        }
        for name, version, architecture in debian
    ]
    file.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return python, len(debian)


def audit(engine: Engine, image: str, file: Path) -> str:
    """Ask the vulnerability databases that pip-audit knows; where none answers, write the list of what to check."""
    words = ("pip-audit", "--path", SITE, "--format", "json", "--progress-spinner", "off", "--timeout", "20")
    for service in ("osv", "pypi"):
        done = _tool(engine, image, *words, "--vulnerability-service", service)
        try:
            found = json.loads(done.stdout)["dependencies"]
        except (ValueError, KeyError):
            said = done.stderr.strip().splitlines() or ["nothing said"]
            say(f"pip-audit: {service} gave no answer: {said[-1][-200:]}")
            continue
        checked = [p for p in found if "skip_reason" not in p]
        if not checked:  # a mirror without the database's pages
            say(f"pip-audit: {service} knows none of {len(found)} packages")
            continue
        file.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        bad = [f"{p['name']} {p['version']}: {v['id']}" for p in checked for v in p.get("vulns", [])]
        asked = f"{len(checked)} of {len(found)} packages"
        return f"audit ({service}): {asked} checked, {len(bad)} known vulnerabilities {'; '.join(bad)}"
    listed = file.with_suffix(".txt")
    listed.write_text(_inside(engine, image, "python", "-c", FROZEN), encoding="utf-8")
    return f"audit: no database answers here; what to check is in {listed}: pip-audit --no-deps -r {listed.name}"


FROZEN = f"""
from importlib.metadata import distributions
print(*sorted({{f"{{d.name}}=={{d.version}}" for d in distributions(path=["{SITE}"])}}, key=str.lower), sep="\\n")
"""


def _inside(engine: Engine, image: str, *words: str) -> str:
    done = _tool(engine, image, *words)
    if done.returncode != 0:
        raise TrialError(f"{' '.join(words)[:80]} in {image}: {done.stderr.strip()[-300:]}")
    return done.stdout


def _tool(engine: Engine, image: str, program: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a tool of an environment of its own beside the image's; it is made on first use, with the image's Python."""
    tools, conf = engine.folder / "tools", engine.folder / "pip.conf"
    lent = [f"--volume={path}:{path}:ro" for path in write_settings(conf)] + [f"--volume={conf}:/etc/pip.conf:ro"]
    lent += [f"--env=REQUESTS_CA_BUNDLE={path}" for path in settings().get("cert", [])]
    base = ("run", "--rm", "--user", "0", *LIMITS, "--network", "host", f"--volume={tools}:{TOOLS}", *lent)
    base += ("--entrypoint",)
    if not (tools / "bin/pip-audit").exists():
        tools.mkdir(exist_ok=True)
        engine.podman(*base, "/usr/bin/env", image, "python3", "-m", "venv", TOOLS)
        engine.podman(*base, f"{TOOLS}/bin/pip", image, "install", "--quiet", *PACKAGES)
    return engine.podman(*base, f"{TOOLS}/bin/{program}", image, *words, check=False)
