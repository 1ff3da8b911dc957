"""Classes of a contract: what is refused, unfolding against blur, intervals, limits, and the way through the ledger."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from aggregator.calibration.apply import CAMERA, RESTING
from aggregator.calibration.tickets import Ticket
from aggregator.core.class_totals import class_totals, classes_together
from aggregator.core.load_sums import LoadSums
from aggregator.core.size_classes import SHARED_SD, class_shares
from aggregator.core.size_fusion import fuse_sizes
from aggregator.core.totals import LoadTotals
from aggregator.ledger.rows import tuber_from, tuber_row
from conveyor.contract import Contract, SizeClass, read_contract
from conveyor.errors import ConfigError
from conveyor.messages import Sizes, Totals, Tuber

SEED = 20261124
WARE = """
name = "ware"
[[classes]]
name = "below"
to_mm = 45
at_most_percent = 20
[[classes]]
name = "ware"
from_mm = 45
to_mm = 60
at_least_percent = 60
[[classes]]
name = "large"
from_mm = 60
"""


def contract(tmp_path: Path, text: str = WARE) -> Contract:
    path = tmp_path / "contract.toml"
    path.write_text(text)
    return read_contract(path)


def test_a_contract_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    assert contract(tmp_path, "\ufeff" + WARE) == contract(tmp_path)


def test_a_class_that_is_none_is_the_only_fault(tmp_path: Path) -> None:
    """A second line said that the list of classes was too short."""
    with pytest.raises(ConfigError) as told:
        contract(tmp_path, '[[classes]]\nname = "a"\nfrom_mm = 50\nto_mm = 30\n')
    _, *faults = str(told.value).splitlines()
    assert [fault.strip().partition(": ")[0] for fault in faults] == ["classes.0"]
    assert "goes from 50 to 30 mm" in faults[0]
    with pytest.raises(ConfigError, match="classes: must have at least 1 item"):
        contract(tmp_path, "classes = []\n")


def sizes(mesh_mm: float, sd_mm: float = 2.0) -> Sizes:
    return Sizes(1.4 * mesh_mm, mesh_mm, 0.9 * mesh_mm, mesh_mm, 2 * sd_mm, sd_mm, sd_mm, sd_mm)


def tuber(number: int, mesh_mm: float, weight_g: float, sd_mm: float = 2.0) -> Tuber:
    return Tuber(
        number, "r", number * 10**8, -0.1 * number, 0.0, weight_g, 0.9 * weight_g, 1.1 * weight_g, 70.0, 50.0, 45.0,
        3, "pointraft", "m", (), ("a",), (f"r/a/{number}-1",), sizes(mesh_mm, sd_mm),
    )  # fmt: skip


def drawn(rng: np.random.Generator, n: int, *, mean: float, spread: float, error: float) -> tuple[LoadSums, np.ndarray]:
    """A load with errors of its own, and (n, 2) its true mesh sizes and weights."""
    true_mm = rng.normal(mean, spread, n)
    grams = 1.2e-3 * true_mm**3
    sums = LoadSums(50.0)
    for k, (mm, g) in enumerate(zip(true_mm, grams, strict=True)):
        sums.add(tuber(k + 1, float(mm + rng.normal(0, error)), float(g), error))
    return sums, np.column_stack([true_mm, grams])


def shares_of(truth: np.ndarray, classes: tuple[SizeClass, ...]) -> np.ndarray:
    mm, grams = truth.T
    return np.array([grams[(mm >= c.low_mm) & (mm < c.high_mm)].sum() for c in classes]) / grams.sum()


def test_unfolded_shares_are_nearer_the_truth_than_counted_ones_and_their_intervals_hold(tmp_path: Path) -> None:
    rng, classes = np.random.default_rng(SEED), contract(tmp_path).classes
    found, counted, held = [], [], []
    for _ in range(30):
        sums, truth = drawn(rng, 300, mean=52.0, spread=5.0, error=2.5)
        shares = class_shares(sums.sizes.bins["mesh"], classes, measure="mesh")
        true = shares_of(truth, classes)
        found.append([s.weight for s in shares] - true)
        bins = {at: b.grams for at, b in sums.sizes.bins["mesh"].items()}
        total = sum(bins.values())
        counted.append([sum(g for at, g in bins.items() if c.low_mm <= at < c.high_mm) / total for c in classes] - true)
        held += [abs(s.weight - t) <= 1.645 * s.weight_sd for s, t in zip(shares, true, strict=True)]
        assert sum(s.count for s in shares) == pytest.approx(1.0, abs=1e-6)
    middle = 1
    assert abs(np.mean(found, axis=0)[middle]) < 0.02 < -np.mean(counted, axis=0)[middle], f"seed {SEED}"
    assert np.mean(held) > 0.9, f"seed {SEED}: {np.mean(held)}"


def test_what_all_of_a_load_share_is_in_the_interval(tmp_path: Path) -> None:
    """A million tubers, all 1 mm too small: their own errors vanish, the shared one does not."""
    rng, classes = np.random.default_rng(SEED), contract(tmp_path).classes
    sums, _ = drawn(rng, 4000, mean=52.0, spread=5.0, error=1.0)
    shares = class_shares(sums.sizes.bins["mesh"], classes, measure="mesh")
    density_per_mm = float(np.exp(-0.5 * (7 / 5) ** 2) / 5 / np.sqrt(2 * np.pi))
    assert shares[0].count_sd == pytest.approx(density_per_mm * SHARED_SD["mesh"] * 45, rel=0.25)


def test_limits_are_kept_open_or_broken(tmp_path: Path) -> None:
    wanted = contract(tmp_path)
    states = {}
    for mesh_mm in (30.0, 45.0, 52.5, 80.0):
        sums = LoadSums(50.0)
        for k in range(200):
            sums.add(tuber(k + 1, mesh_mm, 150.0, 1.0))
        found = class_totals(LoadTotals(sums), wanted)
        states[mesh_mm] = [each.state for each in found]
        assert sum(each.weight_g for each in found) == pytest.approx(LoadTotals(sums).weight_g, rel=1e-6)
    assert states == {
        30.0: ["broken", "broken", ""],
        45.0: ["open", "open", ""],
        52.5: ["kept", "kept", ""],
        80.0: ["kept", "broken", ""],
    }


def test_a_load_without_sizes_has_no_classes_and_one_with_some_says_so_in_its_interval(tmp_path: Path) -> None:
    wanted, bare, half = contract(tmp_path), LoadSums(50.0), LoadSums(50.0)
    for k in range(100):
        bare.add(replace(tuber(k + 1, 50.0, 100.0), sizes=None))
        half.add(replace(tuber(k + 1, 40.0 + 0.2 * k, 100.0), sizes=None if k % 2 else sizes(40.0 + 0.2 * k)))
    assert class_totals(LoadTotals(bare), wanted) == ()
    ware = class_totals(LoadTotals(half), wanted)[1]
    assert ware.count == pytest.approx(75, abs=8)
    assert ware.count_high - ware.count_low > 30


def test_loads_add_up_each_by_its_own_ticket_and_what_they_share_does_not_shrink(tmp_path: Path) -> None:
    rng, wanted = np.random.default_rng(SEED), contract(tmp_path)
    sums, _ = drawn(rng, 300, mean=50.0, spread=5.0, error=1.0)
    heavy = [Ticket(f"r{n}", "m", 1.1e6, 1000.0, 1e6, 3000.0, 1.0) for n in range(5)]
    bare, weighed = LoadTotals(sums), LoadTotals(sums, heavy)
    alone = class_totals(bare, wanted)
    assert classes_together([bare] * 9, wanted)[1].percent == pytest.approx(alone[1].percent)
    one, nine = (classes_together([bare] * n, wanted)[0] for n in (1, 9))
    assert one == alone[0]
    shared = 164.4 * abs(_moved(sums, wanted))
    assert shared <= nine.percent_high - nine.percent < one.percent_high - one.percent
    # Two loads of other tickets: their shares by their kilograms, belt that was not seen with them.
    both, corrected = classes_together([bare, weighed], wanted, whole=[1.0, 2.0]), class_totals(weighed, wanted)
    assert corrected[2].percent > alone[2].percent + 2, "a scale that says more makes all of them larger"
    kg = np.array([bare.weight_g, 2 * weighed.weight_g])
    for k, told in enumerate(both):
        assert told.percent == pytest.approx(kg @ [alone[k].percent, corrected[k].percent] / kg.sum())
    unsized = LoadSums(50.0)
    unsized.add(replace(tuber(1, 50.0, 100.0), sizes=None))
    assert classes_together([LoadTotals(unsized)], wanted) == ()


def _moved(sums: LoadSums, wanted: Contract) -> float:
    """Share of weight that the first class loses where all sizes are larger by what a recording shares."""
    ratio_sd = LoadTotals(sums).calibrated()
    sd = np.hypot(ratio_sd.parts_g[RESTING], ratio_sd.parts_g[CAMERA]) / ratio_sd.weight_g
    return class_shares(sums.sizes.bins["mesh"], wanted.classes, measure="mesh", weight_sd=float(sd))[0].weight_moved


def test_sums_come_back_with_their_sizes_and_add_up(tmp_path: Path) -> None:
    sums, _ = drawn(np.random.default_rng(SEED), 50, mean=52.0, spread=5.0, error=1.0)
    again = LoadSums.from_plain(sums.plain())
    assert again.same_as(sums)
    both = again.copy()
    both.take(sums)
    assert both.sizes.bins["mesh"].keys() == sums.sizes.bins["mesh"].keys()
    assert sum(b.count for b in both.sizes.bins["length"].values()) == 100
    older = {name: value for name, value in sums.plain().items() if name != "sizes"}
    assert LoadSums.from_plain(older).sizes.plain() == {}
    told = class_totals(LoadTotals(sums), contract(tmp_path))
    message = LoadTotals(sums).message("r", coverage=1.0, cameras={}, final=True, contract="ware", classes=told)
    assert Totals.decode(message.encode()).classes == told


def test_a_tubers_row_keeps_its_sizes_and_an_old_one_its_checksum() -> None:
    sized = tuber(1, 50.0, 100.0)
    assert tuber_from(tuber_row(sized)[:-1]) == sized
    bare = replace(sized, sizes=None)
    *columns, _crc = tuber_row(bare)
    assert tuber_from(columns) == bare
    from aggregator.ledger.schema import checksum

    assert checksum(columns) == checksum(columns[:17])


def test_views_are_fused_by_how_well_they_know_it() -> None:
    fused = fuse_sizes([sizes(50.0, 1.0), sizes(56.0, 2.0)])
    assert fused is not None
    assert fused.mesh_mm == pytest.approx(51.2)
    assert 0.8 < fused.mesh_sd_mm < 1.3
    assert fuse_sizes([]) is None


def test_the_order_of_answers_changes_no_bit_of_a_size() -> None:
    views = [sizes(57.123, 0.313), sizes(56.077, 2.891), sizes(58.951, 1.117), sizes(57.4, 0.7)]
    assert len({repr(fuse_sizes(order)) for order in permutations(views)}) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("measure = 'width'\n[[classes]]\nname='a'", "mesh"),
        ("[[classes]]\nname='a'\nfrom_mm=40\nto_mm=40", "from < to"),
        ("[[classes]]\nname='a'\nto_mm=45\n[[classes]]\nname='b'\nfrom_mm=40", "overlap from 40 to 45"),
        ("[[classes]]\nname='a'\n[[classes]]\nname='a'", "same name"),
        ("[[classes]]\nname='a'\nat_least_percent=60\nat_most_percent=50", "no share is both"),
        ("[[classes]]\nnmae='a'", r"classes\.0\.nmae: unknown key; known here: name, from_mm, to_mm, at_least_percent"),
        ("meassure='mesh'\n[[classes]]\nname='a'", "meassure: unknown key; known here: name, measure, classes"),
        ("classes = 3", "classes"),
        ("classes = [", "not TOML"),
    ],
)
def test_a_contract_is_refused_with_its_fault(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        contract(tmp_path, text)
