"""Weights on disk: a safetensors file with a JSON sidecar that says what they take, give and were made from.

The tensors carry the names of the authors' checkpoint, so an upstream `.pth` is read by the same code; it has no
sidecar, and gets one that says so.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from pathlib import Path
from typing import Any, Literal, Self

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from safetensors.torch import load as load_safetensors
from safetensors.torch import save as save_safetensors
from torch import Tensor

from conveyor.errors import InputError
from conveyor.text_files import read_text
from regressor.network.grouping import CLOUD_POINTS, stage_counts
from regressor.network.pointraft import NEIGHBOURS, RADIUS_1_M, RADIUS_2_M, PointRaft
from regressor.network.unwrap import objects_within, state_dict_within
from regressor.weigh.blend import BlendRule
from regressor.weigh.interval import IntervalRule
from regressor.weigh.volume import VolumeRule

FORMAT: Literal["tuberline-pointraft/1"] = "tuberline-pointraft/1"
SHIPPED = Path(__file__).parents[1] / "weights" / "tuberline-sim.safetensors"
MAX_CHECKPOINT_BYTES = 64 << 20


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InputSpec(_Part):
    """What the network takes. Fixed by the architecture; written down so that no one has to guess.

    Numbers that are not those of this program's networks are refused: tensors do not show them.
    """

    points: int = Field(CLOUD_POINTS, ge=64, le=8192)
    frame: str = "level: z away from the camera along the belt's normal, metres, centred on the mean of all points"
    order: str = "farthest-point sampling in selection order, lowest index on ties"
    height: str = "clamp(belt distance - min z, 0, max_height_m) metres, before centring"
    max_height_m: float = Field(0.08, gt=0)
    radii_m: tuple[float, float] = (RADIUS_1_M, RADIUS_2_M)
    neighbours: int = NEIGHBOURS
    neighbour_rule: str = "first 64 in index order with squared distance < radius squared"
    centroids: tuple[int, int] = stage_counts(CLOUD_POINTS)
    height_embedding: bool = True

    @model_validator(mode="after")
    def _as_built(self) -> Self:
        built = {
            "radii_m": (RADIUS_1_M, RADIUS_2_M),
            "neighbours": NEIGHBOURS,
            "centroids": stage_counts(self.points),
        }
        for name, value in built.items():
            if getattr(self, name) != value:
                raise ValueError(
                    f"{name} is {getattr(self, name)}, and this program's networks have {value}: weights of another "
                    "network would weigh wrong"
                )
        return self


class StartPolicy(_Part):
    """First pick of each sampling: 'prefix' always the cloud's first point; 'random' as drawn from `seed`."""

    kind: Literal["prefix", "random"] = "prefix"
    seed: int = 0


class Range(_Part):
    """What the training saw, inclusive."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether `value` lies inside."""
        return self.low <= value <= self.high


class Sidecar(_Part):
    """All that is known about a checkpoint beside its tensors."""

    format: Literal["tuberline-pointraft/1"] = FORMAT
    name: str = Field(pattern=r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
    sha256: str = ""
    target: Literal["weight_g", "volume_ml", "length_mm"] = "weight_g"
    network: Literal["pointraft", "pointnet"] = "pointraft"
    input: InputSpec = InputSpec()
    start: StartPolicy = StartPolicy()
    belt_distance_m: Range = Range(low=0.25, high=0.6)
    weight_g: Range = Range(low=10.0, high=700.0)
    length_mm: Range = Range(low=25.0, high=180.0)
    volume_share: float = Field(0.0, ge=0, lt=1)
    disagreement_factor: float = Field(1.6, gt=1)
    shared_sd_share: float = Field(0.9, ge=0, le=1)
    shared_bias_share: float = Field(0.05, ge=0, le=1)
    interval: dict[str, Any] | None = None
    volume_rule: dict[str, Any] | None = None
    blend: dict[str, Any] | None = None
    shared_level_share_per_mm: float = Field(0.0, ge=0, le=0.2)
    shared_other_share: float = Field(0.0, ge=0, le=0.5)
    worlds: tuple[str, ...] = ()
    training: dict[str, Any] = Field(default_factory=dict)
    metrics: dict[str, Any] = Field(default_factory=dict)

    @property
    def interval_rule(self) -> IntervalRule | None:
        """The calibrated interval, if there is one."""
        return IntervalRule.from_json(self.interval) if self.interval else None

    @property
    def fitted_volume_rule(self) -> VolumeRule | None:
        """The volume rule fitted with these weights, if there is one."""
        return VolumeRule.from_json(self.volume_rule) if self.volume_rule else None

    @property
    def blend_rule(self) -> BlendRule:
        """How network and volume rule become one weight; by the share alone where nothing more was fitted."""
        return BlendRule.from_json(self.blend) if self.blend else BlendRule(self.volume_share)

    @property
    def model_id(self) -> str:
        """Name and the first eight digits of a hash, as it stands in the ledger: of all that makes a weight.

        The tensors' own hash; with a blend of its own, together with rule, blend and intervals.
        """
        if self.blend is None:
            return f"{self.name}@{self.sha256[:8]}"
        rules = json.dumps([self.sha256, self.volume_rule, self.blend, self.interval], sort_keys=True)
        return f"{self.name}@{hashlib.sha256(rules.encode()).hexdigest()[:8]}"


def save_checkpoint(path: Path, state: dict[str, Tensor], sidecar: Sidecar) -> Sidecar:
    """Write `path` (.safetensors) and its sidecar (.json), each atomically; the sidecar with its hash filled in."""
    data = save_safetensors({name: value.cpu().contiguous() for name, value in state.items()}, {"format": FORMAT})
    filled = sidecar.model_copy(update={"sha256": hashlib.sha256(data).hexdigest()})
    text = json.dumps(filled.model_dump(mode="json"), indent=1, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    _replace(path, data)
    _replace(path.with_suffix(".json"), text.encode())
    return Sidecar.model_validate_json(text)


def _replace(path: Path, data: bytes) -> None:
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def load_checkpoint(path: Path | None = None, *, any_target: bool = False) -> tuple[PointRaft, Sidecar]:
    """(model in eval mode, its sidecar) of a .safetensors or an upstream .pth file; the shipped ones by default.

    Raises:
        InputError: missing, unreadable, hash other than the sidecar's, of another architecture, or of another target
            than a weight (unless `any_target`).
    """
    path = path or SHIPPED
    state, sidecar = read_checkpoint(path)
    if sidecar.network != "pointraft":
        raise InputError(f"weights {path} are of a '{sidecar.network}', a baseline that only `ablate` knows")
    if sidecar.target != "weight_g" and not any_target:
        raise InputError(
            f"weights {path} give {sidecar.target}: a line weighs; only `evaluate` and `train` know others"
        )
    model = PointRaft(height_embedding=any(name.startswith("height_embed.") for name in state))
    check_architecture(state, model.state_dict(), where=str(path))
    model.load_state_dict(state)
    return model.eval(), sidecar


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], Sidecar]:
    """(tensors by name, sidecar) of a checkpoint of any network.

    Raises:
        InputError: missing, unreadable, hash other than the sidecar's.
    """
    data = _bytes(path)
    return _tensors(path, data), _sidecar(path, hashlib.sha256(data).hexdigest())


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_CHECKPOINT_BYTES:
            raise InputError(f"weights {path} have {path.stat().st_size} bytes; allowed are {MAX_CHECKPOINT_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"weights {path} cannot be read: {error.strerror or error}; leave the option out to use the shipped ones"
        ) from error


def _tensors(path: Path, data: bytes) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            state: Any = load_safetensors(data)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise InputError(f"weights {path} {objects_within(str(error))}") from error
    except Exception as error:  # both libraries raise a wide, undocumented set for broken files
        said = next(iter(str(error).splitlines()), "")
        why = f": {said}" if " " in said else ""  # of a file of another kind pickle says no more than a number
        raise InputError(f"weights {path} are no safetensors file or PyTorch state dict{why}") from error
    return state_dict_within(state, where=path)


def _sidecar(path: Path, digest: str) -> Sidecar:
    file = path.with_suffix(".json")
    if not file.is_file():
        # An upstream checkpoint: its network was trained and tested with random first points.
        name = "".join(letter if letter.isalnum() or letter in "._-" else "-" for letter in path.stem) or "weights"
        return Sidecar(name=name[:64], sha256=digest, start=StartPolicy(kind="random"))
    try:
        sidecar = Sidecar.model_validate_json(read_text(file, what="sidecar"))
    except ValidationError as error:
        raise InputError(f"sidecar {file} is refused: {error}") from error
    if sidecar.sha256 != digest:
        raise InputError(
            f"sidecar {file} is for weights with sha256 {sidecar.sha256[:16]}..., {path.name} has {digest[:16]}...: "
            "the two files do not belong together"
        )
    return sidecar


def check_architecture(
    state: dict[str, Tensor], expected: dict[str, Tensor], *, where: str, network: str = "PointRAFT"
) -> None:
    """Compare names and shapes.

    Raises:
        InputError: naming the first entries that differ.
    """
    faults = [f"'{name}' is missing" for name in expected if name not in state]
    faults += [f"'{name}' is unknown" for name in state if name not in expected]
    faults += [
        f"'{name}' has shape {tuple(value.shape)}, {network} has {tuple(expected[name].shape)}"
        for name, value in state.items()
        if name in expected and value.shape != expected[name].shape
    ]
    faults += [
        f"'{name}' is not finite"
        for name, value in state.items()
        if value.is_floating_point() and not bool(torch.isfinite(value).all())
    ]
    if faults:
        more = f" (and {len(faults) - 3} more)" if len(faults) > 3 else ""
        raise InputError(f"weights {where} are not of {network}'s architecture: {'; '.join(faults[:3])}{more}")
