"""Tuberline: counts and weighs every potato on a conveyor, from depth cameras.

The public API. Importing it loads nothing heavy: each name is loaded when it is first used. `docs/api.md` describes
all of them, `docs/examples/` shows them at work. What is not listed here may change without notice.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from conveyor import __version__

if TYPE_CHECKING:
    from aggregator.calibration.together import Together
    from aggregator.ledger.totals_by import Total
    from conveyor.errors import TuberlineError
    from conveyor.geometry import Intrinsics
    from regressor.network.pointraft import PointRaft
    from tuberline.api.recordings import Recording, open_recording, simulate
    from tuberline.api.runs import Ledger, read_ledger, read_totals, replay
    from tuberline.api.weighing import (
        NetworkInputs,
        Weight,
        Weights,
        load_weights,
        prepare,
        weigh,
        weigh_depth,
    )

__all__ = [
    "Intrinsics",
    "Ledger",
    "NetworkInputs",
    "PointRaft",
    "Recording",
    "Together",
    "Total",
    "TuberlineError",
    "Weight",
    "Weights",
    "__version__",
    "load_weights",
    "open_recording",
    "prepare",
    "read_ledger",
    "read_totals",
    "replay",
    "simulate",
    "weigh",
    "weigh_depth",
]

_HOMES = {
    "Intrinsics": "conveyor.geometry",
    "Ledger": "tuberline.api.runs",
    "NetworkInputs": "tuberline.api.weighing",
    "PointRaft": "regressor.network.pointraft",
    "Recording": "tuberline.api.recordings",
    "Together": "aggregator.calibration.together",
    "Total": "aggregator.ledger.totals_by",
    "TuberlineError": "conveyor.errors",
    "Weight": "tuberline.api.weighing",
    "Weights": "tuberline.api.weighing",
    "load_weights": "tuberline.api.weighing",
    "open_recording": "tuberline.api.recordings",
    "prepare": "tuberline.api.weighing",
    "read_ledger": "tuberline.api.runs",
    "read_totals": "tuberline.api.runs",
    "replay": "tuberline.api.runs",
    "simulate": "tuberline.api.recordings",
    "weigh": "tuberline.api.weighing",
    "weigh_depth": "tuberline.api.weighing",
}
"""The module that each public name is loaded from."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tuberline' has no public name '{name}'; it has: {', '.join(__all__)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value  # the next use does not come here
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
