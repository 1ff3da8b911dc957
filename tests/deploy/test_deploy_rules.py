"""The access rules follow from the topic table: laws over every node and every topic, without a network."""

from __future__ import annotations

from pathlib import Path

import pytest
import zenoh

from conveyor import topics
from conveyor.access import IN, OUT, access_control, grants, line_identities, router_access
from conveyor.config import LineConfig, parse_config
from conveyor.config_yield import GnssConfig
from conveyor.errors import ConfigError
from conveyor.identity import Identity, own_files
from conveyor.topics import Delivery
from tests.deploy.deploy_site import site_config

CONFIG = site_config(1, Path("/nowhere")).model_copy(update={"gnss": GnssConfig(source="file:positions.nmea")})
PARTS = {"camera": "front", "regressor": "r1", "source": "front", "receiver": "gnss", "role": "camera", "name": "front"}


def may(identity: Identity, flow: str, message: str, key: str) -> bool:
    """Some grant lets `message` pass on `key`."""
    return any(
        grant.flow == flow and message in grant.messages and any(zenoh.KeyExpr(k).includes(key) for k in grant.keys)
        for grant in grants(identity, line=CONFIG.name)
    )


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda t: t.name)
def test_only_who_the_table_names_may_write_and_read_a_topic(topic: topics.Topic) -> None:
    key = topic.key(CONFIG.name, **{part: PARTS[part] for part in topic.part_names})
    writes = {Delivery.TOKEN: "liveliness_token", Delivery.QUERY: "declare_queryable"}.get(topic.delivery, "put")
    for identity in line_identities(CONFIG):
        mine = identity.name in ("*", *topic.parts(key).values())
        if may(identity, IN, writes, key):
            assert identity.role in topic.senders
        if topic.delivery not in (Delivery.TOKEN, Delivery.QUERY):
            # A node may read its own report: so it finds another one that lives under its name.
            own = topic is topics.COUNTERS and topic.parts(key) == {"role": identity.role, "name": identity.name}
            assert may(identity, OUT, "put", key) <= (identity.role in topic.receivers or own)
        if identity.role in topic.senders and identity.role in ("camera", "segmenter") and "camera" in topic.part_names:
            assert may(identity, IN, writes, key) == mine
    assert any(may(identity, IN, writes, key) for identity in line_identities(CONFIG) if identity.role != "encoder")


@pytest.mark.parametrize(
    ("node", "foreign"),
    [
        ("camera/front", "camera/rear/frame"),
        ("camera/front", "camera/rear/info"),
        ("camera/front", "camera/rear/info/@adv/pub/1/2/_"),
        ("camera/front", "weight/front"),
        ("camera/front", "counters/camera/rear"),
        ("segmenter/front", "track/rear"),
        ("segmenter/front", "committed/front"),
        ("segmenter/front", "belt/travel/rear"),
        ("regressor/r1", "counters/regressor/r2"),
        ("regressor/r1", "track/front"),
        ("viewer", "totals"),
        ("viewer", "counters/camera/front"),
        ("operator", "totals"),
        ("encoder/wheel", "belt/travel/front"),
    ],
)
def test_nobody_writes_under_another_name(node: str, foreign: str) -> None:
    assert not may(Identity.parse(node), IN, "put", f"tuberline/north/{foreign}")
    assert not may(Identity.parse(node), IN, "reply", f"tuberline/north/{foreign}")


def test_a_regressor_reads_its_own_work_and_no_other() -> None:
    one = Identity.parse("regressor/r1")
    assert may(one, OUT, "put", "tuberline/north/work/r1/view")
    assert not may(one, OUT, "put", "tuberline/north/work/r2/view")
    assert not may(one, OUT, "put", "tuberline/north/camera/front/frame")
    assert may(Identity.parse("regressor"), OUT, "put", "tuberline/north/work/r2/view"), "a shared name reads for all"


def test_no_grant_reaches_beyond_the_line() -> None:
    for identity in line_identities(CONFIG):
        for grant in grants(identity, line=CONFIG.name):
            assert all(key.startswith("tuberline/north/") for key in grant.keys)


def test_a_name_taken_off_the_list_is_locked_out() -> None:
    def names(config: LineConfig) -> list[str]:
        return [name for subject in access_control(config)["subjects"] for name in subject["cert_common_names"]]

    raw = CONFIG.model_dump()
    raw["access"]["viewers"] = ["office", "lorry"]
    with_lorry = names(parse_config(raw, where="test"))
    raw["access"]["viewers"] = ["office"]
    without = names(parse_config(raw, where="test"))
    assert set(with_lorry) - set(without) == {"viewer.lorry@north"}
    assert "viewer@north" not in without


def test_access_without_certificates_is_refused() -> None:
    raw = CONFIG.model_dump()
    raw["link"]["router"] = "tcp/127.0.0.1:7447"
    with pytest.raises(ConfigError, match=r"tcp/127.0.0.1:7447: make it tls/HOST:PORT"):
        router_access(parse_config(raw, where="test"))
    raw["access"]["enabled"] = False
    assert router_access(parse_config(raw, where="test")) is None


def test_names_that_do_not_fit_a_certificate_are_refused() -> None:
    with pytest.raises(ConfigError, match="64: give the node or the line a shorter name"):
        Identity("camera", "c" * 60).common_name("north")
    with pytest.raises(ConfigError, match="role 'spy' is not known; known: camera"):
        Identity.parse("spy/one")


def test_a_missing_certificate_names_both_files_it_would_take(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"no camera.front.pem nor camera.pem .*certs add camera/front"):
        own_files(tmp_path, "camera/front")
