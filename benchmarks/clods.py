"""Tubers lost and clods counted by the classifier's rule: cameras from good to harsh over belts with and without clods.

    python -m benchmarks clods --out runs/clods --seeds judging

The segmenter's core runs once per camera and refuses nothing; what the network said of each track, and how noisy its
patch was, is kept as OUT/<belt>.json. The rule is judged on these numbers alone, in a second.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from math import exp, log
from pathlib import Path
from statistics import fmean
from typing import Any, Protocol

from benchmarks.clods_belts import Body, Passage, passages
from benchmarks.options import chosen, parser_of, whole_number
from segmenter.classify.belief import believe
from segmenter.classify.evidence import PatchNoise
from segmenter.classify.prior import Prior
from segmenter.first_look import ENOUGH
from segmenter.track.counting import CountSettings

CLEAN, CLODDY = "touching", "distractors"


def many(seed: int) -> tuple[tuple[str, str, int, int], ...]:
    """36 belts of the seeds from `seed` on: two of three with clods; a third each of `easy`, `field` and `harsh`."""
    scenes, presets = (CLODDY, CLODDY, CLEAN), ("easy", "field", "harsh")
    return tuple((scenes[n // 3 % 3], presets[n % 3], seed + n, 60) for n in range(36))


BELTS: dict[str, tuple[tuple[str, str, int, int], ...]] = {
    "tuning": (
        (CLODDY, "field", 7102, 60),
        (CLEAN, "field", 7101, 60),
        (CLEAN, "harsh", 7103, 60),
        (CLODDY, "easy", 7104, 60),
    ),
    "first": (
        (CLODDY, "field", 8102, 60),
        (CLEAN, "field", 8101, 60),
        (CLEAN, "harsh", 8103, 60),
        (CLODDY, "easy", 8104, 60),
        (CLEAN, "easy", 8105, 60),
        (CLODDY, "field", 8106, 60),
    ),
    "judging": (
        (CLODDY, "field", 8202, 60),
        (CLEAN, "field", 8201, 60),
        (CLEAN, "harsh", 8203, 60),
        (CLODDY, "easy", 8204, 60),
        (CLEAN, "easy", 8205, 60),
        (CLODDY, "field", 8206, 60),
        (CLEAN, "harsh", 8207, 60),
        (CLEAN, "field", 8208, 60),
    ),
    "held-out": (
        (CLODDY, "field", 8302, 60),
        (CLODDY, "easy", 8304, 60),
        (CLODDY, "field", 8306, 60),
        (CLEAN, "harsh", 8303, 60),
        (CLEAN, "field", 8301, 60),
        (CLEAN, "harsh", 8307, 60),
    ),
    "harsh": (
        (CLODDY, "harsh", 7112, 60),
        (CLODDY, "harsh", 7114, 60),
        (CLODDY, "harsh", 7116, 60),
        (CLODDY, "harsh", 7118, 60),
    ),
    "final": (
        (CLODDY, "field", 8402, 60),
        (CLODDY, "easy", 8404, 60),
        (CLODDY, "harsh", 8406, 60),
        (CLODDY, "harsh", 8408, 60),
        (CLEAN, "field", 8401, 60),
        (CLEAN, "harsh", 8403, 60),
        (CLEAN, "easy", 8405, 60),
        (CLEAN, "harsh", 8407, 60),
    ),
    "many": many(9001),
    "later": many(9301),
}
"""(scene, preset, seed, tubers) of each belt; a rule tuned on `tuning` was judged on `first`, the next was tuned on
both and judged on `judging`; two of its constants were then set in sight of all. `harsh` is for choices too; nothing
was ever chosen on `held-out`, `final`, `many` and `later`."""

NOISE_CLASSES = (("up to 0.035 px", 0.0, 0.035), ("0.035 to 0.1 px", 0.035, 0.1), ("above 0.1 px", 0.1, 1.0))
REFUSED_BELOW = CountSettings().reject_below


class Belief(Protocol):
    """What a rule believes of a belt; fed with the tracks in their order."""

    def judge(self, body: Body) -> float:
        """Log-odds of tuber against other for a body; it counts for those after it."""
        ...


@dataclass(slots=True)
class FirstPrior:
    """The rule to compare with: begins with one other in 17 and counts each track for both sides by its odds."""

    others: float = 0.5
    tubers: float = 8.0

    def judge(self, body: Body) -> float:
        """Log-odds of tuber against other for a body; it counts for those after it."""
        odds = fmean(body.answers) + log(self.tubers / self.others)
        other = 1 / (1 + exp(min(max(odds, -50.0), 50.0)))
        self.others = 0.5 + (self.others - 0.5) * 0.995 + other
        self.tubers = 8.0 + (self.tubers - 8.0) * 0.995 + 1 - other
        return odds


@dataclass(frozen=True, slots=True)
class Tally:
    """Tubers that crossed and were refused, others of a tuber's size and those counted."""

    tubers: int
    lost: int
    others: int
    counted: int


class LinePrior:
    """The rule of a line, as `Perception` has it."""

    def __init__(self) -> None:
        self._prior = Prior()

    def judge(self, body: Body) -> float:
        """Log-odds of tuber against other for a body; it counts for those after it."""
        noise = PatchNoise(body.spread_mm, body.error_mm, body.hole_share, body.observations)
        answer = believe(self._prior, body.answers, noise, limit=REFUSED_BELOW)
        if answer is None:
            raise ValueError(f"a body's answers are no numbers: {body.answers}")
        return answer.log_odds


RULES: dict[str, Callable[[], Belief]] = {"before": FirstPrior, "now": LinePrior}


def tally(over: Iterable[Passage], rule: Callable[[], Belief], *, looked_at: int = 0) -> Tally:
    """What the rule makes of passages, each a belt of its own; what was not classified is counted.

    Args:
        looked_at: bodies of each that it has seen before, as a replay looks at a recording first.
    """
    tubers = lost = others = counted = 0
    for passage in over:
        belief = rule()
        for body in passage.bodies[:looked_at]:
            if body.answers:
                belief.judge(body)
        tubers += passage.tubers
        for body in passage.bodies:
            refused = bool(body.answers) and belief.judge(body) < REFUSED_BELOW
            lost += refused and body.kind == "tuber"
            others += body.kind not in ("tuber", "part")
            counted += not refused and body.kind not in ("tuber", "part")
    return Tally(tubers, lost, others, counted)


def after_another(of: Sequence[Passage]) -> list[Passage]:
    """The belts of each camera as one long belt: what was learned of the first is known on the next."""
    found: dict[str, Passage] = {}
    for one in of:
        had = found.get(one.camera)
        if had is None:
            found[one.camera] = one
        else:
            found[one.camera] = replace(had, tubers=had.tubers + one.tubers, bodies=had.bodies + one.bodies)
    return list(found.values())


def _row(name: str, before: Tally, now: Tally) -> str:
    cells = (before.tubers, before.lost, now.lost, before.others, before.counted, now.counted)
    return f"| {name} | " + " | ".join(str(cell) for cell in cells) + " |"


def table(of: Sequence[Passage]) -> str:
    """Markdown: by belt and local noise, what each rule lost of the tubers and counted of the others."""
    lines = [
        "| belt, camera's local noise | tubers | 0.1's rule lost | lost | others | 0.1's rule counted | counted |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for scene, belt in ((CLEAN, "clean"), (CLODDY, "cloddy")):
        of_scene = [passage for passage in of if passage.scene == scene]
        for name, low, high in (*NOISE_CLASSES, ("all", 0.0, 1.0)):
            some = [passage for passage in of_scene if low < passage.local_px <= high]
            before, now = (tally(some, rule) for rule in RULES.values())
            lines.append(_row(f"{belt}, {name}", before, now))
        one_belt = after_another(of_scene)
        lines.append(_row(f"{belt}, all, one after the other", *(tally(one_belt, rule) for rule in RULES.values())))
        looked = (tally(of_scene, rule, looked_at=ENOUGH) for rule in RULES.values())
        lines.append(_row(f"{belt}, all, looked at first", *looked))
    return "\n".join(lines) + "\n"


def kept(out: Path, belt: tuple[str, str, int, int]) -> list[Passage]:
    """The passages of a belt, made now where they are not in `out`."""
    path = out / f"{'-'.join(str(part) for part in belt)}.json"
    if not path.is_file():
        sys.stderr.write(f"{path.stem} ...\n")
        rows = [asdict(passage) for passage in passages(*belt)]
        path.write_text(json.dumps(rows) + "\n", encoding="utf-8")
    rows = json.loads(path.read_text(encoding="utf-8"))
    return [Passage(**{**row, "bodies": tuple(_body(body) for body in row["bodies"])}) for row in rows]


def _body(row: dict[str, Any]) -> Body:
    return Body(**{**row, "answers": tuple(row["answers"])})


def main(arguments: Sequence[str]) -> None:
    """Make what is not kept yet, and print the table."""
    parser = parser_of("clods", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/clods"))
    parser.add_argument("--seeds", choices=sorted(BELTS), default="judging")
    parser.add_argument("--only", type=whole_number(0), nargs="+", help="numbers of belts, from 0")
    parser.add_argument("--tubers", type=whole_number(1), help="of each belt; default: as planned")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    belts = [
        (scene, preset, seed, given.tubers or tubers)
        for scene, preset, seed, tubers in chosen(BELTS[given.seeds], given.only)
    ]
    of = [passage for belt in belts for passage in kept(given.out, belt)]
    sys.stdout.write(table(of))
