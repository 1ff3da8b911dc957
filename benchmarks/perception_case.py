"""The fixed suite of simulated recordings for segmentation and counting, made where they are not there yet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from camera_sim.sim.optics import optics_named
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings

SUITE = (
    "singulated",
    "touching",
    "crowded",
    "distractors",
    "two-cameras",
    "dropped-frames",
    "stop-and-go",
    "tilted",
)


@dataclass(frozen=True, slots=True)
class Case:
    """One recording of the suite: a scene with its seed."""

    scene: str
    seed: int
    tubers: int
    preset: str = "field"
    camera: str = "d405-848"

    @property
    def name(self) -> str:
        """Of its folder: all that it depends on."""
        return f"{self.scene}-{self.preset}-{self.camera}-seed{self.seed}-{self.tubers}"

    def recording(self, root: Path) -> Path:
        """The recording under `root`, made now where it is not there. Its truth is written last, so it is whole."""
        out = root / self.name
        if not (out / "truth.json").is_file():
            settings = SceneSettings(
                scene=self.scene,
                seed=self.seed,
                tubers=self.tubers,
                preset=PRESETS[self.preset],
                optics=optics_named(self.camera),
            )
            record_scene(out, settings, masks=True)
        return out


def suite(scenes: tuple[str, ...], *, seeds: tuple[int, ...], tubers: int, preset: str) -> list[Case]:
    """All scenes with all seeds, scene after scene."""
    return [Case(scene, seed, tubers, preset) for scene in scenes for seed in seeds]
