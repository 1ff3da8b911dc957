"""Where alarms go: a JSON POST, MQTT, or any service that apprise knows. A channel is made from its address."""

from __future__ import annotations

import hashlib
import logging
import ssl
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol
from urllib.parse import SplitResult, unquote, urlsplit

from conveyor.config_alarms import AlarmsConfig
from conveyor.errors import ConfigError
from conveyor.extras import install_hint
from conveyor.text_files import read_text
from tuberline.alarms.message import AlarmMessage

log = logging.getLogger("alarms")

OWN = ("http", "https", "mqtt", "mqtts")
"""What is sent without apprise."""
MOST_CHANNELS = 16
WITHIN_S = 10.0
"""A server that takes longer is tried again."""


class ChannelError(Exception):
    """It was not taken now; the text says why and holds no secret.

    Attributes:
        lasting: it will not be taken before somebody corrects something: address, key, certificate, or the server.
    """

    def __init__(self, text: str, *, lasting: bool = False) -> None:
        super().__init__(text)
        self.lasting = lasting


class RefusedError(ChannelError):
    """The server will never take this message."""

    def __init__(self, text: str, *, lasting: bool = True) -> None:
        super().__init__(text, lasting=lasting)


class Channel(Protocol):
    """One receiver."""

    @property
    def id(self) -> str:
        """Under which its messages are kept: of its address, without showing it."""

    @property
    def shown(self) -> str:
        """Its address without secrets, for logs."""

    def send(self, message: AlarmMessage, *, lost_before: int) -> None:
        """Hand `message` over; returns when it was taken.

        Raises:
            ChannelError: it was not, or it is not known.
        """


@dataclass(frozen=True, slots=True)
class Address:
    """A channel's address, and what may be shown of it."""

    url: str = field(repr=False)

    @property
    def parts(self) -> SplitResult:
        """Its parts."""
        return urlsplit(self.url)

    @property
    def id(self) -> str:
        """A name for it that does not show it."""
        return hashlib.sha256(self.url.encode()).hexdigest()[:16]

    @property
    def shown(self) -> str:
        """Scheme and host; of a service's address, whose host may be a token, the scheme alone."""
        parts = self.parts
        if parts.scheme not in OWN:
            return f"{parts.scheme}://..."
        return f"{parts.scheme}://{parts.hostname}" + (f":{parts.port}" if parts.port else "")

    @property
    def login(self) -> tuple[str, str] | None:
        """User and password, where it holds them."""
        parts = self.parts
        return None if parts.username is None else (unquote(parts.username), unquote(parts.password or ""))


def open_channels(config: AlarmsConfig) -> tuple[Channel, ...]:
    """The channels of a line.

    Raises:
        ConfigError: an address that cannot be used, or whose library is not installed; shows no secret.
    """
    addresses, tls = check_addresses(config)
    return tuple(_channel(address, where=where, tls=tls) for address, where in addresses)


def check_addresses(config: AlarmsConfig) -> tuple[list[tuple[Address, str]], ssl.SSLContext]:
    """The addresses of a line, each with where it stands, and what encrypts; loads no channel's library.

    Raises:
        ConfigError: as for `open_channels`, but for those that apprise alone can read.
    """
    urls = [(url, "alarms.channels") for url in config.channels]
    if config.channels_file is not None:
        urls += [(url, str(config.channels_file)) for url in read_channels_file(config.channels_file)]
    if not urls or len(urls) > MOST_CHANNELS:
        raise ConfigError(f"alarms: {len(urls)} channels are given; allowed are 1 to {MOST_CHANNELS}")
    if len({url for url, _ in urls}) < len(urls):
        raise ConfigError("alarms: one address is given twice; everything would be sent there twice")
    return [(_checked(url, where=where), where) for url, where in urls], tls_context(config.root_ca)


def _checked(url: str, *, where: str) -> Address:
    address = Address(url)
    try:
        scheme, host = address.parts.scheme, address.parts.hostname
        _ = address.parts.port
        if scheme in OWN:
            (host or "").encode("idna")
    except ValueError as error:  # whose text may hold a part of the password
        raise ConfigError(
            f"{where}: an address cannot be read; it is SCHEME://HOST:PORT/PATH, the port a number from 0 to 65535, an "
            "IPv6 address in brackets, no part of the host's name longer than 63 letters, a password percent-encoded"
        ) from error
    if scheme in OWN and not host:
        raise ConfigError(f"{where}: '{address.shown}' names no host; write e.g. {scheme}://server/tuberline/alarms")
    topic = address.parts.path.strip("/")
    if scheme in ("mqtt", "mqtts") and (not topic or "+" in topic or "#" in url or address.parts.query):
        raise ConfigError(
            f"{where}: {address.shown} needs a topic without + and #, e.g. {address.shown}/tuberline/alarms"
        )
    return address


def _channel(address: Address, *, where: str, tls: ssl.SSLContext) -> Channel:
    scheme = address.parts.scheme
    if scheme in ("http", "https"):
        from tuberline.alarms.webhook import Webhook

        return Webhook(address, tls)
    if scheme in ("mqtt", "mqtts"):
        from tuberline.alarms.mqtt import Mqtt

        return Mqtt(address, tls)
    from tuberline.alarms.services import Service

    return Service(address, where=where)


def tls_context(root_ca: Path | None) -> ssl.SSLContext:
    """The machine's own authorities, and this site's where it has one.

    Raises:
        ConfigError: `root_ca` cannot be read.
    """
    context = ssl.create_default_context()
    if root_ca is not None:
        try:
            context.load_verify_locations(root_ca)
        except OSError as error:
            raise ConfigError(f"alarms.root_ca {root_ca} cannot be read: {error.strerror or error}") from error
    return context


def read_channels_file(path: Path) -> list[str]:
    """The addresses in `alarms.channels_file`, one a line.

    Raises:
        ConfigError: it cannot be read.
    """
    text = read_text(path, what="alarms.channels_file", error=ConfigError)
    if path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH):
        log.warning("%s holds secrets and others may read it: chmod 600", path)
    return [line for raw in text.splitlines() if (line := raw.strip()) and not line.startswith("#")]


def needs_extra(what: str) -> ConfigError:
    """The error where a channel's library is missing."""
    return ConfigError(f"alarms by {what} need one more package; install it {install_hint('alarms')}")
