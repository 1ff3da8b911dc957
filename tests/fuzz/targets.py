"""What coverage-guided fuzzing reads: one target a decoder, with seeds made by the tests' own builders.

The first byte of an input chooses among the kinds of things a target reads; the rest is what is read. Imports are made
by the targets themselves, so that a fuzzer can instrument them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

Read = Callable[[bytes], object]
Target = Callable[[Path], tuple[list[bytes], Read]]
"""Given an empty folder for its files: seeds, and what reads one input. Only errors of ours may come out of that."""


def messages(folder: Path) -> tuple[list[bytes], Read]:
    """Every message on the wire."""
    from tests.fuzz.test_fuzz_messages import EXAMPLES

    kinds = list(dict.fromkeys(type(example) for example in EXAMPLES))
    seeds = [bytes([kinds.index(type(example))]) + example.encode() for example in EXAMPLES]
    return seeds, lambda data: kinds[data[0] % len(kinds)].decode(data[1:])


def folder(folder: Path) -> tuple[list[bytes], Read]:
    """A folder recording: tables, descriptions and pictures, one of them damaged at a time."""
    from conveyor.formats.folder.writer import FolderWriter
    from tests.fuzz.test_fuzz_files import DESCRIPTION, frame, read_all

    with FolderWriter(folder / "recording", DESCRIPTION) as writer:
        for seq in range(2):
            writer.write(frame(seq))
    good = {path: path.read_bytes() for path in sorted((folder / "recording").rglob("*")) if path.is_file()}
    paths = list(good)

    def read(data: bytes) -> None:
        path = paths[data[0] % len(paths)]
        path.write_bytes(data[1:])
        try:
            read_all(folder / "recording")
        finally:
            path.write_bytes(good[path])

    return [bytes([n]) + good[path] for n, path in enumerate(paths)], read


def mcap(folder: Path) -> tuple[list[bytes], Read]:
    """Our own recordings in MCAP, and bags of ROS 2 and Foxglove messages in it."""
    from conveyor.formats.mcap.writer import McapFrameWriter
    from tests.formats import bag_messages as bags
    from tests.fuzz.test_fuzz_files import frame, read_all

    path = folder / "recording.mcap"
    with McapFrameWriter(path) as writer:
        writer.write(frame(0))
    own = path.read_bytes()
    depth, info = "/front/depth/image_rect_raw", "/front/depth/camera_info"
    image, calibration = "foxglove.RawImage", "foxglove.CameraCalibration"
    as_json, as_protobuf = bags.foxglove_json(0), bags.foxglove_protobuf(0)
    foreign = (
        {depth: (bags.IMAGE, "cdr", [bags.image(0)]), info: (bags.INFO, "cdr", [bags.info()])},
        {depth: (image, "json", [as_json[0]]), info: (calibration, "json", [as_json[1]])},
        {depth: (image, "protobuf", [as_protobuf[0]]), info: (calibration, "protobuf", [as_protobuf[1]])},
    )
    seeds = [own, *(bags.write_mcap(path, channels).read_bytes() for channels in foreign)]
    return _in_file(seeds, path, lambda: read_all(path))


def rosbag(folder: Path) -> tuple[list[bytes], Read]:
    """A ROS 1 bag."""
    from tests.formats import test_formats_rosbag as bags
    from tests.fuzz.test_fuzz_files import read_all

    path = folder / "recording.bag"
    seeds = [bags._ros1(folder / f"{n}.bag", unit_m=unit_m).read_bytes() for n, unit_m in enumerate((None, 0.0001))]
    return _in_file(seeds, path, lambda: read_all(path))


def cdr(folder: Path) -> tuple[list[bytes], Read]:
    """Single messages of ROS and Foxglove, as they come from a bag or from a live ROS graph."""
    from camera_sim.live.rmw_zenoh import read_attachment
    from conveyor.formats.rosbag.bags import decode_ros
    from conveyor.formats.rosbag.depth import depth_pixels
    from conveyor.formats.rosbag.foxglove import from_json, from_protobuf
    from conveyor.formats.rosbag.messages import RosCompressed, RosImage
    from tests.formats import bag_messages as bags

    def pixels(message: object) -> object:
        return depth_pixels(message) if isinstance(message, RosImage | RosCompressed) else message

    kinds: list[tuple[Read, bytes]] = [
        (lambda data: pixels(decode_ros(bags.IMAGE, data)), bags.image(0)),
        (lambda data: pixels(decode_ros(bags.IMAGE, data, ros1=True)), bags.image(0, ros1=True)),
        (lambda data: decode_ros(bags.INFO, data), bags.info()),
        (lambda data: pixels(decode_ros(bags.COMPRESSED, data)), bags.compressed_depth(0)),
        (lambda data: pixels(from_json("image", data)), bags.foxglove_json(0)[0]),
        (lambda data: from_json("calibration", data), bags.foxglove_json(0)[1]),
        (lambda data: pixels(from_protobuf("image", data)), bags.foxglove_protobuf(0)[0]),
        (lambda data: from_protobuf("calibration", data), bags.foxglove_protobuf(0)[1]),
        (read_attachment, bytes(range(33))),
    ]
    seeds = [bytes([n]) + seed for n, (_, seed) in enumerate(kinds)]
    return seeds, lambda data: kinds[data[0] % len(kinds)][0](data[1:])


def cloud(folder: Path) -> tuple[list[bytes], Read]:
    """Clouds in PLY, binary and ASCII, and in NumPy's .npy and .npz."""
    from conveyor.formats.clouds import read_cloud
    from tests.fuzz.test_fuzz_files import cloud_files

    good = cloud_files()
    paths = [folder / name for name in good]

    def read(data: bytes) -> object:
        path = paths[data[0] % len(paths)]
        path.write_bytes(data[1:])
        return read_cloud(path)

    return [bytes([n]) + data for n, data in enumerate(good.values())], read


def config(folder: Path) -> tuple[list[bytes], Read]:
    """The line's TOML file."""
    from conveyor.config import dump_toml, load_config, parse_config

    path = folder / "line.toml"
    raw = {"cameras": {"front": {"path": "belt", "belt_distance_m": 0.46}}, "viewer": {"profile": "light"}}
    seeds = [dump_toml(parse_config(raw, where="here")).encode(), b'[cameras.a]\npath = "x"\n']
    return _in_file(seeds, path, lambda: load_config(path))


def checkpoint(folder: Path) -> tuple[list[bytes], Read]:
    """PointRAFT weights: .safetensors, its sidecar, and the authors' .pth."""
    import io
    import json

    import torch
    from safetensors.torch import save

    from regressor.network.checkpoint import load_checkpoint
    from regressor.network.stored import SHIPPED

    tensors = {"fc.weight": torch.arange(6.0).reshape(2, 3), "fc.bias": torch.zeros(2)}
    pth = io.BytesIO()
    torch.save(tensors, pth)
    sidecar = SHIPPED.with_suffix(".json").read_bytes()
    paths = [folder / name for name in ("w.safetensors", "s.json", "w.pth")]
    small = save(tensors)
    (folder / "s.safetensors").write_bytes(small)

    def read(data: bytes) -> object:
        path = paths[data[0] % len(paths)]
        path.write_bytes(data[1:])
        return load_checkpoint(path.with_suffix(".safetensors") if path.suffix == ".json" else path)

    assert isinstance(json.loads(sidecar), dict)
    return [b"\x00" + small, b"\x01" + sidecar, b"\x02" + pth.getvalue()], read


def truth(folder: Path) -> tuple[list[bytes], Read]:
    """A recording's truth.json."""
    from aggregator.scoring.truth import read_truth

    path = folder / "truth.json"
    seed = b'{"tubers": [{"id": 1, "place_x_m": -0.1, "place_y_m": 2e-2, "weight_g": 170.5, "length_mm": 80}]}'
    digits, deep = seed.replace(b"170.5", b"9" * 5000), seed.replace(b"170.5", b"[" * 10_000)
    return _in_file([seed, seed.replace(b"170.5", b"9" * 400), digits, deep], path, lambda: read_truth(path))


def tracklog(folder: Path) -> tuple[list[bytes], Read]:
    """The segmenter's log on disk."""
    from segmenter.tracklog import TrackLog
    from tests.fuzz.test_fuzz_messages import MARK, TRACK

    path = folder / "front.log"
    with TrackLog(path, camera="c", run="r") as log:
        log.append([TRACK, MARK, TRACK])
        log.commit(1)

    def reopen() -> None:
        with TrackLog(path, camera="c", run="r") as log:
            assert [entry.n for entry in log.due(0.0)] == list(range(log.committed + 1, log.newest + 1))

    return _in_file([path.read_bytes()], path, reopen)


TARGETS: dict[str, Target] = {
    target.__name__: target
    for target in (messages, folder, mcap, rosbag, cdr, cloud, config, checkpoint, truth, tracklog)
}


def _in_file(seeds: list[bytes], path: Path, read: Callable[[], object]) -> tuple[list[bytes], Read]:
    def write_and_read(data: bytes) -> object:
        path.write_bytes(data)
        return read()

    return seeds, write_and_read
