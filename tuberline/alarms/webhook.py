"""A plain webhook: one JSON POST a message."""

from __future__ import annotations

import base64
import http.client
import json
import ssl
import urllib.error
import urllib.request
from typing import Any
from urllib.parse import quote, urlunsplit

from conveyor import __version__
from tuberline.alarms.channels import WITHIN_S, Address, ChannelError, RefusedError
from tuberline.alarms.message import AlarmMessage

PLAIN = "/%:@!$&'()*+,;=?~"
"""What stands in an address as it is; umlauts and blanks are written by their bytes, as browsers do."""
NEVER = frozenset({400, 413, 415, 422})
"""Answers that say that this message is wrong; others (a wrong path, a wrong key) are corrected at the server."""


class Webhook:
    """Posts to one address. A redirection is an error: it would turn the POST into a GET."""

    def __init__(self, address: Address, tls: ssl.SSLContext) -> None:
        self.id, self.shown = address.id, address.shown
        parts = address.parts
        host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
        at = f"{host}:{parts.port}" if parts.port else f"{host}"
        path, query = quote(parts.path or "/", safe=PLAIN), quote(parts.query, safe=PLAIN)
        self._url = urlunsplit((parts.scheme, at, path, query, ""))
        self._headers = {"Content-Type": "application/json", "User-Agent": f"tuberline/{__version__}"}
        if address.login is not None:
            self._headers["Authorization"] = "Basic " + base64.b64encode(":".join(address.login).encode()).decode()
        self._opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=tls), _NoRedirection())

    def send(self, message: AlarmMessage, *, lost_before: int) -> None:
        """Post it; any answer of 200 to 299 means taken."""
        body = json.dumps(message.as_dict(lost_before=lost_before)).encode()
        request = urllib.request.Request(
            self._url, body, {**self._headers, "Idempotency-Key": message.id}, method="POST"
        )
        try:
            self._opener.open(request, timeout=WITHIN_S).close()
        except urllib.error.HTTPError as error:
            error.close()
            kind = RefusedError if error.code in NEVER else ChannelError
            raise kind(f"it answers {error.code} {error.reason}") from error
        except urllib.error.URLError as error:
            raise ChannelError(str(error.reason)) from error
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise ChannelError(str(error) or type(error).__name__) from error


class _NoRedirection(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        return None
