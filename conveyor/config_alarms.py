"""The section [alarms] of a line's file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from conveyor.config_base import Section


class AlarmsConfig(Section):
    """Alarms that leave the page: where they go, and from when on something is one.

    An address is http(s)://... (a JSON POST), mqtt(s)://broker[:port]/topic, or any that apprise knows.
    """

    channels: tuple[str, ...] = Field((), max_length=16, description="addresses that hold no secret, http or mqtt")
    channels_file: Path | None = Field(
        None, description="file with one address a line, for those with passwords or tokens (mailto://, tgram://, ...)"
    )
    root_ca: Path | None = Field(None, description="certificate authority of this site's https and mqtts servers")
    least: Literal["note", "warning", "trouble"] = Field("warning", description="less severe ones stay on the page")
    coverage_below: float = Field(0.95, ge=0, le=1, description="an alarm where less of the belt was looked at")
    after_s: float = Field(5.0, ge=0, le=3600, description="what passes sooner is no alarm")
    clear_s: float = Field(10.0, ge=0, le=3600, description="an alarm has ended when it was away for so long")
    again_after_s: float = Field(30.0, ge=0, le=86400, description="least time between two beginnings of one alarm")
    keep: int = Field(1000, ge=10, le=100000, description="messages kept per channel while it cannot be reached")
    state_dir: Path | None = Field(None, description="where they are kept; default: alarms/ in aggregator.out")

    @field_validator("channels")
    @classmethod
    def _no_secrets(cls, channels: tuple[str, ...]) -> tuple[str, ...]:
        for channel in channels:
            scheme, _, rest = channel.partition("://")
            if scheme not in ("http", "https", "mqtt", "mqtts") or "@" in rest.partition("/")[0]:
                raise ValueError(
                    "only http(s):// and mqtt(s):// addresses without a password stand here, since this file is copied "
                    "to results and bundles; put all others into the file that alarms.channels_file names, one a line"
                )
        return channels

    @model_validator(mode="after")
    def _somewhere(self) -> AlarmsConfig:
        if not self.channels and self.channels_file is None:
            raise ValueError('name where alarms go: channels = ["https://..."] or channels_file = "alarms.txt"')
        return self
