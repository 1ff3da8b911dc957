"""Who a process is towards the router: the common name in its certificate, and the files it takes it from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from conveyor.errors import ConfigError
from conveyor.topics import ALIVE, TOPICS, check_name

SHARED = "*"
"""Name of an identity that several processes of one role share, e.g. regressors that come and go."""
ROLES = tuple(
    dict.fromkeys((*ALIVE.senders, *(r for t in TOPICS for r in (*t.senders, *t.receivers)), "operator", "router"))
)
CA_FILE = "ca.pem"
COMMON_NAME_LIMIT = 64
"""X.509's upper bound (RFC 5280, ub-common-name)."""


@dataclass(frozen=True, slots=True)
class Identity:
    """A role and the name of one node of it, or `SHARED` for all of that role."""

    role: str
    name: str = SHARED

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise ConfigError(f"role '{self.role}' is not known; known: {', '.join(ROLES)}")
        if self.name != SHARED:
            check_name(self.name, what=self.role)

    @classmethod
    def parse(cls, text: str) -> Identity:
        """'camera/front' as one node, 'viewer' as all viewers."""
        role, _, name = text.partition("/")
        return cls(role, name or SHARED)

    @property
    def stem(self) -> str:
        """File name without suffix: 'camera.front', or 'viewer' where it is shared."""
        return self.role if self.name == SHARED else f"{self.role}.{self.name}"

    def common_name(self, line: str) -> str:
        """What the certificate says and the access rules ask for, e.g. 'camera.front@line'.

        Raises:
            ConfigError: longer than X.509 allows.
        """
        text = f"{self.stem}@{line}"
        if len(text) > COMMON_NAME_LIMIT:
            raise ConfigError(
                f"'{text}' has {len(text)} characters and a certificate's name may have {COMMON_NAME_LIMIT}: "
                "give the node or the line a shorter name"
            )
        return text


def names_there(folder: Path, role: str) -> list[str]:
    """Names of the nodes of `role` whose own certificates, with their keys, are in `folder`; sorted."""
    own = (path for path in folder.glob(f"{role}.*.pem") if path.with_suffix(".key").is_file())
    return sorted(path.stem.removeprefix(f"{role}.") for path in own)


def own_files(folder: Path, node: str) -> tuple[Path, Path, Path]:
    """(authority, certificate, key) of the process `node` ('camera/front', 'router', 'observer') in `folder`.

    Its own certificate, or the one its role shares.

    Raises:
        ConfigError: neither is there.
    """
    own = Identity.parse("operator" if node == "observer" else node)
    for stem in dict.fromkeys((own.stem, own.role)):
        certificate, key = folder / f"{stem}.pem", folder / f"{stem}.key"
        if certificate.is_file() and key.is_file():
            return folder / CA_FILE, certificate, key
    stems = " nor ".join(f"{stem}.pem" for stem in dict.fromkeys((own.stem, own.role)))
    wanted = f"{own.role}/{own.name}" if own.name != SHARED else own.role
    raise ConfigError(
        f"no certificate for {node} in {folder}: no {stems} with its .key is there; "
        f"make one with `tuberline certs add {wanted}` and copy both here"
    )
