"""Is what goes on what was begun? Settings and data of a training or search that was stopped, against those of now."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from regressor.training.cloudset import CloudSet

FREE = ("device",)
"""Settings that may differ: they change where a step is computed and not what it is."""


def differences(begun: Mapping[str, Any], given: Mapping[str, Any]) -> list[str]:
    """'lr 0.001, now 0.01' for every setting that both know and that differs; parts of a setting by their own names."""
    before, now = dict(_flat(begun)), dict(_flat(given))
    return [
        f"{name} {before[name]}, now {now[name]}"
        for name in before
        if name in now and name not in FREE and before[name] != now[name]
    ]


def digest_of(data: CloudSet) -> str:
    """Of the views, in their order: another set, or the same in another order, has another one."""
    digest = hashlib.sha256()
    for column in (data.weight_g, data.height_m, data.points_in_cloud):
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:16]


def _flat(settings: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value)
        else:
            yield name, value
