"""One TOML file describes one line. Every setting has a default, a unit in its name and a bound.

A config is refused, never corrected: unknown keys with the nearest known one, values with what is allowed.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, Literal, Self, get_args
from urllib.parse import urlsplit

import tomli_w
from pydantic import Field, ValidationError, field_validator, model_validator

from conveyor.config_access import AccessConfig
from conveyor.config_alarms import AlarmsConfig
from conveyor.config_base import BeltSd, Endpoint, RestingOffset, RestingSd, Section, checked_name
from conveyor.config_camera import CameraConfig, one_device_each
from conveyor.config_encoder import EncoderConfig
from conveyor.config_gauge import GaugeSection
from conveyor.config_realsense import RealSenseConfig
from conveyor.config_yield import ForeignConfig, GnssConfig
from conveyor.errors import ConfigError
from conveyor.gauge import Gauge
from conveyor.refused import OURS, in_words
from conveyor.resting import RestingLevel
from conveyor.text_files import read_toml


class LinkConfig(Section):
    """How this line's processes reach each other."""

    router: Endpoint = Field("tcp/127.0.0.1:7447", description="endpoint of the router, e.g. tcp/10.0.0.1:7447")
    listen: tuple[Endpoint, ...] = Field((), description="what the router listens on; default: the endpoint above")
    lease_ms: int = Field(2000, ge=200, le=60000, description="a frozen host is noticed after this")
    connect_timeout_s: float = Field(
        20.0, ge=0.1, le=3600, description="a command that looks at a line gives up by then; its nodes wait forever"
    )
    root_ca: Path | None = Field(None, description="TLS: certificate authority of this site (PEM)")
    certificate: Path | None = Field(None, description="TLS: this node's certificate (PEM)")
    private_key: Path | None = Field(None, description="TLS: this node's key (PEM)")
    certs: Path | None = Field(
        None, description="TLS: folder from `tuberline certs`, where every process finds its own three files"
    )


class BeltConfig(GaugeSection):
    """What tubers lie on, and how far under the belt plane that the cameras see they lie there."""

    surface: Literal["flat", "rods", "cleats"] = Field(
        "flat", description="rods: a web, between whose rods each tuber sinks by what its outline says"
    )
    rod_pitch_mm: float = Field(40.0, ge=20, le=120, description="rods: centre to centre")
    rod_diameter_mm: float = Field(11.0, ge=4, le=40, description="rods: of one, with its coat")
    resting_offset_mm: RestingOffset = Field(
        0.0, description="undersides lie this far below the plane the cameras see (rods: the rods' tops)"
    )
    resting_sd_mm: RestingSd | None = Field(
        None, description="how well that offset is known (standard deviation); not given: not known"
    )

    @property
    def known_gauge(self) -> Gauge | None:
        """In metres; None where there is none."""
        return self.described_gauge(pitch_mm=self.rod_pitch_mm, rod_mm=self.rod_diameter_mm)

    @model_validator(mode="after")
    def _rods_apart(self) -> Self:
        if self.gauge == "rods" and self.surface != "rods":
            raise ValueError('gauge is "rods" and surface is not: set surface = "rods", rod_pitch_mm, rod_diameter_mm')
        if self.rod_diameter_mm >= self.rod_pitch_mm:
            raise ValueError(
                f"rod_diameter_mm is {self.rod_diameter_mm} and rod_pitch_mm {self.rod_pitch_mm}: rods of a web lie "
                "farther apart than they are thick"
            )
        rods = [key for key in ("rod_pitch_mm", "rod_diameter_mm") if key in self.model_fields_set]
        if rods and "surface" not in self.model_fields_set:
            raise ValueError(f'{" and ".join(rods)} given without surface: set surface = "rods", or "flat"')
        return self

    @property
    def resting_level(self) -> RestingLevel:
        """In metres."""
        return RestingLevel(
            surface=self.surface,
            offset_m=self.resting_offset_mm / 1000,
            sd_m=(self.resting_sd_mm or 0.0) / 1000,
            rod_pitch_m=self.rod_pitch_mm / 1000,
            rod_diameter_m=self.rod_diameter_mm / 1000,
        )


class SegmenterConfig(Section):
    """From a depth frame to tubers on the belt and views worth weighing."""

    method: Literal["classical", "classes"] = Field(
        "classes", description="classes: a network tells clods and stones from tubers; classical: all are counted"
    )
    weights: Path | None = Field(None, description="an .onnx of train-classifier; default: the shipped network")
    reject_below: float = Field(
        0.3, ge=-6, le=6, description="log-odds of tuber against clod, on this belt, under which a track is no tuber"
    )
    belt_sd_mm: BeltSd = Field(
        2.0,
        description="how well the belt's height is known (standard deviation): widens intervals, moves weights",
    )
    belt_follow_mm: float = Field(
        6.0, ge=0, le=15, description="a given belt moves to where it is seen, by this much at most; 0: never"
    )
    pixel_mm: float = Field(1.45, gt=0.2, le=5, description="resolution at which the height map is analysed")
    min_height_mm: float = Field(18.0, ge=5, le=100, description="peaks lower than this are no tubers")
    min_area_mm2: float = Field(350.0, ge=50, le=5000, description="smaller blobs are no tubers")
    gate_mm: float = Field(22.0, ge=5, le=100, description="how far a tuber may be from where it is expected")
    min_frames: int = Field(3, ge=1, le=30, description="a track seen in fewer frames is not counted")
    views_per_tuber: int = Field(3, ge=1, le=16, description="views weighed per tuber")
    max_age_ms: float = Field(500.0, ge=50, le=60000, description="live: frames older than this are dropped, counted")
    ring: int = Field(6, ge=1, le=64, description="live: newest frames kept while busy, until max_age_ms")
    credits: int = Field(2, ge=1, le=16, description="views in flight per regressor, more for a quick one, 16 at most")
    job_deadline_s: float = Field(
        5.0, ge=0.2, le=120, description="a view not answered by then goes to another one; live: sooner"
    )
    max_attempts: int = Field(5, ge=1, le=50, description="then the view is lost, with its reason")
    max_pending_views: int = Field(256, ge=8, le=4096, description="views waiting for a regressor")
    spare_wait_s: float = Field(
        1.0, ge=0.1, le=600, description="live: second and later views that would wait longer are shed"
    )
    spare_grace_s: float = Field(
        0.06, ge=0, le=60, description="live: a weighed tuber waits this long for its other views, then is logged"
    )
    free_share: float = Field(
        0.3,
        ge=0,
        le=0.9,
        description="live: of this machine's processors, kept free of second and later views; 0: none",
    )
    weigh_deadline_s: float = Field(
        60.0,
        ge=1,
        le=3600,
        description="then a tuber is logged by its volume; live: at once if it had to wait for half",
    )
    state_dir: Path | None = Field(
        None,
        description="where the log not yet committed, and what is known of a live camera, is kept across restarts; "
        "default: state/ in aggregator.out",
    )
    look_first: bool = Field(
        False,
        description="a recording that waits is looked at before it is counted: its first tuber is weighed as its last, "
        "by a camera that is known; so `tuberline replay` does",
    )

    @field_validator("method", mode="before")
    @classmethod
    def _method_that_is_there(cls, method: object) -> object:
        if method == "learned":
            raise ValueError(
                "'learned' was removed, a network no longer finds the tubers; use \"classes\", which tells clods "
                'from tubers, or "classical", which counts all'
            )
        return method


class RegressorConfig(Section):
    """PointRAFT workers on this machine."""

    processes: int = Field(2, ge=0, le=64, description="workers started by `tuberline run`")
    weights: Path | None = Field(None, description="safetensors or upstream .pth; default: the shipped ones")
    threads: int = Field(1, ge=1, le=64, description="threads inside one worker; one worker per core beats threads")
    nice: int = Field(
        5, ge=0, le=19, description="how far weighing stands back for looking on one machine: a frame cannot wait"
    )
    device: Literal["cpu", "cuda"] = Field(
        "cpu", description="what the network runs on; cuda weighs many views at once"
    )
    precision: Literal["auto", "fastest", "float32", "bfloat16"] = Field(
        "auto",
        description="float32: exact; auto: so in a replay, on a live line the fastest form within 0.1 g of that, "
        "flagged; fastest: the same in a replay, too",
    )
    centroids: Literal[16, 32, 64] | None = Field(
        None, description="of the 128 second-stage ones: the network takes four fifths of its time with 16, flagged"
    )
    state_dir: Path | None = Field(None, description="where weights given to a running line are kept across restarts")

    @model_validator(mode="after")
    def _exact_on_a_gpu(self) -> Self:
        if self.device == "cuda" and (self.precision == "bfloat16" or self.centroids is not None):
            told = f'precision is "{self.precision}"' if self.centroids is None else f"centroids is {self.centroids}"
            raise ValueError(f'device is "cuda" and {told}: a GPU weighs in float32 with all centroids; leave it out')
        return self


class AggregatorConfig(Section):
    """From tracks to a ledger and totals."""

    out: Path = Field(Path("runs/latest"), description="folder of ledger.db, summary.json and tubers.csv")
    merge_gate_mm: float = Field(30.0, ge=2, le=200, description="tracks of two cameras closer than this are one tuber")
    camera_stall_s: float = Field(10.0, ge=0.5, le=3600, description="a silent camera holds the ledger no longer")
    commit_interval_s: float = Field(
        0.15, ge=0.01, le=10, description="entries are committed this often, or once every camera has marked"
    )
    histogram_step_g: float = Field(50.0, gt=0, le=1000, description="width of a class in the histogram of weights")
    exit_when_final: bool = Field(False, description="write the summary and stop when all cameras ended")
    tickets: Path | None = Field(None, description="a scale's tickets that calibrate totals, see `tuberline calibrate`")
    contract: Path | None = Field(None, description="classes of size that a buyer wants, see docs/sizes.md")
    cultivar: str = Field("", description="named as with the tickets: its own factor is learned beside the line's")


class ViewerConfig(Section):
    """What goes to Rerun and Foxglove. Never in the hot path."""

    rrd: Path | None = Field(None, description="file to write")
    connect: str | None = Field(None, description="live hub, e.g. rerun+http://127.0.0.1:9876/proxy")
    foxglove: str | None = Field(
        None, description="HOST:PORT at which Foxglove's app finds the line live, e.g. 127.0.0.1:8765"
    )
    profile: Literal["light", "remote", "full"] = Field(
        "remote", description="how much is shown: numbers; few and small pictures; every frame and view"
    )


LINE_NAME, REPLAY_NAME = "line", "replay"
"""What a line, and a replay, is called where no one named it. Two of such a name may be of different cameras."""


class LineConfig(Section):
    """One line: its name, its link, its cameras and its nodes."""

    name: str = Field(LINE_NAME, description="the line's name: its topics lie under `tuberline/NAME/`")
    link: LinkConfig = LinkConfig()
    access: AccessConfig = AccessConfig()
    cameras: dict[str, CameraConfig] = Field(default_factory=dict)
    belt: BeltConfig = BeltConfig()
    segmenter: SegmenterConfig = SegmenterConfig()
    regressor: RegressorConfig = RegressorConfig()
    aggregator: AggregatorConfig = AggregatorConfig()
    foreign: ForeignConfig = ForeignConfig()
    viewer: ViewerConfig | None = None
    alarms: AlarmsConfig | None = None
    gnss: GnssConfig | None = None
    encoder: EncoderConfig | None = None

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return checked_name(name, "line")

    @field_validator("cameras")
    @classmethod
    def _cameras_apart(cls, cameras: dict[str, CameraConfig]) -> dict[str, CameraConfig]:
        one_device_each(cameras)
        return {checked_name(name, "camera"): camera for name, camera in cameras.items()}

    @model_validator(mode="after")
    def _one_reader_a_port(self) -> Self:
        if self.encoder is not None and self.gnss is not None:
            ports = [urlsplit(section.source) for section in (self.encoder, self.gnss)]
            if {port.scheme for port in ports} == {"serial"} and ports[0].path == ports[1].path:
                raise ValueError(f"encoder.source and gnss.source are both {ports[0].path}: each needs its own port")
        return self

    @model_validator(mode="after")
    def _travel_is_told(self) -> Self:
        devices = [name for name, camera in self.cameras.items() if camera.source != "recording"]
        if self.belt.gauge == "travel" and self.encoder is None and devices:
            raise ValueError(
                f'belt.gauge is "travel", and nothing tells the travel of camera {devices[0]}: add [encoder], whose '
                'metres_per_pulse must be right within 0.5 %, or set gauge = "none"'
            )
        return self

    @property
    def live(self) -> bool:
        """Some camera waits for no one."""
        return any(not camera.held_back for camera in self.cameras.values())

    @property
    def hears_encoder(self) -> tuple[str, ...]:
        """Cameras to which the line's encoder tells the belt's travel, by name; recordings bring their own."""
        taken = (name for name, camera in sorted(self.cameras.items()) if camera.of_today)
        return () if self.encoder is None else tuple(taken)

    def camera(self, name: str) -> CameraConfig:
        """The named camera, or an error that lists the known ones."""
        if name not in self.cameras:
            raise ConfigError(
                f"camera '{name}' is not in the config; known: {', '.join(sorted(self.cameras)) or 'none'}"
            )
        return self.cameras[name]


def load_config(path: Path) -> LineConfig:
    """The line described by the TOML file at `path`; relative paths inside are relative to that file.

    A segmenter's log is always kept on disk: one that starts again without it loses what it had not sent.

    Raises:
        ConfigError: unreadable, not TOML, or refused; the text names every faulty key.
    """
    if path.is_dir():
        raise ConfigError(
            f"config {path} cannot be read: it is a folder. `tuberline replay` counts a recording, `tuberline init` "
            "writes a line's file for it"
        )
    raw = read_toml(path, what="config", error=ConfigError)
    config = parse_config(raw, where=str(path), base=path.resolve().parent)
    kept = config.segmenter.state_dir or config.aggregator.out / "state"
    return config.model_copy(update={"segmenter": config.segmenter.model_copy(update={"state_dir": kept})})


def parse_config(raw: dict[str, Any], *, where: str, base: Path | None = None) -> LineConfig:
    """Check a config given as a plain mapping; `base` is the folder that relative paths start from."""
    try:
        config = LineConfig.model_validate(raw)
    except ValidationError as error:
        faults = [_fault(fault) for fault in error.errors()]
        raise ConfigError(f"config {where} is refused:\n" + "\n".join(f"  {fault}" for fault in faults)) from error
    return _with_base(config, base) if base else config


def _fault(fault: Any) -> str:
    where = ".".join(str(part) for part in fault["loc"])
    if fault["type"] != "extra_forbidden":
        told, given = in_words(fault), fault.get("input")
        said = fault["type"] in (OURS, "missing") and (isinstance(given, dict) or str(given) in told)
        shown = str(given).lower() if isinstance(given, bool) else repr(given)  # as TOML writes it
        return f"{where}: {told}" if said else f"{where}: {told} (got {shown})"
    if new_name := _new_name(fault["loc"]):
        return f"{where}: now '{new_name}'; write that instead"
    key, known = str(fault["loc"][-1]), _known_keys(fault["loc"][:-1])
    if homes := _homes(key):
        return f"{where}: unknown key here; it belongs to {' or '.join(homes)}"
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(known)}"
    return f"{where}: unknown key; {hint}"


FORMER_KEYS: dict[str, str] = {}
"""Keys that were renamed, with what they are called now; `*` stands for any name: 'cameras.*.a': 'cameras.*.b'."""


def _new_name(path: tuple[Any, ...]) -> str | None:
    """What the key at `path` is called now, if it once had this name."""
    for former, now in FORMER_KEYS.items():
        parts = former.split(".")
        if len(parts) == len(path) and all(part in ("*", str(given)) for part, given in zip(parts, path, strict=True)):
            names = iter(str(given) for part, given in zip(parts, path, strict=True) if part == "*")
            return ".".join(next(names) if part == "*" else part for part in now.split("."))
    return None


def _known_keys(path: tuple[Any, ...]) -> list[str]:
    """Field names of the section at `path`, e.g. ('cameras', 'front') -> those of CameraConfig."""
    section = (RealSenseConfig if path[2:] == ("realsense",) else _SECTIONS.get(path[0])) if path else LineConfig
    return sorted(section.model_fields) if section else []


_SECTIONS: dict[str, type[Section]] = {
    name: section
    for name, field in LineConfig.model_fields.items()
    for section in (field.annotation, *get_args(field.annotation))
    if isinstance(section, type) and issubclass(section, Section)
}
"""The class of each section, or of each of its entries: cameras."""


def _homes(key: str) -> list[str]:
    """Where a key of just this name may stand, as who writes the file sees it."""
    heads = {f"[{name}.NAME]" if name == "cameras" else f"[{name}]": section for name, section in _SECTIONS.items()}
    homes = [head for head, section in heads.items() if key in section.model_fields]
    homes += ["[cameras.NAME.realsense]"] * (key in RealSenseConfig.model_fields)
    return (["the top of the file"] if key in ("name", *_SECTIONS) else []) + homes


FILE = "file:"
"""Begins a source that is a recorded file."""


def _with_base(section: Any, base: Path) -> Any:
    """The same section with its relative paths resolved against `base`."""
    changes: dict[str, Any] = {}
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, Path) and not value.is_absolute():
            changes[name] = base / value
        elif isinstance(value, str) and value.startswith(FILE):
            changes[name] = f"{FILE}{base / value.removeprefix(FILE)}"
        elif isinstance(value, Section):
            changes[name] = _with_base(value, base)
        elif isinstance(value, dict):
            changes[name] = {k: _with_base(v, base) if isinstance(v, Section) else v for k, v in value.items()}
    return section.model_copy(update=changes)


def dump_toml(config: LineConfig) -> str:
    """The effective config as TOML, to stand beside the results; `load_config` reads it back to an equal one."""
    return tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
