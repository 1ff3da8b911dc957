"""Fixtures of the deployment tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from conveyor.access import router_access
from conveyor.config import LineConfig
from conveyor.session import open_router
from conveyor.taken_port import free_port
from tests.deploy.deploy_site import Site, make_certs, site_config


@pytest.fixture(scope="session")
def site_certs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificates of one site, made once."""
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    folder = tmp_path_factory.mktemp("certs")
    make_certs(site_config(1, folder), folder)
    return folder


@pytest.fixture(scope="module")
def site_config_running(site_certs: Path) -> Iterator[LineConfig]:
    """The config of a line with TLS and access control whose router runs; one router for a file of tests."""
    config = site_config(free_port(), site_certs)
    router = open_router(config.link, access_control=router_access(config))
    yield config
    router.close()


@pytest.fixture
def site(site_config_running: LineConfig, site_certs: Path) -> Iterator[Site]:
    """That line; sessions that joined are closed after each test."""
    with ExitStack() as stack:
        yield Site(site_config_running, site_certs, stack)
