"""`tuberline load` where no router is there yet: it waits as long as it was told to, and says that it does."""

from __future__ import annotations

from conveyor.errors import PASSING
from tests.belts import tuberline


def test_an_order_says_that_it_waits_and_how_long(free_port: int) -> None:
    """It gave up after 5 s whatever --wait-s said: the line was just starting."""
    router = f"tcp/127.0.0.1:{free_port}"
    done = tuberline("load", "start", "A", "--connect", router, "--wait-s", "7", check=False)
    waits, ended = done.stderr.splitlines()
    assert waits.startswith(f"tuberline: no answer by {router} yet; asking for 7 s. The order is about the moment")
    assert ended.startswith(f"tuberline: no router answered at {router} within 7 s; start the line")
    assert done.returncode == PASSING
