"""The options that say where a line is watched, the same for all commands that watch one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cyclopts import Parameter

from conveyor.config import LineConfig, LinkConfig, load_config
from conveyor.config_base import checked_endpoint
from conveyor.errors import ConfigError
from conveyor.topics import check_name


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class LineAddress:
    """A line by its config, or by an endpoint and its name.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router, e.g. tcp/10.0.0.1:7447; instead of a config, or of the one that the config names.
    line
        Name of the line, where no config says it.
    """

    config: Path | None = None
    connect: str | None = None
    line: str | None = None

    def loaded(self) -> LineConfig:
        """The line's settings, defaults where there is no config."""
        return load_config(self.config) if self.config else LineConfig()

    def watched(self) -> LineConfig:
        """The line's settings with the router and the name that were given beside them."""
        settings = self.loaded()
        link = settings.link.model_copy(update=self._router())
        return settings.model_copy(update={"link": link, "name": self._name(settings)})

    def link(self) -> tuple[LinkConfig, str]:
        """How to reach the line, and its name."""
        settings = self.loaded()
        changed = {"connect_timeout_s": 5.0, **self._router()}
        return settings.link.model_copy(update=changed), self._name(settings)

    def _name(self, settings: LineConfig) -> str:
        """The name that was given, else that of the config; raises ConfigError where no line can have it."""
        return settings.name if self.line is None else check_name(self.line, what="line")

    def _router(self) -> dict[str, str]:
        """The router that was given beside the config; raises ConfigError where it is none."""
        return {} if self.connect is None else {"router": endpoint(self.connect)}


def endpoint(text: str) -> str:
    """`text` where it is one of a router; raises ConfigError where it is none."""
    try:
        return checked_endpoint(text)
    except ValueError as error:
        raise ConfigError(str(error)) from error


NO_ADDRESS = LineAddress()
"""The line 'line' at the router that a config names by default."""
