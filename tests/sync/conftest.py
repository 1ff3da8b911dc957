"""A PostgreSQL of a test's own, as it is after its installation."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.sync.postgres import Postgres


@pytest.fixture(scope="module")
def server() -> Iterator[Postgres]:
    server = Postgres()
    server.start()
    yield server
    server.remove()


@pytest.fixture
def empty(server: Postgres) -> Postgres:
    """The server without anything of ours."""
    psycopg = pytest.importorskip("psycopg")
    with psycopg.connect(server.url, autocommit=True) as connection:
        connection.execute("DROP SCHEMA IF EXISTS tuberline CASCADE")
    return server
