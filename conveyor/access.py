"""Access control made from the topic table: each node may do what its row says, and nothing else.

The rules are Zenoh's (`access_control` of a router): default deny, subjects by the common name in the certificate.
Three things are easy to forget, and without them the delivery classes fail silently:

* a sender must be told who listens (`declare_subscriber` on its way out of the router), or it never sends;
* kept and never-lost topics live on three more kinds of key under `<key>/@adv/`: the cache that answers queries, the
  heartbeat, and the token by which late publishers are found. `**` does not match the chunk `@adv`;
* every exchange has two directions: into the router (ingress) from who acts, out of it (egress) to who is reached.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.errors import ConfigError
from conveyor.identity import SHARED, Identity
from conveyor.session import ENCRYPTED
from conveyor.topics import Delivery, Topic

IN, OUT = "ingress", "egress"
_RECOVERED = (Delivery.KEPT, Delivery.NEVER_LOST)
_CAMERA_ROLES = ("camera", "segmenter")
"""Roles whose node is named after its camera and may only touch that camera's topics."""


@dataclass(frozen=True, slots=True)
class Grant:
    """`messages` may pass the router in one direction on keys that `keys` include."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]


def line_identities(config: LineConfig) -> tuple[Identity, ...]:
    """Everybody who may connect to the line's router."""
    extra = config.access
    named = {
        "camera": sorted(config.cameras),
        "segmenter": sorted(config.cameras),
        "regressor": [*(f"r{n}" for n in range(1, config.regressor.processes + 1)), *extra.regressors],
        "aggregator": [SHARED],
        "viewer": extra.viewers,
        "recorder": extra.recorders,
        "operator": extra.operators,
        "keeper": extra.keepers,
        "loader": extra.loaders,
        "encoder": [*([config.encoder.name] if config.encoder else []), *extra.encoders],
        "gnss": [*([config.gnss.name] if config.gnss else []), *extra.gnss],
    }
    return tuple(dict.fromkeys(Identity(role, name) for role, names in named.items() for name in names))


def known_nodes(config: LineConfig) -> frozenset[str]:
    """'role/name' of every node that stands in the line's config: kept before others where there is no room for all."""
    named = {f"{i.role}/{i.name}" for i in line_identities(config) if i.name != SHARED}
    return frozenset({*named, "aggregator/aggregator", "viewer/viewer"})


def grants(identity: Identity, *, line: str) -> tuple[Grant, ...]:
    """What one node may do, from the topic table alone. Grants without keys are left out."""
    sent = _keys(identity, line, sending=True)
    heard = _keys(identity, line, sending=False)
    recovered_out, recovered_in = _adv(sent, _RECOVERED), _adv(heard, _RECOVERED)
    data_out, data_in = _plain(sent, _DATA), _plain(heard, _DATA)
    tokens_out, tokens_in = _plain(sent, (Delivery.TOKEN,)), _plain(heard, (Delivery.TOKEN,))
    answers, asks = _plain(sent, (Delivery.QUERY,)), _plain(heard, (Delivery.QUERY,))
    cached_out, cached_in = _plain(sent, _RECOVERED), _plain(heard, _RECOVERED)
    own_reports = tuple(key for _, key in _keys(identity, line, sending=True, of=(topics.COUNTERS,)))
    everything = (f"{topics.ROOT}/{line}/**", f"{topics.ROOT}/{line}/**/@adv/**")
    found = (
        # as a sender
        Grant(IN, ("put",), data_out + recovered_out),
        Grant(IN, ("liveliness_token",), tokens_out + recovered_out),
        Grant(IN, ("declare_queryable",), answers + recovered_out),
        Grant(IN, ("reply",), answers + cached_out + recovered_out),
        Grant(OUT, ("declare_subscriber", "query"), everything),
        # as a listener
        Grant(IN, ("declare_subscriber",), data_in + recovered_in),
        Grant(OUT, ("put",), data_in + recovered_in),
        Grant(IN, ("declare_liveliness_subscriber", "liveliness_query"), tokens_in + recovered_in),
        Grant(OUT, ("liveliness_token",), tokens_in + recovered_in),
        Grant(IN, ("query",), asks + recovered_in),
        Grant(OUT, ("reply",), asks + cached_in + recovered_in),
        # to see another node under its own name
        Grant(IN, ("liveliness_query",), tokens_out),
        Grant(OUT, ("liveliness_token",), tokens_out),
        Grant(IN, ("declare_subscriber",), own_reports),
        Grant(OUT, ("put",), own_reports),
    )
    return tuple(grant for grant in found if grant.keys)


def access_control(config: LineConfig) -> dict[str, Any]:
    """Zenoh's `access_control` section for the router of `config`, with everybody who belongs to the line."""
    rules, subjects, policies = [], [], []
    for identity in line_identities(config):
        subject = identity.common_name(config.name)
        ids = []
        for n, grant in enumerate(grants(identity, line=config.name), start=1):
            ids.append(f"{identity.stem}/{n}")
            rules.append(
                {
                    "id": ids[-1],
                    "permission": "allow",
                    "flows": [grant.flow],
                    "messages": list(grant.messages),
                    "key_exprs": list(grant.keys),
                }
            )
        subjects.append({"id": identity.stem, "cert_common_names": [subject]})
        policies.append({"rules": ids, "subjects": [identity.stem]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def router_access(config: LineConfig) -> dict[str, Any] | None:
    """The rules a router of this line applies, or None where access control is off.

    Raises:
        ConfigError: enabled on endpoints that prove no identity.
    """
    if not config.access.enabled:
        return None
    endpoints = config.link.listen or (config.link.router,)
    if not any(endpoint.startswith(ENCRYPTED) for endpoint in endpoints):
        raise ConfigError(
            f"access.enabled needs an endpoint with certificates, got {', '.join(endpoints)}: make it tls/HOST:PORT "
            "and set link.certs (`tuberline certs make`)"
        )
    return access_control(config)


_DATA = (Delivery.LATEST, Delivery.KEPT, Delivery.NEVER_LOST, Delivery.DISPATCHED)


def _keys(
    identity: Identity, line: str, *, sending: bool, of: Iterable[Topic] = topics.TOPICS
) -> list[tuple[Delivery, str]]:
    """(delivery, key expression) of every topic this node sends or hears; its own name where the row binds it."""
    rows = [t for t in of if identity.role in (t.senders if sending else t.receivers)]
    return [(t.delivery, t.key(line, **_parts(t, identity, sending=sending))) for t in rows]


def _parts(topic: Topic, identity: Identity, *, sending: bool) -> dict[str, str]:
    own = {"source": identity.name, "role": identity.role, "name": identity.name} if sending else {}
    if identity.role == "gnss" and sending:
        own["receiver"] = identity.name
    if identity.role in _CAMERA_ROLES:
        own["camera"] = identity.name
    if identity.role == "regressor" and (sending or topic.delivery is not Delivery.QUERY):
        own["regressor"] = identity.name  # what it asks of others has the other's name
    return {part: own.get(part, SHARED) for part in topic.part_names}


def _plain(keys: list[tuple[Delivery, str]], classes: tuple[Delivery, ...]) -> tuple[str, ...]:
    return tuple(key for delivery, key in keys if delivery in classes)


def _adv(keys: list[tuple[Delivery, str]], classes: tuple[Delivery, ...]) -> tuple[str, ...]:
    return tuple(f"{key}/@adv/**" for key in _plain(keys, classes))
