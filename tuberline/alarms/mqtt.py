"""MQTT: one JSON message on the address's topic, at least once (QoS 1), taken when the broker says so."""

from __future__ import annotations

import json
import ssl
import threading
from typing import Any

from tuberline.alarms.channels import WITHIN_S, Address, ChannelError, needs_extra
from tuberline.alarms.message import AlarmMessage

PORTS = {"mqtt": 1883, "mqtts": 8883}
LATER = ("server unavailable", "server busy", "quota exceeded", "connection rate exceeded", "unspecified error")
"""What a broker says that may take it later; all else is of the login, the name or the rights."""


class Mqtt:
    """Publishes to one broker. Alarms are rare: each message connects, waits for its receipt, and leaves."""

    def __init__(self, address: Address, tls: ssl.SSLContext) -> None:
        try:
            import paho.mqtt.client  # noqa: F401
        except ImportError as error:
            raise needs_extra("MQTT") from error
        self.id, self.shown = address.id, address.shown
        parts = address.parts
        self._host, self._port = parts.hostname or "", parts.port or PORTS[parts.scheme]
        self._login, self._tls = address.login, tls if parts.scheme == "mqtts" else None
        self._topic = parts.path.strip("/")

    def send(self, message: AlarmMessage, *, lost_before: int) -> None:
        """Publish it and wait for the broker's receipt."""
        from paho.mqtt import client as mqtt
        from paho.mqtt.enums import CallbackAPIVersion

        client = mqtt.Client(CallbackAPIVersion.VERSION2)
        client.connect_timeout = WITHIN_S
        if self._login is not None:
            client.username_pw_set(*self._login)
        if self._tls is not None:
            client.tls_set_context(self._tls)
        answered = threading.Event()
        answer: list[Any] = []

        def on_connect(_client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
            answer.append(reason)
            answered.set()

        client.on_connect = on_connect
        try:
            client.connect(self._host, self._port)
            client.loop_start()
            if not answered.wait(WITHIN_S):
                raise ChannelError("the broker does not answer")
            if answer[0].is_failure:
                raise ChannelError(f"the broker refuses: {answer[0]}", lasting=str(answer[0]).lower() not in LATER)
            body = json.dumps(message.as_dict(lost_before=lost_before))
            receipt = client.publish(self._topic, body, qos=1)
            receipt.wait_for_publish(WITHIN_S)
            if not receipt.is_published():
                raise ChannelError("the broker gives no receipt")
        except (OSError, ValueError, RuntimeError) as error:
            raise ChannelError(str(error) or type(error).__name__, lasting=isinstance(error, ValueError)) from error
        finally:
            client.disconnect()
            client.loop_stop()
