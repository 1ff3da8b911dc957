"""Training: the reduced graph is exact, a resumed training is the unbroken one, nothing of the validation leaks in."""

from __future__ import annotations

import copy
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from conveyor.errors import InputError, TuberlineError
from regressor.network.checkpoint import load_checkpoint, save_checkpoint, state_of
from regressor.network.pointraft import PointRaft
from regressor.network.reduced import Resolution, reduced_forward
from regressor.network.sampling import farthest_points
from regressor.network.sidecar import Sidecar
from regressor.studies.ablate import RULES, ablate, read_table
from regressor.studies.evaluate import LINEAR_BOX, evaluate
from regressor.studies.report import markdown, summary
from regressor.training.augment import Augmentation
from regressor.training.calibration import recalibrate
from regressor.training.cloudset import CloudSet, load_cloudset
from regressor.training.loop import load_state, save_state
from regressor.training.recipe import TrainSettings
from regressor.training.run import RunOptions, clean_views, load_sets, train
from regressor.training.stacking import restack
from regressor.training.train import Training, predict
from regressor.weigh.blend import BlendRule
from regressor.weigh.volume import fit_volume_rule
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import write_pack
from tests.regressor.training_step import check_same_step, readable_in_training
from tuberline.cli.train import _tell

QUICK = TrainSettings(epochs=1.0, batch=8, warm_share=1.0, wide_share=0.0, natural_share=0.5, frozen_share=0.25)
ONE_STEP = replace(QUICK, epochs=0.2)
SILENT: dict[str, Any] = dict.fromkeys(("on_prepared", "on_step", "on_validated"), lambda *_: None)


@pytest.fixture(scope="module")
def packs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packs")
    write_pack(folder / "train", tubers=20, views=2, seed=1)
    write_pack(folder / "val", tubers=10, views=2, seed=2)
    return folder


@pytest.fixture(scope="module")
def data(packs: Path) -> CloudSet:
    return load_cloudset(packs / "train")


def test_reduced_graph_equals_the_readable_network_in_training() -> None:
    """Clouds of 128 points have 64 and 16 centroids, so both forms see the same edges and the same statistics."""
    readable = readable_in_training()
    reduced = copy.deepcopy(readable)
    rng = np.random.default_rng(0)
    clouds = [(rng.normal(size=(128, 3)) * 0.02).astype(np.float32) for _ in range(4)]
    points = [torch.from_numpy(cloud[farthest_points(cloud, 128)]).double() for cloud in clouds]
    heights = torch.from_numpy(rng.uniform(0.02, 0.08, 4))
    expected = readable(points, heights)
    found = reduced_forward(reduced, torch.stack(points), heights, resolution=Resolution(64, 16))
    check_same_step(readable, expected, reduced, found)


def test_reduced_graph_equals_the_readable_network_in_evaluation(data: CloudSet) -> None:
    torch.manual_seed(1)
    model = PointRaft().eval()
    rows = slice(0, 3)
    heights = torch.from_numpy(np.clip(data.height_m[rows], 0, 0.08).astype(np.float32))
    points = torch.from_numpy(data.points[rows, :128].copy())
    with torch.inference_mode():
        # 1017 points and more have 128 second-stage centroids; a prediction sees only the first 128 of them.
        whole = [torch.cat([cloud, cloud[:1].expand(1024 - 128, 3)]) for cloud in points]
        expected = model(whole, heights)
        found = reduced_forward(model, points, heights)
    assert found.numpy() == pytest.approx(expected.numpy(), rel=1e-4, abs=1e-5)


def test_a_resumed_training_is_the_unbroken_one(data: CloudSet, tmp_path: Path) -> None:
    unbroken = Training(data, data, QUICK)
    losses = [unbroken.step() for _ in range(4)]
    first = Training(data, data, QUICK)
    before = [first.step() for _ in range(2)]
    save_state(first, tmp_path / "state.pt")
    second = Training(data, data, QUICK)
    second.restore(load_state(tmp_path / "state.pt"))
    assert before + [second.step() for _ in range(2)] == losses
    for name, value in unbroken.model.state_dict().items():
        assert torch.equal(value, second.model.state_dict()[name]), name


def test_a_training_goes_on_as_it_was_begun(data: CloudSet) -> None:
    """Another recipe, learning rate or data set was taken without a word: half of one training and half of another."""
    state = Training(data, data, QUICK).state()
    Training(data, data, QUICK).restore(state)
    other = replace(QUICK, epochs=3.0, augmentation=Augmentation.paper())
    with pytest.raises(InputError, match=r"epochs 1.0, now 3.0; turn_deg 180.0, now 2.0; .*or begin another one"):
        Training(data, data, other).restore(state)
    with pytest.raises(InputError, match="begun otherwise: other training views"):
        Training(data.subset(np.arange(30)), data, QUICK).restore(state)
    with pytest.raises(InputError, match="begun otherwise: other validation views"):
        Training(data, data.subset(np.arange(30)), QUICK).restore(state)


def test_a_training_goes_on_from_the_weights_that_it_started_from(packs: Path, tmp_path: Path) -> None:
    """Another --start was ignored and written down as the command; another --val rewrote the figures."""
    torch.manual_seed(4)
    for name in ("a", "b"):
        save_checkpoint(tmp_path / f"{name}.safetensors", PointRaft().state_dict(), Sidecar(name=name))
    first = replace(_options(packs, tmp_path / "out"), start=tmp_path / "a.safetensors")
    train(first, ONE_STEP, **SILENT)
    again = replace(first, resume=True)
    train(again, ONE_STEP, **SILENT)
    with pytest.raises(InputError, match=r"begun from other weights.* --start of its first call"):
        train(replace(again, start=tmp_path / "b.safetensors"), ONE_STEP, **SILENT)
    with pytest.raises(InputError, match="begun from other weights"):
        train(replace(again, start=None), ONE_STEP, **SILENT)
    write_pack(tmp_path / "other", tubers=10, views=2, seed=7)
    with pytest.raises(InputError, match="begun otherwise: other validation views"):
        train(replace(again, validation=tmp_path / "other"), ONE_STEP, **SILENT)
    # Weights that differ in a part which the other network has not ended in a KeyError.
    begun = load_checkpoint(tmp_path / "a.safetensors")[0].state_dict()
    flat = PointRaft(height_embedding=False).state_dict()
    flat |= {name: value for name, value in begun.items() if name in flat and value.shape == flat[name].shape}
    save_checkpoint(tmp_path / "flat.safetensors", flat, Sidecar(name="flat"))
    other = replace(again, start=tmp_path / "flat.safetensors")
    with pytest.raises(InputError, match="begun otherwise: height_embedding True, now False"):
        train(other, replace(ONE_STEP, height_embedding=False), **SILENT)
    with pytest.raises(InputError, match=r"flat.safetensors are not of pointraft's .*'height_em.* is missing; .*more"):
        train(other, ONE_STEP, **SILENT)


def test_a_state_that_cannot_be_read_says_how_to_go_on(packs: Path, tmp_path: Path) -> None:
    """It said to start without --resume, and without it that --resume goes on."""
    with pytest.raises(InputError, match=r"out holds no training to go on with .*: leave --resume out"):
        train(replace(_options(packs, tmp_path / "out"), resume=True), QUICK, **SILENT)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "state.pt").write_bytes(b"half a state")
    with pytest.raises(InputError, match=r"cannot be read.*another --out, or take that file away to begin again"):
        train(replace(_options(packs, tmp_path / "out"), resume=True), QUICK, **SILENT)
    for other in (torch.zeros(3), PointRaft().state_dict()):
        torch.save(other, tmp_path / "out" / "state.pt")
        with pytest.raises(InputError, match=r"state.pt is none of a training, or of another version"):
            train(replace(_options(packs, tmp_path / "out"), resume=True), QUICK, **SILENT)


def test_what_a_killed_training_left_goes_at_the_next_start(packs: Path, tmp_path: Path) -> None:
    killed = tmp_path / "out" / ".state.pt.partial-abcd"
    killed.mkdir(parents=True)
    (killed / "state.pt").write_bytes(b"half")
    (tmp_path / "out" / ".notes.partial-x").mkdir()
    train(_options(packs, tmp_path / "out"), ONE_STEP, **SILENT)
    assert not killed.exists()
    assert (tmp_path / "out" / ".notes.partial-x").exists()


def test_a_resumed_fine_tuning_keeps_a_share_of_what_it_started_from(data: CloudSet) -> None:
    """The weights to start from were not in the state: the mean was taken with whatever --start named at the end."""
    settings = replace(QUICK, start_share=1.0)
    torch.manual_seed(4)
    begin, other = PointRaft().state_dict(), PointRaft().state_dict()
    first, second = (Training(data, data, settings) for _ in range(2))
    first.start_from(begin)
    second.start_from(other)
    second.restore(first.state())
    kept = second.finished_model().state_dict()
    assert all(torch.equal(kept[name], value) for name, value in begin.items() if value.is_floating_point())


def test_a_loss_that_is_no_number_ends_the_training(data: CloudSet) -> None:
    """It went on to the end, and shipped weights that answer nothing."""
    training = Training(data, data, QUICK)
    with torch.no_grad():
        training.model.regression_head.lins[-1].bias.fill_(np.nan)  # type: ignore[operator, union-attr]
    with pytest.raises(TuberlineError, match=r"loss of step 1 is no number: a smaller --lr \(it was 0.001\)"):
        training.step()
    assert training.progress.step == 0


def test_a_validation_changes_no_step(data: CloudSet) -> None:
    """The validated network's first parameters were drawn from the training's random numbers: every validation changed
    the dropout after it, and when one comes is the clock's choice.
    """
    settings = replace(QUICK, dropout=0.5)
    plain = Training(data, data, settings)
    losses = [plain.step() for _ in range(4)]
    validated, found = Training(data, data, settings), []
    for _ in range(4):
        found.append(validated.step())
        validated.finished_model()
    assert found == losses


def test_a_gpu_takes_the_same_steps_or_is_said_to_be_missing(data: CloudSet, tmp_path: Path) -> None:
    settings = replace(QUICK, dropout=0.0)
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="finds no CUDA GPU here; use 'cpu'"):
            Training(data, data, replace(settings, device="cuda"))
        pytest.skip("no CUDA GPU here: training was NOT compared on one")
    here, there = Training(data, data, settings), Training(data, data, replace(settings, device="cuda"))
    # Each from where the GPU stands: Adam's first steps go by the signs of gradients, so that rounding grows from step
    # to step.
    for _ in range(3):
        save_state(there, tmp_path / "state.pt")
        here.restore(load_state(tmp_path / "state.pt"))
        assert there.step() == pytest.approx(here.step(), rel=1e-4)
    save_state(there, tmp_path / "state.pt")
    here.restore(load_state(tmp_path / "state.pt"))
    assert predict(there.finished_model(), data, highest_m=0.16) == pytest.approx(
        predict(here.finished_model(), data, highest_m=0.16), rel=1e-3
    )


def test_a_broken_state_is_named(tmp_path: Path) -> None:
    (tmp_path / "state.pt").write_bytes(b"half a file")
    with pytest.raises(InputError, match=r"state.pt cannot be read"):
        load_state(tmp_path / "state.pt")


def test_a_fine_tuning_may_keep_a_share_of_what_it_started_from(data: CloudSet) -> None:
    """The mean of both, weight by weight; 0 is the trained one alone, 1 the one it began with."""
    torch.manual_seed(3)
    begin = {name: value.clone() for name, value in PointRaft().state_dict().items()}
    found = {}
    for share in (0.0, 0.5, 1.0):
        training = Training(data, data, replace(QUICK, start_share=share, average=0.0))
        training.start_from(begin)
        for _ in range(2):
            training.step()
        found[share] = training.finished_model().state_dict()
    for name, value in begin.items():
        if value.is_floating_point():
            assert torch.equal(found[1.0][name], value), name
            assert torch.allclose(found[0.5][name], (found[0.0][name] + value) / 2, rtol=1e-5, atol=1e-7), name
    assert any(not torch.equal(found[0.0][name], value) for name, value in begin.items())


def test_tubers_of_the_validation_set_are_left_out(packs: Path, tmp_path: Path) -> None:
    both = tmp_path / "both"
    both.mkdir()
    (both / "a").symlink_to(packs / "train")
    (both / "b").symlink_to(packs / "val")
    options = _options(packs, tmp_path / "out")
    training, validation = load_sets(replace(options, data=both), lambda what, done: None)
    assert len(training) == 40
    assert len(validation) == 20
    with pytest.raises(InputError, match="nothing is left to train on"):
        load_sets(
            replace(options, data=packs / "val", validation=both, max_validation_views=99), lambda what, done: None
        )


def test_tubers_under_soil_are_left_out_and_counted(data: CloudSet) -> None:
    """Their truth is their weight without it; where nothing is known of soil, all stay."""
    assert len(clean_views(data, Path("pack"))) == len(data)
    soil_mm = np.where(np.arange(len(data)) < 7, 1.5, 0.0)
    kept = clean_views(replace(data, soil_mm=soil_mm), Path("pack"))
    assert len(kept) == len(data) - 7
    assert kept.refused == {**data.refused, "under_soil": 7}
    assert (kept.weight_g == data.weight_g[7:]).all()
    with pytest.raises(InputError, match="pack is under soil"):
        clean_views(replace(data, soil_mm=np.full(len(data), 1.5)), Path("pack"))


def _options(packs: Path, out: Path) -> RunOptions:
    return RunOptions(
        data=packs / "train",
        validation=packs / "val",
        out=out,
        name="tiny",
        resume=False,
        save_minutes=10,
        validate_minutes=10,
        max_validation_views=20,
        command="tuberline train",
    )


def _by_recording(folder: Path) -> None:
    """Give every tuber of a pack a recording of its own."""
    file = folder / "views-00000.npz"
    with np.load(file) as stored:
        arrays = dict(stored)
    np.savez(file, **arrays, recording=arrays["tuber"])


def test_a_whole_training_writes_weights_that_weigh(packs: Path, data: CloudSet, tmp_path: Path) -> None:
    options = _options(packs, tmp_path / "out")
    seen: list[dict[str, Any]] = []
    sidecar = train(
        options,
        QUICK,
        on_prepared=lambda what, done: None,
        on_step=lambda training: None,
        on_validated=lambda training, metrics: seen.append(metrics),
    )
    assert seen[-1]["validation"]["views"] == 20
    model, loaded = load_checkpoint(tmp_path / "out" / "weights.safetensors")
    assert loaded == sidecar
    assert loaded.training["tubers"] == 20
    rule = fit_volume_rule(data.view_features, data.weight_g)
    assert rule.weights_g(data.view_features) == pytest.approx(data.weight_g, rel=0.15)
    assert predict(model, data, highest_m=0.08).shape == (40,)
    assert Weigher(state_of(model), loaded).sidecar.interval_rule is not None
    weights = tmp_path / "out" / "weights.safetensors"
    before = weights.read_bytes()
    write_pack(tmp_path / "unseen", tubers=24, views=2, seed=5)
    _by_recording(tmp_path / "unseen")
    again = recalibrate(weights, tmp_path / "unseen", cache=None, max_views=30)
    assert again.metrics["calibration"]["views"] == 30
    assert again.interval_rule != loaded.interval_rule
    assert weights.read_bytes() == before
    assert load_checkpoint(weights)[1] == again
    with pytest.raises(InputError, match="1 recordings without soil on the tubers; at least 20"):
        restack(weights, packs / "train", packs / "val", cache=None)
    with pytest.raises(InputError, match=r"--unseen .*train is what .* were trained on: .* a blend would trust it"):
        restack(weights, packs / "val", packs / "train", cache=None)
    # With --max-views they were not known again.
    with pytest.raises(InputError, match=r"were trained on: .* intervals would be too narrow"):
        recalibrate(weights, packs / "train", cache=None, max_views=30)
    stacked = restack(weights, packs / "train", tmp_path / "unseen", cache=None)
    assert stacked.blend_rule.share == stacked.volume_share
    assert stacked.volume_rule != again.volume_rule
    assert stacked.metrics["blend"]["views"] == 48
    for pack in (packs / "train", tmp_path / "unseen"):
        shutil.copytree(pack, tmp_path / "both" / pack.name)
    # The rule was judged on views of its own fit.
    assert restack(weights, tmp_path / "both", tmp_path / "unseen", cache=None) == stacked
    plain = restack(weights, packs / "train", tmp_path / "unseen", cache=None, correction=False)
    assert plain.blend_rule == BlendRule(plain.volume_share)
    assert plain.model_id != stacked.model_id
    assert weights.read_bytes() == before
    with pytest.raises(InputError, match="--resume"):
        train(options, QUICK, **SILENT)


def test_another_target_is_a_setting(packs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sidecar = train(_options(packs, tmp_path / "out"), replace(ONE_STEP, target="volume_ml"), **SILENT)
    weights = tmp_path / "out" / "weights.safetensors"
    truth = load_cloudset(packs / "train").volume_ml
    assert sidecar.target == "volume_ml"
    _tell(weights, sidecar)
    assert f"MAE {sidecar.metrics['validation']['mae_g']:.1f} ml per view" in capsys.readouterr().err, "it said g"
    assert (sidecar.weight_g.low, sidecar.weight_g.high) == pytest.approx((truth.min(), truth.max()), abs=1e-3)
    with pytest.raises(InputError, match="give volume_ml: a line weighs"):
        Weigher.load(weights)
    result = evaluate(packs / "val", Weigher.load(weights, any_target=True))
    assert result.weight_g == pytest.approx(load_cloudset(packs / "val").volume_ml)
    assert "read its unit" in markdown(summary(result), title="x")
    with pytest.raises(InputError, match="a known length_mm: it cannot be the target"):
        replace(load_cloudset(packs / "val"), length_mm=np.full(20, np.nan)).with_target("length_mm")


def test_ablations_are_trained_once_and_compared(packs: Path, tmp_path: Path) -> None:
    settings = ONE_STEP
    options = _options(packs, tmp_path / "out")
    steps: list[str] = []

    def run() -> dict[str, dict[str, float]]:
        names = ("no-height", "pointnet", "2048-points")
        return ablate(
            names, settings, options, test=packs / "val", max_views=4, on_step=lambda name, _: steps.append(name)
        )

    table = run()
    assert set(steps) == {"no-height", "pointnet", "2048-points"}
    assert set(table) == set(steps) | set(RULES)
    assert read_table(options.out)[0] == table
    words = (options.out / "ablation.md").read_text(encoding="utf-8")
    assert f"| {LINEAR_BOX} | – |" in words
    assert "23.0 g, 31.8 g, 0.91" in words
    with pytest.raises(InputError, match="are of a 'pointnet'"):
        load_checkpoint(tmp_path / "out" / "pointnet" / "weights.safetensors")
    model, sidecar = load_checkpoint(tmp_path / "out" / "no-height" / "weights.safetensors")
    assert model.height_embed is None
    assert not sidecar.input.height_embedding
    assert load_checkpoint(tmp_path / "out" / "2048-points" / "weights.safetensors")[1].input.centroids == (1024, 256)
    count = len(steps)
    assert run() == table
    assert len(steps) == count
    # Finished variants stood in the table of other options, under the words of these.
    longer = replace(settings, epochs=0.4)
    with pytest.raises(InputError, match=r"no-height.weights.safetensors was trained otherwise: epochs 0.2, now 0.4\."):
        ablate(("no-height",), longer, options, test=packs / "val", max_views=4, on_step=lambda name, _: None)
    others = replace(options, data=packs / "val", validation=packs / "train")
    with pytest.raises(InputError, match=r"trained otherwise: other training views\. A table compares"):
        ablate(("no-height",), settings, others, test=packs / "val", max_views=4, on_step=lambda name, _: None)
    assert len(steps) == count
    with pytest.raises(InputError, match="absent is not there"):  # it was trained before anyone looked
        ablate(("full",), settings, options, test=packs / "absent", max_views=4, on_step=lambda name, _: None)
    assert not (options.out / "full").exists()
    with pytest.raises(InputError, match="known: full, no-height"):
        ablate(("no-hight",), settings, options, test=packs / "val", max_views=4, on_step=lambda name, _: None)
