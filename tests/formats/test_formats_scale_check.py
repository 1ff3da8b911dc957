"""A depth scale is judged by where the belt is said to be, also where only the rods of a web lie there."""

from __future__ import annotations

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats.scale_check import check_depth_scale
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

BELT_M, GROUND_M = 0.46, 0.62


def web(rods: int) -> Frame:
    """A frame of 100 rows: so many of rods at the belt, the ground between them."""
    depth = np.full((100, 100), round(GROUND_M / 0.001), dtype=np.uint16)
    depth[:rods] = round(BELT_M / 0.001)
    return Frame("c", "r", 0, 0, None, 0.001, Intrinsics(100, 100, 90.0, 90.0, 50.0, 50.0), BELT_M, depth)


def test_rods_where_the_belt_is_said_to_be_are_enough() -> None:
    check_depth_scale(web(12), where="web")
    with pytest.raises(InputError, match=r"median depth is 0\.62 m but the belt is said to be 0\.46 m"):
        check_depth_scale(web(0), where="ground alone")
