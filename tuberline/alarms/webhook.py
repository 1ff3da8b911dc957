"""A plain webhook: one JSON POST a message."""

from __future__ import annotations

import base64
import contextlib
import http.client
import json
import socket
import ssl
import threading
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

LATER = frozenset({408, 425, 429})
"""Answers of a server that has no time now; all others below 500 last until somebody corrects something."""


class Webhook:
    """Posts to one address. A redirection is an error: it would turn the POST into a GET."""

    def __init__(self, address: Address, tls: ssl.SSLContext, *, within_s: float = WITHIN_S) -> None:
        self.id, self.shown = address.id, address.shown
        parts = address.parts
        host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
        at = f"{host}:{parts.port}" if parts.port else f"{host}"
        path, query = quote(parts.path or "/", safe=PLAIN), quote(parts.query, safe=PLAIN)
        self._url = urlunsplit((parts.scheme, at, path, query, ""))
        self._headers = {"Content-Type": "application/json", "User-Agent": f"tuberline/{__version__}"}
        if address.login is not None:
            self._headers["Authorization"] = "Basic " + base64.b64encode(":".join(address.login).encode()).decode()
        self._within_s = within_s
        self._opener = urllib.request.build_opener(_Http(), _Https(tls), _NoRedirection())

    def send(self, message: AlarmMessage, *, lost_before: int) -> None:
        """Post it; any answer of 200 to 299 means taken."""
        body = json.dumps(message.as_dict(lost_before=lost_before)).encode()
        request = urllib.request.Request(
            self._url, body, {**self._headers, "Idempotency-Key": message.id}, method="POST"
        )
        try:
            self._opener.open(request, timeout=self._within_s).close()
        except urllib.error.HTTPError as error:
            error.close()
            kind = RefusedError if error.code in NEVER else ChannelError
            lasting = error.code < 500 and error.code not in LATER
            raise kind(f"it answers {error.code} {error.reason}", lasting=lasting) from error
        except urllib.error.URLError as error:  # a certificate that is not believed is a ValueError too
            raise ChannelError(str(error.reason), lasting=isinstance(error.reason, ValueError)) from error
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise ChannelError(str(error) or type(error).__name__, lasting=isinstance(error, ValueError)) from error


class _Cut(http.client.HTTPConnection):
    """A connection that is cut when it has lasted for its timeout: urllib's own is one of each read, and a server that
    drips its answer would hold us for as long as it likes.
    """

    def __init__(self, host: str, **given: Any) -> None:
        super().__init__(host, **given)
        self._late = threading.Event()
        self._watch = threading.Timer(given["timeout"], self._cut)
        self._watch.daemon = True

    def connect(self) -> None:
        self._watch.start()
        super().connect()

    def getresponse(self) -> http.client.HTTPResponse:
        try:
            return super().getresponse()
        except (OSError, http.client.HTTPException) as error:
            if self._late.is_set():
                raise TimeoutError(f"it does not answer within {self.timeout:g} s") from error
            raise
        finally:
            self._watch.cancel()

    def _cut(self) -> None:
        self._late.set()
        if (sock := self.sock) is not None:
            with contextlib.suppress(OSError):  # it has just closed
                socket.socket.shutdown(sock, socket.SHUT_RDWR)


class _CutTls(_Cut, http.client.HTTPSConnection):
    """The same, encrypted."""


class _Http(urllib.request.HTTPHandler):
    def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_Cut, request)


class _Https(urllib.request.HTTPSHandler):
    def __init__(self, tls: ssl.SSLContext) -> None:
        super().__init__(context=tls)
        self._tls = tls

    def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_CutTls, request, context=self._tls)


class _NoRedirection(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        return None
