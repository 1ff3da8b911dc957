"""Which lines a router carries: by the tokens of their nodes, as far as its rules let one see them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress

import zenoh

from conveyor import topics
from conveyor.errors import ConfigError
from conveyor.topics import check_name

ASK_S = 2.0
MOST_NAMED = 4
ANY = "*"
_ALIVE = topics.ALIVE.path.partition("/")[0]


def nodes_of_lines(session: zenoh.Session) -> dict[str, set[str]]:
    """'role/name' of the living nodes at the session's router, by the names of their lines.

    Zenoh may lose answers of a loaded machine (1.10): who is missing here may live.
    """
    found: dict[str, set[str]] = {}
    for reply in session.liveliness().get(f"{topics.ROOT}/{ANY}/{_ALIVE}/{ANY}/{ANY}", timeout=ASK_S):
        if reply.ok is not None:
            _, line, _, role, name = str(reply.ok.key_expr).split("/")
            with suppress(ConfigError):  # a name that no node can have
                node = "/".join(check_name(part, what="node") for part in (role, name))
                found.setdefault(check_name(line, what="line"), set()).add(node)
    return found


def has_role(nodes: Collection[str], role: str) -> bool:
    """Whether one of the nodes ('role/name') is of that role."""
    return any(node.startswith(f"{role}/") for node in nodes)


def seen_beside(session: zenoh.Session, line: str, alive: Collection[str]) -> dict[str, set[str]]:
    """As `nodes_of_lines`, but `line` alone, whose nodes are `alive`, where it has segmenters and regressors: then its
    hosts agree on its name.
    """
    whole = has_role(alive, "segmenter") and has_role(alive, "regressor")
    return {**({} if whole else nodes_of_lines(session)), line: set(alive)}


def looked_for_elsewhere(line: str, lines: Mapping[str, Collection[str]]) -> str:
    """That `line` has no segmenter, in words, where it has none and others at the same router have; empty else.

    Args:
        lines: as `nodes_of_lines` gives them.
    """
    others = sorted(name for name, nodes in lines.items() if name != line and has_role(nodes, "segmenter"))
    if not others or has_role(lines.get(line, ()), "segmenter"):
        return ""
    carried = ("line " if len(others) == 1 else "lines ") + _named([f"'{name}'" for name in others])
    return f"no segmenter of line '{line}' is at this router, which carries {carried}"


def strayed_regressors(line: str, lines: Mapping[str, Collection[str]]) -> str:
    """That `line` has no regressor and lines of regressors alone are at the same router, in words; empty else."""
    alone = {name: nodes for name, nodes in lines.items() if all(node.startswith("regressor/") for node in nodes)}
    strayed = sorted(f"{node} of line '{name}'" for name, nodes in alone.items() if name != line for node in nodes)
    if not strayed or has_role(lines.get(line, ()), "regressor"):
        return ""
    return f"this router has {_named(strayed)}, and none of '{line}'"


def _named(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMED]) + (", ..." if names[MOST_NAMED:] else "")
