"""Fixtures of the deployment tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.deploy.deploy_site import Site, make_certs, running_site, site_config


@pytest.fixture(scope="session")
def site_certs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificates of one site, made once."""
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    folder = tmp_path_factory.mktemp("certs")
    make_certs(site_config(1, folder), folder)
    return folder


@pytest.fixture
def site(site_certs: Path, free_port: int) -> Iterator[Site]:
    """A line with TLS and access control whose router runs."""
    with running_site(site_config(free_port, site_certs), site_certs) as site:
        yield site
