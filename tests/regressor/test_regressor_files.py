"""Cloud files, 3DPotatoTwin pairs and checkpoints: what is read, and the one clear error for what is not."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from conveyor.formats.clouds import read_cloud
from conveyor.formats.potatotwin.intrinsics import read_intrinsics
from conveyor.formats.potatotwin.pairs import read_pair
from conveyor.resting import POTATOTWIN
from regressor.network.architecture import NORM_EPSILON, parameter_shapes
from regressor.network.checkpoint import load_checkpoint, save_checkpoint
from regressor.network.pointraft import PointRaft
from regressor.network.sidecar import Sidecar
from regressor.network.stored import load_weights
from regressor.training.labelled import read_labelled
from regressor.weigh.files import FileOptions, once_per_pair, weigh_file
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import D405, ellipsoid_depth_m, ellipsoid_view
from tuberline.cli.checkpoints import import_checkpoint

POINTS = np.array([[0.0, 0.1, 0.3], [0.25, -0.5, 0.125], [1.5, 2.0, -3.0]])

SAVED = PointRaft().state_dict()


def _ply(path: Path, form: str) -> Path:
    header = f"ply\nformat {form} 1.0\ncomment made here\nelement vertex 3\nproperty uchar red\nproperty float x\n"
    header += (
        "property float y\nproperty double z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if form == "ascii":
        body = "".join(f"7 {x} {y} {z}\n" for x, y, z in POINTS).encode()
    else:
        order = "<" if "little" in form else ">"
        body = b"".join(struct.pack(order + "Bffd", 7, *point) for point in POINTS)
    path.write_bytes(header.encode() + body)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(tmp_path: Path, form: str) -> None:
    assert read_cloud(_ply(tmp_path / "a.ply", form)) == pytest.approx(POINTS, abs=1e-7)


def test_an_ascii_ply_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    """It was no PLY file."""
    path = _ply(tmp_path / "a.ply", "ascii")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_cloud(path) == pytest.approx(POINTS, abs=1e-7)


def test_numpy_files(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.savez(tmp_path / "b.npz", anything=POINTS, label=np.array(3))
    np.savez(tmp_path / "c.npz", points=POINTS, normals=POINTS)
    for name in ("a.npy", "b.npz", "c.npz"):
        assert read_cloud(tmp_path / name) == pytest.approx(POINTS)


def test_broken_cloud_files_are_named(tmp_path: Path) -> None:
    whole = _ply(tmp_path / "whole.ply", "binary_little_endian").read_bytes()
    cases = {
        "cut.ply": (whole[:-5], "truncated"),
        "no.ply": (b"solid nothing", "not a PLY file"),
        "endless.ply": (b"ply\nformat ascii 1.0\n", "end_header"),
        "huge.ply": (whole.replace(b"vertex 3", b"vertex 99999999999"), "99999999999 vertices"),
        "noxyz.ply": (whole.replace(b"float x", b"float a"), "no x, y, z"),
        "marked.ply": (b"\xef\xbb\xbf" + whole, "is binary_little_endian and begins with a byte-order mark"),
        "cut.npy": (b"\x93NUMPY\x01\x00", "not a NumPy file"),
        "text.npy": (b"1 2 3\n", r"it begins with b'1 2 3.*', not as np.save writes it; lines of .*ends in .xyz$"),
        "empty.npz": (b"", "not a NumPy file: it is empty"),
        "what.txt": (b"1 2 3", "ending '.txt'.* read from a file whose name ends in .xyz: rename it"),
        "what.CSV": (b"1,2,3", "ending '.csv'.* read from a file whose name ends in .xyz: rename it"),
        "what.stl": (b"solid", "ending '.stl'.* as .ply or, with np.save, as .npy"),
    }
    for name, (data, words) in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=words) as error:
            read_cloud(tmp_path / name)
        assert name in str(error.value)
    np.save(tmp_path / "mm.npy", POINTS * 1000)
    with pytest.raises(InputError, match="millimetres"):
        read_cloud(tmp_path / "mm.npy")
    np.save(tmp_path / "nan.npy", np.full((4, 3), np.nan))
    with pytest.raises(InputError, match="4 of 4 points"):
        read_cloud(tmp_path / "nan.npy")


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    """A 3DPotatoTwin folder with one tuber in one frame."""
    images = tmp_path / "1_rgbd" / "1_image" / "R1-1"
    images.mkdir(parents=True)
    (tmp_path / "1_rgbd" / "0_camera_intrinsics").mkdir()
    depth = np.round(ellipsoid_depth_m((0.042, 0.033, 0.028)) * 1000).astype(np.uint16)
    rgba = np.zeros((720, 1280, 4), np.uint8)
    rgba[depth > 0, 3] = 255
    depth[depth == 0] = 345
    cv2.imwrite(str(images / "R1-1_depth_365.png"), depth)
    cv2.imwrite(str(images / "R1-1_rgb_365.png"), rgba)
    matrix = [D405.fx, 0, 0, 0, D405.fy, 0, D405.cx, D405.cy, 1]
    (tmp_path / "1_rgbd" / "0_camera_intrinsics" / "realsense_d405_camera_intrinsic.json").write_text(
        json.dumps({"width": 1280, "height": 720, "intrinsic_matrix": matrix, "depth_scale": 999.99993896484375})
    )
    table = "label,growing_season,cultivar,weight_g_inctack,x1_length_mm,volume_metashape\nR1-1,2023,Sayaka,174.2,84,\n"
    (tmp_path / "ground_truth.csv").write_text(table)
    (tmp_path / "splits.csv").write_text("label,split\nR1-1,test\n")
    return tmp_path


def test_a_twin_folder_is_a_data_set(twin: Path) -> None:
    (view,) = read_labelled(twin, split="test")
    assert (view.tuber, view.cultivar, view.season, view.weight_g) == ("R1-1", "Sayaka", "2023", 174.2)
    assert view.belt_distance_m == 0.345
    assert view.row_share == pytest.approx(365 / 720)
    # Undersides of that data set lie below the belt that it states; of another crop, whose table says where it is, not.
    assert view.prepare().height_m == pytest.approx(0.056 + POTATOTWIN.offset_m, abs=6e-4)
    table = (twin / "ground_truth.csv").read_text().replace("volume_metashape", "belt_distance_m")
    (twin / "ground_truth.csv").write_text(table)
    (own,) = read_labelled(twin, split="test")
    assert (own.belt_distance_m, own.resting_offset_m) == (0.345, 0.0)
    with pytest.raises(InputError, match="known: test"):
        next(read_labelled(twin, split="train"))


def test_a_pair_gives_the_same_weight_from_either_file(twin: Path) -> None:
    images = twin / "1_rgbd" / "1_image" / "R1-1"
    weigher = Weigher(None, Sidecar(name="none"))
    options = FileOptions(belt_distance_m=0.345)
    depth, rgb = images / "R1-1_depth_365.png", images / "R1-1_rgb_365.png"
    from_depth, from_rgb = (weigh_file(path, options, weigher) for path in (depth, rgb))
    assert from_depth.weighed == from_rgb.weighed
    assert from_depth.weighed is not None
    assert once_per_pair([depth, rgb]) == [depth]


@pytest.mark.parametrize("scale_m", [0.0, -0.001, float("nan"), 2.0])
def test_a_depth_unit_that_cannot_be_is_refused(scale_m: float) -> None:
    """0 was taken for "not given"."""
    with pytest.raises(InputError, match="allowed is above 0 to 1 metre per unit"):
        FileOptions(belt_distance_m=0.345, depth_scale_m=scale_m)


def test_a_cloud_below_its_belt_is_one_clear_error(tmp_path: Path) -> None:
    """`tuberline weigh` ended with a traceback; the file beside it was not weighed either."""
    cloud = ellipsoid_view().points_in_camera_m()
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(cloud)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "tuber.ply").write_bytes(header.encode() + cloud.astype("<f4").tobytes())
    flat = np.array([0.0, 0.0, 0.02], np.float32) + cloud * [1, 1, 0] + [0, 0, 0.345]
    (tmp_path / "low.ply").write_bytes(header.encode() + flat.astype("<f4").tobytes())
    command = [sys.executable, "-m", "tuberline", "weigh", "low.ply", "tuber.ply", "--belt-distance-m", "0.345"]
    done = subprocess.run([*command, "--json"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "low.ply: the cloud cannot be weighed: no point of it lies 1 mm or more above" in done.stderr
    assert "0.365 m from the camera and the belt 0.345 m: check --belt-distance-m" in done.stderr
    low, tuber = json.loads(done.stdout)
    assert "weight_g" not in low
    assert tuber["weight_g"] == pytest.approx(180, rel=0.2)


def test_a_pair_whose_mask_ends_at_the_images_border_is_flagged(twin: Path) -> None:
    """`weigh` told half a tuber's weight, and nothing else."""
    images = twin / "1_rgbd" / "1_image" / "R1-1"
    given = images / "R1-1_depth_365.png", FileOptions(belt_distance_m=0.345), Weigher(None, Sidecar(name="none"))
    inside = weigh_file(*given)
    for name in ("R1-1_depth_365.png", "R1-1_rgb_365.png"):
        image = cv2.imread(str(images / name), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(images / name), np.roll(image, 1280 - 643, axis=1))
    cut = weigh_file(*given)
    assert inside.weighed is not None
    assert cut.weighed is not None
    assert ("cut" in inside.weighed.flags, "cut" in cut.weighed.flags) == (False, True)


def test_broken_pairs_are_named(twin: Path) -> None:
    images = twin / "1_rgbd" / "1_image" / "R1-1"
    depth, rgb = images / "R1-1_depth_365.png", images / "R1-1_rgb_365.png"
    wrong_scale = FileOptions(belt_distance_m=0.345, depth_scale_m=0.0001)
    result = weigh_file(depth, wrong_scale, Weigher(None, Sidecar(name="none")))
    assert "--depth-scale-m" in result.error
    result = weigh_file(depth, replace(wrong_scale, depth_scale_m=1), Weigher(None, Sidecar(name="none")))
    assert re.search(r"the tuber lies \d{3} m away at a depth scale of 1 m a unit, and .*--depth-scale-m", result.error)
    depth.write_bytes(depth.read_bytes()[:2000])
    result = weigh_file(depth, FileOptions(belt_distance_m=0.345), Weigher(None, Sidecar(name="none")))
    assert result.weighed is None
    rgb.unlink()
    with pytest.raises(InputError, match=r"partner R1-1_rgb_365.png or R1-1_rgba_365.png is not beside it"):
        read_pair(depth, intrinsics=D405, depth_scale_m=0.001, max_depth_m=0.5)
    broken = twin / "camera.json"
    broken.write_text("{}")
    with pytest.raises(InputError, match=r"camera.json"):
        read_intrinsics(broken)


def test_the_real_cloud_and_its_image_agree(shared: Path) -> None:
    folder = shared / "data" / "potatotwin_sample"
    weigher = Weigher(None, Sidecar(name="none"))
    options = FileOptions(belt_distance_m=0.345, intrinsics=folder / "realsense_d405_intrinsic.json")
    paths = [folder / "R9-9_pcd_365.ply", folder / "derived" / "R9-9_pcd_365_depth_z16_mm.png"]
    cloud, image = (weigh_file(path, options, weigher) for path in paths)
    assert cloud.height_mm == pytest.approx(57.0, abs=0.01)
    assert image.height_mm == pytest.approx(57.0, abs=0.01)
    assert cloud.weighed is not None
    assert image.weighed is not None
    assert cloud.weighed.weight_g == pytest.approx(image.weighed.weight_g, rel=0.08)


def test_checkpoint_round_trip(tmp_path: Path) -> None:
    model = PointRaft()
    written = save_checkpoint(tmp_path / "w.safetensors", model.state_dict(), Sidecar(name="mine"))
    loaded, sidecar = load_checkpoint(tmp_path / "w.safetensors")
    assert sidecar == written
    assert sidecar.model_id == f"mine@{written.sha256[:8]}"
    assert all(torch.equal(value, loaded.state_dict()[name]) for name, value in model.state_dict().items())


@pytest.mark.parametrize("height_embedding", [True, False])
def test_names_and_shapes_without_torch_are_the_networks(height_embedding: bool) -> None:
    network = PointRaft(height_embedding=height_embedding)
    expected = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    found = parameter_shapes(height_embedding=height_embedding)
    assert list(found.items()) == list(expected.items())
    assert network.sa1_module.conv.local_nn.norm(0).eps == NORM_EPSILON


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16, torch.float16])
@pytest.mark.parametrize("ending", ["safetensors", "pth"])
def test_weights_of_any_precision_are_read_as_float32(tmp_path: Path, ending: str, dtype: torch.dtype) -> None:
    state = {name: value.to(dtype) if value.dtype.is_floating_point else value for name, value in SAVED.items()}
    path = tmp_path / f"w.{ending}"
    if ending == "pth":
        torch.save(state, path)
    else:
        save_checkpoint(path, state, Sidecar(name="mine"))
    read, _ = load_weights(path)
    assert {value.dtype.name for value in read.values()} == {"float32", "int64"}
    for name, value in state.items():
        assert np.array_equal(read[name], value.float().numpy()), name


def test_checkpoints_of_another_architecture_are_refused(tmp_path: Path) -> None:
    state = PointRaft().state_dict()
    state["regression_head.lins.2.weight"] = torch.zeros(2, 256)
    torch.save(state, tmp_path / "other.pth")
    with pytest.raises(InputError, match=r"other.pth.*regression_head.lins.2.weight' has shape \(2, 256\)"):
        load_checkpoint(tmp_path / "other.pth")
    torch.save({"conv1.weight": torch.zeros(3)}, tmp_path / "resnet.pth")
    with pytest.raises(InputError, match=r"'sa1_module.conv.local_nn.lins.0.weight' is missing.*more"):
        load_checkpoint(tmp_path / "resnet.pth")
    (tmp_path / "junk.safetensors").write_bytes(b"junk")
    with pytest.raises(InputError, match=r"junk.safetensors are no safetensors"):
        load_checkpoint(tmp_path / "junk.safetensors")
    with pytest.raises(InputError, match="cannot be read"):
        load_checkpoint(tmp_path / "absent.safetensors")


def test_a_sidecar_of_other_weights_is_refused(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "a.safetensors", PointRaft().state_dict(), Sidecar(name="a"))
    save_checkpoint(tmp_path / "b.safetensors", PointRaft().state_dict(), Sidecar(name="b"))
    (tmp_path / "a.json").write_bytes((tmp_path / "b.json").read_bytes())
    with pytest.raises(InputError, match="do not belong together"):
        load_checkpoint(tmp_path / "a.safetensors")


def test_import_of_an_upstream_checkpoint(tmp_path: Path) -> None:
    model = PointRaft().eval()
    torch.save(model.state_dict(), tmp_path / "pointraft_potato.pth")
    import_checkpoint(tmp_path / "pointraft_potato.pth", out=tmp_path / "in.safetensors", seed=5)
    loaded, sidecar = load_checkpoint(tmp_path / "in.safetensors")
    assert (sidecar.start.kind, sidecar.start.seed, sidecar.name) == ("random", 5, "pointraft_potato")
    assert all(torch.equal(value, loaded.state_dict()[name]) for name, value in model.state_dict().items())
    with pytest.raises(InputError, match=r"in\.safetensors are weights of Tuberline already: give them as they are"):
        import_checkpoint(tmp_path / "in.safetensors", out=tmp_path / "again.safetensors")
