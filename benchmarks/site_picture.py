"""Draws a site: its hosts, what runs on them, and the bytes on their links, as SVG."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

from benchmarks.site_net import Traffic

WIDTH, HEIGHT = 980, 470
BOX_WIDTH, BOX_HEIGHT = 210, 64
SWITCH_X, SWITCH_TOP = 470, 40
COLOURS = {"camera": "#dbe9f6", "edge": "#fde7c8", "inference": "#dff0d8", "office": "#ececec"}


@dataclass(frozen=True, slots=True)
class Host:
    """A box: which host, what runs there, what its link is, where it stands (left upper corner, pixels)."""

    name: str
    runs: str
    note: str
    x: int
    y: int

    @property
    def kind(self) -> str:
        """camera, edge, inference or office."""
        return self.name.partition("-")[0]


def site_hosts(inference: int, *, share: float, office: str) -> list[Host]:
    """The boxes of a site with `inference` inference hosts: cameras and office left, edge and inference right."""
    cameras = ("left", "middle", "right")
    hosts = [Host(f"camera-{c}", "camera, segmenter", "", 30, 30 + 100 * n) for n, c in enumerate(cameras)]
    hosts.append(Host("office", "top, viewer (light)", office, 30, 350))
    hosts.append(Host("edge", "router, aggregator", "", 720, 30))
    note = f"{100 * share:.0f} % of a core"
    hosts += [Host(f"inference-{n + 1}", "regressor", note, 720, 120 + 80 * n) for n in range(inference)]
    return hosts


def draw_site(hosts: list[Host], traffic: Mapping[str, Traffic], *, title: str) -> str:
    """The picture as SVG text; `traffic` in bytes by host."""
    height = max(HEIGHT, max(host.y for host in hosts) + BOX_HEIGHT + 50)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" '
        'font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        f'<rect x="{SWITCH_X}" y="{SWITCH_TOP - 20}" width="20" height="{height - 70}" rx="6" fill="#666"/>',
        f'<text x="{SWITCH_X + 10}" y="{height - 12}" text-anchor="middle" fill="#444">{escape(title)}</text>',
    ]
    for host in hosts:
        parts += _host(host, traffic[host.name])
    return "\n".join([*parts, "</svg>", ""])


def _host(host: Host, traffic: Traffic) -> list[str]:
    middle = host.y + BOX_HEIGHT // 2
    left = host.x < SWITCH_X
    begin, end = (host.x + BOX_WIDTH, SWITCH_X) if left else (SWITCH_X + 20, host.x)
    dashes = ' stroke-dasharray="6 5"' if host.kind == "office" else ""
    out, into = ("→", "←") if left else ("←", "→")
    weights = ("bold", "normal", "normal")
    texts = [
        f'<text x="{host.x + 12}" y="{host.y + 20 + 18 * n}" font-weight="{weights[n]}">{escape(text)}</text>'
        for n, text in enumerate((host.name, host.runs, host.note))
    ]
    at = (begin + end) // 2
    return [
        f'<line x1="{begin}" y1="{middle}" x2="{end}" y2="{middle}" stroke="#666" stroke-width="2"{dashes}/>',
        f'<rect x="{host.x}" y="{host.y}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="8" '
        f'fill="{COLOURS[host.kind]}" stroke="#666"/>',
        *texts,
        f'<text x="{at}" y="{middle - 6}" text-anchor="middle">{out} {_bytes(traffic.sent)}</text>',
        f'<text x="{at}" y="{middle + 17}" text-anchor="middle">{into} {_bytes(traffic.received)}</text>',
    ]


def _bytes(n: int) -> str:
    return f"{n / 1e6:.1f} MB" if n >= 1e6 else f"{n / 1e3:.0f} kB"
