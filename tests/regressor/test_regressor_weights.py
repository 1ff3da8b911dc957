"""Weights given to a running regressor, piece by piece: parcels, uploads, the store on disk, the check before use."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.config import parse_config
from conveyor.errors import InputError, MessageError, StorageError
from conveyor.node import Node
from regressor.network.checkpoint import load_checkpoint, save_checkpoint, save_sidecar
from regressor.network.sidecar import Range
from regressor.network.stored import SHIPPED
from regressor.serve.check import belt_distance_m, check_weights, reference_clouds
from regressor.serve.form import form_of
from regressor.serve.messages import WeightsParcel, digest_of, read_parcel, write_checkpoint
from regressor.serve.service import WeightsService
from regressor.serve.store import Order, WeightsStore
from regressor.serve.upload import Upload
from regressor.weigh.weigher import Weigher
from tests.fuzz.damage import damaged, outcome, quick

LINE = parse_config({"cameras": {"left": {"belt_distance_m": 0.345}}}, where="test")


def scaled_weights(path: Path, factor: float) -> Path:
    """The shipped weights with a network that answers `factor` times as many grams."""
    model, sidecar = load_checkpoint()
    state = dict(model.state_dict())
    last = max(name for name in state if name.startswith("regression_head.lins."))
    layer = last.rsplit(".", 1)[0]
    for part in ("weight", "bias"):
        state[f"{layer}.{part}"] = state[f"{layer}.{part}"] * factor
    save_checkpoint(path, state, sidecar.model_copy(update={"name": path.stem}))
    return path


def test_a_sidecar_that_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    """The one that it was to replace was gone by then."""
    path = scaled_weights(tmp_path / "own.safetensors", 1.0)
    before = path.with_suffix(".json").read_bytes()
    model, sidecar = load_checkpoint(path)
    broken = sidecar.model_copy(update={"blend": {"share": 0.0, "intercept": float("nan"), "slopes": [], "seen": {}}})
    with pytest.raises(ValueError, match="blend is damaged"):
        save_sidecar(path, broken)
    with pytest.raises(ValueError, match="blend is damaged"):
        save_checkpoint(path, model.state_dict(), broken)
    assert path.with_suffix(".json").read_bytes() == before
    assert load_checkpoint(path)[1] == sidecar


@pytest.mark.parametrize("ending", [".safetensors", ".json"])
def test_weights_and_sidecar_are_written_together_or_not_at_all(tmp_path: Path, ending: str) -> None:
    """A disk that was full after the tensors left them beside the former sidecar: neither could be used any more."""
    path = scaled_weights(tmp_path / "own.safetensors", 1.0)
    sidecar = load_checkpoint(path)[1]
    before = path.read_bytes()
    path.with_suffix(f"{ending}.partial").mkdir()  # where the new one would be written
    with pytest.raises(InputError, match=r"own.safetensors cannot be written: Is a directory"):
        scaled_weights(path, 2.0)
    assert path.read_bytes() == before
    assert load_checkpoint(path)[1] == sidecar


def test_a_parcel_gives_back_file_and_sidecar(tmp_path: Path) -> None:
    parcel = read_parcel(SHIPPED)
    assert parcel == read_parcel(SHIPPED), "the same weights have the same name everywhere"
    path = write_checkpoint(parcel, tmp_path)
    assert path.read_bytes() == SHIPPED.read_bytes()
    assert Weigher.load(path).sidecar == Weigher.load().sidecar
    with pytest.raises(InputError, match=r"absent.pth or their sidecar cannot be read"):
        read_parcel(tmp_path / "absent.pth")
    with pytest.raises(InputError, match=r"no .safetensors or .pth file"):
        read_parcel(tmp_path / "model.onnx")


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"radii_m": [0.1, 0.2]}, r"radii_m is \(0.1, 0.2\), and this program's networks have \(0.2, 0.4\)"),
        ({"neighbours": 32}, "neighbours is 32, and this program's networks have 64"),
        ({"points": 512}, r"centroids is \(512, 128\), and this program's networks have \(256, 64\)"),
        ({"points": -5}, "points: must be at least 64"),
    ],
)
def test_weights_of_a_network_that_groups_otherwise_are_refused(
    tmp_path: Path, changed: dict[str, object], told: str
) -> None:
    """The tensors are the same, so they were taken, and weighed with this program's radii."""
    path = scaled_weights(tmp_path / "other.safetensors", 1.0)
    said = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    said["input"] |= changed
    path.with_suffix(".json").write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(InputError, match=told):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ("rule", "changed", "told"),
    [
        ("interval", {"at_g": None}, "its interval is damaged or of another version of this program: at_g is None"),
        ("interval", {"below_g": [-1.0]}, "below_g has 1 numbers, and this rule takes"),
        ("volume_rule", {"coefficients": [1.0, 1.0]}, "coefficients has 2 numbers, and this rule takes 37"),
        ("volume_rule", {"products": [1.0]}, "products has 1 numbers, and this rule takes 703"),
        ("volume_rule", {"intercept": float("nan")}, "intercept holds nan, which is no number"),
        ("blend", {"seen": {"mud": {}}}, "its blend .* a blend corrects for .'mud'.; known: rim_lost"),
    ],
)
def test_weights_whose_rules_cannot_be_read_are_refused(
    tmp_path: Path, rule: str, changed: dict[str, object], told: str
) -> None:
    """Short rules were read beyond their end, as 3.7 kg; others ended `weigh`, and a regressor that was given them."""
    path = scaled_weights(tmp_path / "other.safetensors", 1.0)
    said = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    said[rule] |= changed
    path.with_suffix(".json").write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(InputError, match=told):
        load_checkpoint(path)


@pytest.mark.parametrize("name", ["../../etc/passwd.pth", ".pth", "a/b.pth", "x.exe", "a" * 90 + ".pth"])
def test_a_parcel_cannot_name_a_file_elsewhere(name: str) -> None:
    with pytest.raises(MessageError, match="not the name of a"):
        WeightsParcel(name, "", np.zeros(1, np.uint8))


def test_damaged_parcels() -> None:
    @quick(40)
    @given(damaged(WeightsParcel("a.safetensors", "{}", np.arange(64, dtype=np.uint8)).encode(), head=150))
    def decode(data: bytes) -> None:
        outcome(lambda: WeightsParcel.decode(data))

    decode()


@quick(50)
@given(st.binary(min_size=1, max_size=400), st.integers(1, 97), st.data())
def test_pieces_come_twice_late_and_never_with_a_gap(parcel: bytes, step: int, data: st.DataObject) -> None:
    upload, digest, have, whole = Upload(), digest_of(parcel), 0, None
    while whole is None:
        offset = data.draw(st.sampled_from([have, max(0, have - step), have + 1]))
        piece = parcel[offset : offset + step]
        if offset > have:
            with pytest.raises(InputError, match="does not follow"):
                upload.take(digest, offset=offset, size=len(parcel), piece=b"x")
            continue
        have, whole = upload.take(digest, offset=offset, size=len(parcel), piece=piece)
    assert whole == parcel


def test_an_upload_that_is_not_what_its_name_says_is_refused() -> None:
    upload = Upload()
    with pytest.raises(InputError, match="they were damaged on the way"):
        upload.take(digest_of(b"other"), offset=0, size=3, piece=b"abc")
    with pytest.raises(InputError, match="weights of 99999999999 bytes"):
        upload.take("0" * 64, offset=0, size=99999999999, piece=b"")
    assert upload.take(digest_of(b"abc"), offset=0, size=3, piece=b"abc") == (3, b"abc")


def test_the_store_keeps_parcels_and_the_order_across_a_restart(tmp_path: Path) -> None:
    folder = tmp_path / "r1"
    store, parcel = WeightsStore(folder), read_parcel(SHIPPED)
    assert not store.has(digest_of(parcel))
    assert store.recorded(config_digest="c") is None
    assert not folder.exists(), "nothing is written before weights are given"
    digest = store.add(parcel)
    order = Order(3, digest, "p", "old@1", "c")
    store.record(order)
    again = WeightsStore(folder)
    assert again.recorded(config_digest="c") == order
    assert again.recorded(config_digest="another config's") is None
    assert again.load(digest).sidecar.model_id == Weigher.load().sidecar.model_id
    damaged_parcel = bytearray(parcel)
    damaged_parcel[-1] ^= 1
    (folder / f"{digest}.parcel").write_bytes(damaged_parcel)
    with pytest.raises(InputError, match="were damaged on the disk"):
        again.load(digest)
    assert not again.has(digest), "it was said to be here, so that giving it again changed nothing"
    assert again.load(again.add(parcel)).sidecar.model_id == Weigher.load().sidecar.model_id
    (folder / "order.json").write_text(json.dumps({"n": "x"}))
    with pytest.raises(InputError, match=r"order.json cannot be read"):
        again.recorded(config_digest="c")
    again.keep_only(set())
    assert not again.has(digest)


def test_a_disk_that_refuses_is_an_error_in_words_and_ends_no_regressor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a full or read-only disk: it was no error of ours, so that `weights use` ended the regressors."""
    folder = tmp_path / "r1"
    store = WeightsStore(folder)
    digest = store.add(read_parcel(SHIPPED))
    (folder / f"{digest_of(b'other')}.parcel.partial").mkdir()
    with pytest.raises(StorageError, match=r"parcel cannot be written: Is a directory; that is a folder: name a file"):
        store.add(b"other")
    (folder / "some.parcel").mkdir()
    with pytest.raises(StorageError, match=r"some.parcel cannot be removed: Is a directory"):
        store.keep_only({digest})
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(StorageError, match=rf"weights {digest[:16]} cannot be unpacked: \S+gone\S+: No such file"):
        store.load(digest)
    with pytest.raises(StorageError, match=r"weights cannot be kept: \S+gone\S+: No such file"):
        WeightsStore(None).add(b"other")


def test_a_regressor_that_starts_again_waits_for_room_and_takes_no_other_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 75: it is started again until there is room."""
    store, own = WeightsStore(tmp_path / "r1"), digest_of(read_parcel(SHIPPED))
    store.record(Order(3, store.add(WeightsParcel("given.pth", "", np.zeros(9, np.uint8)).encode()), config_digest=own))
    line = parse_config({"regressor": {"state_dir": str(tmp_path)}}, where="test")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(StorageError, match="cannot be unpacked"):
        WeightsService(Node("regressor", "r1", config=line, run="test"), Weigher.load()).open()


def test_a_disk_that_was_full_for_a_moment_keeps_no_regressor_from_following(tmp_path: Path) -> None:
    """It was taken for weights that are refused: the regressor went on with its own until a newer order came."""
    line = parse_config({"regressor": {"state_dir": str(tmp_path)}}, where="test")
    service = WeightsService(Node("regressor", "r1", config=line, run="test"), Weigher.load())
    given = WeightsStore(tmp_path / "r1").add(read_parcel(scaled_weights(tmp_path / "given.safetensors", 1.01)))
    order = Order(3, given, config_digest=service.state.digest)
    refuses = tmp_path / "r1" / "order.json.partial"
    refuses.mkdir()
    service._follow_order(order, "r2")
    assert (service.state.n, service.state.refused) == (0, "")
    refuses.rmdir()
    service._follow_order(order, "r2")
    assert (service.state.n, service.state.digest) == (3, given)


def test_given_weights_are_computed_in_a_form_of_their_own(shared: Path, tmp_path: Path) -> None:
    """They took over how many centroids the config's weights need: 16, with which these are up to 3 g off."""
    line = parse_config({"regressor": {"state_dir": str(tmp_path), "precision": "fastest"}}, where="test")
    shipped = Weigher.load()
    service = WeightsService(Node("regressor", "r1", config=line, run="test"), shipped.in_form(form_of(line, shipped)))
    given = WeightsStore(tmp_path / "r1").add(read_parcel(shared / "fixtures" / "pointraft_fixture.pth"))
    assert service.turn().form.centroids == 16
    assert service._weigher_of(given).form.centroids is None


def test_without_a_folder_given_weights_live_as_long_as_the_process() -> None:
    store = WeightsStore(None)
    digest = store.add(b"parcel")
    assert store.parcel(digest) == b"parcel"
    store.close()
    assert not store.has(digest)


def test_of_two_orders_one_holds_whoever_looks() -> None:
    one, two, config = Order(2, "b"), Order(2, "a"), Order(0, "z")
    assert one.newer_than(two)
    assert not two.newer_than(one)
    assert two.newer_than(config)
    assert not config.newer_than(replace(config, digest="a")), "the config's own weights follow no one's"


def test_the_shipped_weights_know_the_reference_potatoes() -> None:
    truths = [true_g for _, true_g, _ in reference_clouds(0.345)]
    assert np.allclose(truths, [71.3, 175.6, 338.4], atol=0.05)
    for answer in check_weights(Weigher.load(), LINE):
        assert answer.weight_g == pytest.approx(answer.true_g, rel=0.12), answer
        assert answer.low_g < answer.true_g < answer.high_g


def test_a_network_in_other_units_is_refused_with_the_numbers(tmp_path: Path) -> None:
    kilograms = Weigher.load(scaled_weights(tmp_path / "kilograms.safetensors", 0.001))
    with pytest.raises(InputError, match=r"kilograms@\w{8} fail .* network 0 g for the small one of 71 g"):
        check_weights(kilograms, LINE)
    broken = Weigher.load(scaled_weights(tmp_path / "broken.safetensors", -1.0))
    with pytest.raises(InputError, match="the network gives no answer to the small one"):
        check_weights(broken, LINE)


def test_weights_for_another_camera_height_are_refused() -> None:
    high = parse_config({"cameras": {"left": {"belt_distance_m": 0.345}, "tall": {"belt_distance_m": 1.2}}}, where="t")
    with pytest.raises(InputError, match=r"camera 'tall': it hangs 1.200 m over the belt, they were trained for 0.280"):
        check_weights(Weigher.load(), high)
    posed = {"belt_from_camera": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 1.2], [0, 0, 0, 1]]}
    with pytest.raises(InputError, match=r"camera 'tall': it hangs 1.200 m .* or fix cameras.tall.belt_from_"):
        check_weights(Weigher.load(), parse_config({"cameras": {"tall": posed}}, where="t"))


@pytest.mark.parametrize(("low", "high"), [(0.06, 0.08), (0.0, 0.05), (50.0, 60.0)])
def test_weights_for_no_camera_that_there_is_are_refused(low: float, high: float) -> None:
    """From 0.07 m the largest reference cloud took 27 GiB, nearer it ended in a division by zero; far away its depth
    overflowed. A regressor that was given such weights ended with it.
    """
    shipped = Weigher.load()
    sidecar = shipped.sidecar.model_copy(update={"belt_distance_m": Range(low=low, high=high)})
    with pytest.raises(InputError, match=rf"cameras {low:.3f} to {high:.3f} m over the belt, .* of 0.12 to 5 m"):
        check_weights(Weigher(shipped.state, sidecar), parse_config({"cameras": {}}, where="test"))
    assert 0.12 <= belt_distance_m(sidecar) <= 5
    assert belt_distance_m(sidecar.model_copy(update={"belt_distance_m": Range(low=0.11, high=0.13)})) == 0.12
