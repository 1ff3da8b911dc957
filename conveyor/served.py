"""HOST:PORT, where a command serves: the page, metrics, Foxglove's app."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Self

from conveyor.errors import ConfigError

MOST_PORT = 65535
_FORM = re.compile(r"(?:\[([0-9a-fA-F:.]+)\]|([^\s/:\[\]]+)):([0-9]{1,5})")


@dataclass(frozen=True, slots=True)
class ServedAt:
    """An address of this machine; `host` without the brackets of IPv6, `port` 0 takes a free one."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str, *, option: str, example: str) -> Self:
        """Of HOST:PORT.

        Raises:
            ConfigError: it is not; named by `option`.
        """
        found = _FORM.fullmatch(text)
        if found is None or int(found[3]) > MOST_PORT:
            raise ConfigError(
                f"{option} {text} is not HOST:PORT, e.g. {example}; ports are 0 (a free one) to {MOST_PORT}, an IPv6 "
                "host stands in brackets"
            )
        return cls(found[1] or found[2], int(found[3]))

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
