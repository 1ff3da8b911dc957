"""Mail, telephones, chats: whatever apprise reaches, by its own addresses."""

from __future__ import annotations

import logging

from conveyor.errors import ConfigError
from tuberline.alarms.channels import Address, ChannelError, needs_extra
from tuberline.alarms.message import AlarmMessage


class Service:
    """Sends a title and a text to one address of apprise."""

    def __init__(self, address: Address, *, where: str) -> None:
        try:
            import apprise
        except ImportError as error:
            raise needs_extra(f"{address.shown} (apprise)") from error
        logging.getLogger("apprise").setLevel(logging.CRITICAL)  # it would write addresses with their secrets
        self.id, self.shown = address.id, address.shown
        self._apprise = apprise.Apprise(asset=apprise.AppriseAsset(app_id="Tuberline", secure_logging=True))
        if not self._apprise.add(address.url):
            raise ConfigError(
                f"{where}: apprise does not know an address that begins with '{address.shown}'; it is written as "
                "apprise's own documentation says (http, https, mqtt and mqtts are sent without apprise)"
            )

    def send(self, message: AlarmMessage, *, lost_before: int) -> None:
        """Send it; apprise says only whether it went."""
        from apprise import NotifyType

        kind = {"trouble": NotifyType.FAILURE, "warning": NotifyType.WARNING}.get(message.level, NotifyType.INFO)
        if message.event == "end":
            kind = NotifyType.SUCCESS
        if not self._apprise.notify(body=message.body(lost_before=lost_before), title=message.title, notify_type=kind):
            raise ChannelError("apprise could not deliver it")
