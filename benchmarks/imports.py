"""Who imports whom, as a picture: packages as boxes, imports as arrows, those that break a rule in red.

python -m benchmarks imports --out docs/images/imports.svg [--before COMMIT]
"""

from __future__ import annotations

import ast
import subprocess
from collections import Counter
from pathlib import Path, PurePosixPath

from benchmarks.options import new_file, parser_of
from conveyor.errors import TuberlineError

ROOT = Path(__file__).resolve().parents[1]
APP, GROUND = "tuberline", "conveyor"
ROLES = ("camera_sim", "segmenter", "regressor", "aggregator", "viewer")
PACKAGES = (APP, *ROLES, GROUND)
WIDTH, HEIGHT, BOX_W, BOX_H = 640, 330, 104, 46
Graph = Counter[tuple[str, str]]


def files_of(commit: str | None) -> dict[str, str]:
    """Path and text of every Python file of our packages: of a commit, or of the working tree."""
    if commit is None:
        found = (path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
        return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in found}
    listed = _git("ls-tree", "-r", "--name-only", commit).split()
    ours = [name for name in listed if name.endswith(".py") and PurePosixPath(name).parts[0] in PACKAGES]
    return {name: _git("show", f"{commit}:{name}") for name in ours}


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TuberlineError(f"git {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout


def imports(files: dict[str, str]) -> Graph:
    """How often a file of one package imports from another; imports inside functions count too."""
    graph: Graph = Counter()
    for path, text in files.items():
        owner = PurePosixPath(path).parts[0]
        for node in ast.walk(ast.parse(text)):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names = [node.module]
            for target in {name.split(".")[0] for name in names} & set(PACKAGES) - {owner}:
                graph[owner, target] += 1
    return graph


def allowed(owner: str, target: str) -> bool:
    """The rules: roles import the ground and nothing else of ours; the app imports all; nothing imports the app."""
    return target == GROUND or (owner == APP and target in ROLES)


def place(package: str) -> tuple[float, float]:
    """Centre of a package's box: the app above, the roles in a row, the ground below."""
    if package == APP:
        return WIDTH / 2, 50
    if package == GROUND:
        return WIDTH / 2, HEIGHT - 45
    return 64 + ROLES.index(package) * (WIDTH - 128) / (len(ROLES) - 1), HEIGHT / 2


def drawing(graph: Graph, files: dict[str, str], title: str, left: int) -> list[str]:
    """SVG elements of one graph."""
    lines = Counter(dict.fromkeys(PACKAGES, 0))
    for path, text in files.items():
        lines[PurePosixPath(path).parts[0]] += text.count("\n")
    out = [f'<g transform="translate({left} 24)"><text x="{WIDTH / 2}" y="0" class="title">{title}</text>']
    for (owner, target), count in sorted(graph.items()):
        (x1, y1), (x2, y2) = place(owner), place(target)
        wrong = not allowed(owner, target)
        bend = 34 if wrong else 0
        middle = f"{(x1 + x2) / 2 + bend} {(y1 + y2) / 2 - bend}"
        down = BOX_H / 2 * (1 if y2 > y1 else -1 if y2 < y1 else 0)
        colour = "#c0392b" if wrong else "#7f8c8d"
        out.append(
            f'<path d="M {x1} {y1 + down} Q {middle} {x2} {y2 - down}" fill="none" stroke="{colour}" '
            f'stroke-width="{1 + min(count, 60) / 20:.1f}" marker-end="url(#{"wrong" if wrong else "right"})"/>'
        )
    for package in PACKAGES:
        if not lines[package]:
            continue
        x, y = place(package)
        out.append(f'<rect x="{x - BOX_W / 2}" y="{y - BOX_H / 2}" width="{BOX_W}" height="{BOX_H}" rx="8"/>')
        out.append(f'<text x="{x}" y="{y - 2}">{package}</text>')
        out.append(f'<text x="{x}" y="{y + 14}" class="small">{lines[package]:,} lines</text>')
    broken = sum(count for edge, count in graph.items() if not allowed(*edge))
    out.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 4}" class="small">{broken} imports break a rule</text></g>')
    return out


def picture(parts: list[tuple[str, dict[str, str]]]) -> str:
    """All graphs side by side as one SVG file."""
    arrows = "".join(
        f'<marker id="{name}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        f'orient="auto-start-reverse"><path d="M 0 0 L 10 5 L 0 10 z" fill="{colour}"/></marker>'
        for name, colour in (("right", "#7f8c8d"), ("wrong", "#c0392b"))
    )
    style = (
        "rect{fill:#f6f1e7;stroke:#6d4c41} text{font:13px sans-serif;text-anchor:middle;fill:#222} "
        ".small{font-size:10.5px;fill:#555} .title{font-weight:bold}"
    )
    body = [
        line
        for at, (title, files) in enumerate(parts)
        for line in drawing(imports(files), files, title, at * (WIDTH + 20))
    ]
    size = f'width="{len(parts) * (WIDTH + 20)}" height="{HEIGHT + 30}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{style}</style><defs>{arrows}</defs>'
    return "\n".join([head, '<rect width="100%" height="100%" style="fill:#fff;stroke:none"/>', *body, "</svg>"]) + "\n"


def sizes(parts: list[tuple[str, dict[str, str]]]) -> str:
    """Files and lines by package as a Markdown table, two columns for each of the trees."""
    rows = [[f"`{name}/`"] for name in PACKAGES] + [["together"]]
    for _, files in parts:
        totals = [
            (len(texts), sum(text.count("\n") for text in texts))
            for name in PACKAGES
            for texts in [[text for path, text in files.items() if PurePosixPath(path).parts[0] == name]]
        ]
        for row, pair in zip(rows, [*totals, tuple(map(sum, zip(*totals, strict=True)))], strict=True):
            row += [str(number) for number in pair]
    head = ["package", *(f"{what}{title and ', '}{title}" for title, _ in parts for what in ("files", "lines"))]
    rows = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    parser = parser_of("imports", __doc__)
    parser.add_argument("--out", type=new_file, required=True)
    parser.add_argument("--before", help="a commit to draw beside today's tree")
    options = parser.parse_args(arguments)
    parts = [(f"before ({options.before})", files_of(options.before))] if options.before else []
    parts.append(("now" if options.before else "", files_of(None)))
    options.out.write_text(picture(parts), encoding="utf-8")
    for title, files in parts:
        graph = imports(files)
        broken = {f"{a} -> {b}": n for (a, b), n in sorted(graph.items()) if not allowed(a, b)}
        print(f"{title}: " if title else "", broken or "no rule broken", sep="")
    print(sizes(parts))
