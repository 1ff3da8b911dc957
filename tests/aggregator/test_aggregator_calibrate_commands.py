"""The commands of `tuberline calibrate` on a ledger: bucket, single weights with gaps, loads, the table, set aside."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from aggregator.calibration.align import align
from aggregator.calibration.learning import learning_of
from aggregator.calibration.part import Part
from aggregator.calibration.single import read_weights
from aggregator.calibration.tickets import read_tickets
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.writer import Ledger
from conveyor.camera_flags import OUTLINE_GROWN
from conveyor.errors import InputError
from conveyor.messages import TrackEntry, Tuber
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import undisturbed
from tuberline.cli.calibrate_bucket import calibrate_bucket
from tuberline.cli.calibrate_load import calibrate_load
from tuberline.cli.calibrate_show import set_aside, show
from tuberline.cli.calibrate_tubers import calibrate_tubers
from tuberline.cli.ticket_options import PartOptions, TicketOptions

Line = tuple[Path, list[Tuber]]


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Line:
    """Folder of a counted run, and its tubers in belt order."""
    folder = tmp_path_factory.mktemp("run")
    with Ledger(folder / "ledger.db") as ledger:
        run = undisturbed(ledger, tell(11, n=40)).story.run
        tubers = list(ledger.tubers(run))
    assert len(tubers) >= 30
    return folder, sorted(tubers, key=lambda tuber: (tuber.crossed_ns, tuber.tuber_id))


def weights_file(path: Path, grams: list[float]) -> Path:
    path.write_text("tuber,weight_g\n" + "".join(f"{n},{g:.1f}\n" for n, g in enumerate(grams)), encoding="utf-8")
    return path


def printed(capsys: pytest.CaptureFixture[str]) -> Any:
    return json.loads(capsys.readouterr().out)


def test_a_bucket_is_a_ticket_and_later_loads_are_calibrated_by_it(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, tubers = line
    weighed_g = sum(tuber.weight_g for tuber in tubers)
    path = tmp_path / "tickets.json"
    calibrate_bucket(folder, kg=1.1 * weighed_g / 1000, count=len(tubers), options=TicketOptions(path), json=True)
    told = printed(capsys)
    assert told["ticket"]["kind"] == "bucket"
    assert told["ticket"]["estimated_g"] == pytest.approx(weighed_g)
    assert 1.05 < told["load_factor"]["factor"] < 1.1
    sums = LoadSums(50.0)
    for tuber in tubers:
        sums.add(tuber)
    load = LoadTotals(sums, read_tickets(path))
    message = load.message("r", coverage=1.0, cameras={}, final=True)
    assert message.weight_g == pytest.approx(told["load_factor"]["factor"] * weighed_g, rel=0.005)
    assert message.as_weighed_g == pytest.approx(weighed_g)
    assert message.calibrated_by.startswith("1 bucket: offset +")
    with pytest.raises(InputError, match="--again"):
        calibrate_bucket(folder, kg=weighed_g / 1000, options=TicketOptions(path))


def test_a_bucket_may_be_a_part_of_a_run(line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, tubers = line
    some = [tuber for tuber in tubers if 5 <= tuber.tuber_id <= 24]
    kg = sum(tuber.weight_g for tuber in some) / 1000
    options, some_ids = TicketOptions(tmp_path / "tickets.json"), PartOptions(first=5, last=24)
    calibrate_bucket(folder, kg=kg, count=20, weighed=some_ids, options=options, json=True)
    assert printed(capsys)["ticket"]["part"] == "tubers 5 to 24"
    places = [tuber.place_x_m for tuber in some]
    by_place = PartOptions(from_x=max(places), to_x=min(places))
    with pytest.raises(InputError, match="may hold the same tubers"):  # as they do
        calibrate_bucket(folder, kg=kg, weighed=by_place, options=options)
    calibrate_bucket(folder, kg=kg, weighed=by_place, options=TicketOptions(tmp_path / "by-place.json"), json=True)
    assert printed(capsys)["ticket"]["tubers"] >= 20
    with pytest.raises(InputError, match=r"held 40 tubers, .* counted 20"):
        calibrate_bucket(folder, kg=kg, count=40, weighed=some_ids, options=options)
    with pytest.raises(InputError, match="none of them among tubers 900 to the last"):
        calibrate_bucket(folder, kg=kg, weighed=PartOptions(first=900), options=options)
    for wrong in (PartOptions(first=1, last=610), PartOptions(first=0, last=20)):
        with pytest.raises(InputError, match=rf"is (610|0), run .* counted {len(tubers)} tubers, numbered 1 to"):
            calibrate_bucket(folder, kg=kg, weighed=wrong, options=options)


def test_a_bucket_that_passed_while_the_camera_was_learned_is_told(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The correction would be of tubers some of which were weighed as no later one is."""
    _, tubers = line
    story = tell(11, n=40)
    logs = {
        name: [flagged(entry, from_ns=tubers[12].crossed_ns - 1) for entry in log] for name, log in story.logs.items()
    }
    with Ledger(tmp_path / "ledger.db") as ledger:
        undisturbed(ledger, replace(story, logs=logs))
    kg = sum(tuber.weight_g for tuber in tubers) / 1000
    calibrate_bucket(tmp_path, kg=kg, options=TicketOptions(tmp_path / "tickets.json"))
    text = capsys.readouterr().out
    assert f"the first 12 of these {len(tubers)} tubers were weighed before their camera was known" in text
    first = tubers[12].tuber_id
    assert f"(--first {first})" in text
    options, after = TicketOptions(tmp_path / "after.json"), PartOptions(first=first)
    calibrate_bucket(
        tmp_path, kg=sum(t.weight_g for t in tubers[12:]) / 1000, weighed=after, options=options, json=True
    )
    assert printed(capsys)["before_camera_known"] == 0


def flagged(entry: TrackEntry, *, from_ns: int) -> TrackEntry:
    track = entry.track
    grown = track is not None and track.crossed_ns >= from_ns
    return replace(entry, track=replace(track, flags=(OUTLINE_GROWN,))) if track and grown else entry


@pytest.mark.parametrize(
    ("flags", "before"),
    [
        ("........" * 5, 0),
        ("gggggggg" * 5, 0),
        ("..gggggg" * 5, 0),  # two are few
        ("........" + "gggggggg" * 4, 8),
        ("..............................gg", 30),  # later loads are weighed as the last two are
        ("............gg" + "........" * 3, 0),  # so few say nothing
        ("............" + "g.gg.ggg" * 4, 12),
    ],
)
def test_who_was_weighed_before_the_camera_was_known(line: Line, flags: str, before: int) -> None:
    _, tubers = line
    some = [replace(tubers[0], tuber_id=n + 1, flags=(OUTLINE_GROWN,) * (c == "g")) for n, c in enumerate(flags)]
    found = learning_of(some)
    assert (found.before if found else 0) == before
    assert found is None or found.first_id == before + 1


def test_a_bucket_that_was_also_weighed_one_by_one_is_told(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both counted in full without a word, and a load was said to be known better than it is."""
    folder, tubers = line
    options, path = TicketOptions(tmp_path / "tickets.json"), tmp_path / "weights.csv"
    calibrate_tubers(folder, weights_file(path, [1.1 * tuber.weight_g for tuber in tubers]), options=options)
    few, most = tubers[: len(tubers) // 3], tubers[: len(tubers) * 2 // 3]
    for some, told in ((few, False), (most, True)):
        kg, part = 1.1 * sum(tuber.weight_g for tuber in some) / 1000, PartOptions(first=1, last=len(some))
        assert "same tubers" not in capsys.readouterr().out
        calibrate_bucket(folder, kg=kg, weighed=part, options=replace(options, again=True))
        said = capsys.readouterr().out
        aside = f"--run {tubers[0].run} --kind bucket --part 'tubers 1 to {len(some)}'"
        assert ("are of the same tubers, and each counts in full" in said) is told
        assert (f"set-aside {options.tickets} {aside}" in said) is told


def test_a_count_by_hand_that_differs_by_one_scales_the_sum_and_widens_the_ticket(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, tubers = line
    tickets = []
    for n, count in enumerate((len(tubers), len(tubers) + 1)):
        kg = sum(tuber.weight_g for tuber in tubers) / 1000
        calibrate_bucket(folder, kg=kg, count=count, options=TicketOptions(tmp_path / f"{n}.json"), json=True)
        tickets.append(printed(capsys)["ticket"])
    assert tickets[1]["estimated_g"] == pytest.approx(tickets[0]["estimated_g"] * (1 + 1 / len(tubers)))
    assert tickets[1]["estimated_sd_g"] > 1.3 * tickets[0]["estimated_sd_g"]


def test_single_weights_find_their_tubers_though_one_is_missing_and_one_is_extra(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, tubers = line
    grams = [1.08 * tuber.weight_g for tuber in tubers]
    lost = grams[:7] + grams[8:]  # the eighth tuber fell off before it was weighed
    lost.insert(20, 613.0)  # and a stranger came into the bucket
    path = weights_file(tmp_path / "weights.csv", lost)
    calibrate_tubers(folder, path, options=TicketOptions(tmp_path / "tickets.json"), json=True)
    told = printed(capsys)
    assert told["left_out"] == {"rows": [22], "tubers": [tubers[7].tuber_id]}
    assert told["ticket"]["tubers"] == len(tubers) - 1
    # All tubers of this story have one outline whatever they weigh, so a part of the 8 % is taken for an offset.
    assert told["load_factor"]["factor"] == pytest.approx(1.08, abs=0.02)
    assert 0 < told["single_tuber_half_width"] < 0.3


def test_a_weight_left_empty_is_a_tuber_that_was_not_weighed(line: Line, tmp_path: Path) -> None:
    folder, tubers = line
    path = tmp_path / "weights.csv"
    rows = [f"{tuber.weight_g:.1f}" for tuber in tubers]
    path.write_text("\n".join([*rows[:3], "-", *rows[4:]]) + "\n", encoding="utf-8")
    calibrate_tubers(folder, path, options=TicketOptions(tmp_path / "tickets.json"))
    (ticket,) = read_tickets(tmp_path / "tickets.json")
    assert tubers[3].tuber_id not in {one.tuber_id for one in ticket.singles}
    assert len(ticket.singles) == len(tubers) - 1


def test_weights_of_other_tubers_are_refused(line: Line, tmp_path: Path) -> None:
    folder, tubers = line
    backwards = weights_file(tmp_path / "weights.csv", [tuber.weight_g for tuber in reversed(tubers)])
    with pytest.raises(InputError, match="in the order of the belt"):
        calibrate_tubers(folder, backwards, options=TicketOptions(tmp_path / "tickets.json"))
    assert not (tmp_path / "tickets.json").exists()
    wrong = tmp_path / "kilograms.csv"
    wrong.write_text("0.172\n0.211\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"row 1: '0\.172' is no weight in grams"):
        calibrate_tubers(folder, wrong, options=TicketOptions(tmp_path / "tickets.json"))


@pytest.mark.parametrize(
    ("text", "grams"),
    [
        ("nr;weight_g\n1;150,5\n2;92,25\n", (150.5, 92.25)),
        ("\ufeffweight_g\n150,5\n-\n92\n", (150.5, 92.0)),
        ("Weight_g\tfield\n150.5\tNorth\n92\n", (150.5, 92.0)),
        ("nr,weight_g\n1,150.5\n", (150.5,)),
    ],
)
def test_weights_come_as_spreadsheets_of_any_country_write_them(
    tmp_path: Path, text: str, grams: tuple[float, ...]
) -> None:
    (path := tmp_path / "weights.csv").write_text(text, encoding="utf-8")
    assert read_weights(path)[1] == grams


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nr,weight_g\n1,150,5\n", "row 2: 3 values, its first row names 2; write decimals with a point"),
        ("150,5\n92,0\n", "want a column weight_g, or one column alone; found 150, 5"),
        ("Gewicht\n150\n", "row 1: 'Gewicht' is no weight in grams, and no column is named weight_g"),
        ("Gr\xf6\xdfe,weight_g\n1,150\n", "save it as UTF-8"),
    ],
)
def test_weights_that_can_be_read_in_two_ways_are_refused(tmp_path: Path, text: str, said: str) -> None:
    """'150,5' in a table kept apart by commas counted as 150 g, without a word."""
    (path := tmp_path / "weights.csv").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=said):
        read_weights(path)


def test_a_scale_that_says_nothing_makes_no_ticket(line: Line, tmp_path: Path) -> None:
    """Grams given for kilograms: the ticket was taken, and its load known no better than before."""
    folder, tubers = line
    kg = sum(tuber.weight_g for tuber in tubers) / 1000
    with pytest.raises(InputError, match=r"the scale's error is 13 kg .* standard deviation in kilograms"):
        calibrate_bucket(folder, kg=kg, scale_error_kg=13.0, options=TicketOptions(tmp_path / "tickets.json"))
    assert not (tmp_path / "tickets.json").exists()


def test_weights_of_a_part_need_the_part_named(line: Line, tmp_path: Path) -> None:
    folder, tubers = line
    some = sorted((t for t in tubers if 10 <= t.tuber_id <= 30), key=lambda t: (t.crossed_ns, t.tuber_id))
    path = weights_file(tmp_path / "weights.csv", [tuber.weight_g for tuber in some])
    with pytest.raises(InputError, match="Name the part of the run"):
        calibrate_tubers(folder, path, options=TicketOptions(tmp_path / "tickets.json"))
    calibrate_tubers(
        folder, path, weighed=PartOptions(first=10, last=30), options=TicketOptions(tmp_path / "tickets.json")
    )
    (ticket,) = read_tickets(tmp_path / "tickets.json")
    assert [one.tuber_id for one in ticket.singles] == [tuber.tuber_id for tuber in some]


def test_rows_are_laid_beside_each_other_by_their_weights_alone() -> None:
    weighed = [100.0, 250.0, 60.0, 310.0, 140.0, 90.0, 200.0]
    laid = align([1.1 * g for g in weighed if g != 310.0], weighed)
    assert laid.tubers_left_out == (3,)
    assert laid.pairs == ((0, 0), (1, 1), (2, 2), (3, 4), (4, 5), (5, 6))
    assert align(weighed, weighed).weights_left_out == ()


def test_the_three_kinds_share_a_file_and_the_table_names_who_contradicts(
    line: Line, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, tubers = line
    weighed_kg = sum(tuber.weight_g for tuber in tubers) / 1000
    path = tmp_path / "tickets.json"
    options, first_20_kg = TicketOptions(path), sum(t.weight_g for t in tubers if t.tuber_id <= 20) / 1000
    calibrate_load(folder, ticket_kg=1.25 * weighed_kg, options=options)
    calibrate_bucket(folder, kg=weighed_kg - first_20_kg, weighed=PartOptions(first=21), options=options)
    calibrate_bucket(folder, kg=first_20_kg, weighed=PartOptions(last=20), options=options)
    calibrate_tubers(folder, weights_file(tmp_path / "w.csv", [t.weight_g for t in tubers]), options=options)
    assert "contradicts all else that is known: load of run" in capsys.readouterr().out
    show(path, json=True)
    (table,) = printed(capsys)
    verdicts = {(row["kind"], row["part"]): row["contradicts"] for row in table["tickets"]}
    assert verdicts == {
        ("load", ""): True,
        ("bucket", "tubers 21 to the last"): False,
        ("bucket", "tubers 1 to 20"): False,
        ("tubers", ""): False,
    }
    run = table["tickets"][0]["run"]
    set_aside(path, run=run, kind="load", reason="wrong trailer")
    show(path)
    text = capsys.readouterr().out
    assert "set aside: wrong trailer" in text
    assert "CONTRADICTS" not in text
    show(path, json=True)
    (without,) = printed(capsys)
    assert abs(without["factor"] - 1.0) < abs(table["factor"] - 1.0)
    assert without["half_width_after_more"]["10"] < without["half_width_after_more"]["0"]
    with pytest.raises(InputError, match="either --reason"):
        set_aside(path, run=run, kind="load")


def test_a_part_says_what_it_holds(line: Line) -> None:
    _, tubers = line
    assert Part().name == ""
    assert Part(first=3).name == "tubers 3 to the last"
    assert Part(from_x_m=-1.0, to_x_m=-2.5).name == "places -1 m to -2.5 m"
    inside = [tuber for tuber in tubers if Part(from_x_m=-1.0, to_x_m=-2.5).holds(tuber)]
    assert all(-2.5 <= tuber.place_x_m <= -1.0 for tuber in inside)
    # One place alone divides what passed before it from what passed after.
    middle_x_m = tubers[len(tubers) // 2].place_x_m
    after = {tuber.tuber_id for tuber in tubers if Part(from_x_m=middle_x_m).holds(tuber)}
    before = {tuber.tuber_id for tuber in tubers if Part(to_x_m=middle_x_m).holds(tuber)}
    assert len(after & before) == 1
    assert len(after | before) == len(tubers)
    assert tubers[-1].tuber_id in after
    assert tubers[0].tuber_id in before
