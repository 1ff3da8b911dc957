"""The recordings of the other world: camera, sensor, belt and bodies of each.

The table was written before any of its recordings was run; its seeds stay.
"""

from __future__ import annotations

from typing import Any

from benchmarks.otherworld_camera import Camera, Sensor
from benchmarks.otherworld_scenes import Scene


def d405(**more: Any) -> Camera:
    return Camera(**{"name": "cam", "width": 848, "height": 480, "focal_px": 433.0, "height_m": 0.35, **more})


def hd(**more: Any) -> Camera:
    return Camera(**{"name": "cam", "width": 1280, "height": 720, "focal_px": 651.0, "height_m": 0.40, **more})


def vga(**more: Any) -> Camera:
    return Camera(**{"name": "cam", "width": 640, "height": 480, "focal_px": 465.0, "height_m": 0.60, **more})


def small(**more: Any) -> Camera:
    return Camera(**{"name": "cam", "width": 424, "height": 240, "focal_px": 214.0, "height_m": 0.45, **more})


EXACT, TENTH = Sensor(), Sensor(unit_m=0.0001)
QUARTER = Sensor(unit_m=0.00025, axial_mm=0.6)
SHORT = Sensor(baseline_m=0.018, noise_px=0.04, step_px=1 / 32, steep_px=0.55, outline_px=1, fatten_px=1, shadow=True)
WIDE = Sensor(
    baseline_m=0.05, noise_px=0.06, window_px=2.5, step_px=1 / 32, steep_px=1.2, outline_px=2, fatten_px=2, shadow=True,
    islands=1.0, bow_px=0.08,
)  # fmt: skip
HARSH = Sensor(
    baseline_m=0.05, noise_px=0.11, window_px=2.5, step_px=1 / 16, steep_px=1.0, outline_px=4, shadow=True,
    islands=5.0, speckle=0.03, bow_px=0.1,
)  # fmt: skip
FAT = Sensor(baseline_m=0.05, noise_px=0.05, window_px=3.0, step_px=1 / 32, fatten_px=4, shadow=True)
SPECKS = Sensor(baseline_m=0.05, noise_px=0.05, step_px=1 / 32, steep_px=1.2, shadow=True, speckle=0.10)
FLIGHT = Sensor(axial_mm=1.5, mix_px=3)
FILLED = Sensor(
    unit_m=0.0001,
    baseline_m=0.018,
    noise_px=0.05,
    step_px=1 / 32,
    steep_px=0.55,
    outline_px=2,
    shadow=True,
    filled=True,
)
MIX = ("smooth", "bumpy", "knobby", "long", "small")
SIDE = (d405(name="left", height_m=0.45, y_m=-0.2), d405(name="right", height_m=0.45, y_m=0.2, late_s=0.021))
TANDEM = (vga(name="front", height_m=0.5), vga(name="rear", height_m=0.55, x_m=0.3, late_s=0.013))

SCENES: tuple[Scene, ...] = (
    Scene("exact-singulated", 8801, (d405(),), EXACT, "singulated", tubers=40, lane_m=0.3, speed_mps=0.5, fps=15),
    Scene("exact-touching", 8802, (d405(),), EXACT, "touching", ("smooth", "bumpy"), 50),
    Scene("exact-crowded", 8803, (hd(),), EXACT, "crowded", MIX, 60, fps=10, speed_mps=0.2),
    Scene("tenth-touching", 8804, (d405(height_m=0.45),), TENTH, "touching", ("long", "smooth"), 50, travel=False),
    Scene("tenth-tilted", 8805, (d405(height_m=0.40, pitch_deg=4, roll_deg=-3),), TENTH, "touching", MIX, 50),
    Scene("quarter-unit", 8806, (vga(),), QUARTER, "touching", ("bumpy",), 50, origin_m=17.3),
    Scene("short-singulated", 8807, (d405(height_m=0.30),), SHORT, "singulated", ("knobby",), 40, lane_m=0.3,
        fps=30, speed_mps=0.6),
    Scene("short-touching", 8808, (d405(),), SHORT, "touching", MIX, 50, colour=True),
    Scene("short-crowded", 8809, (hd(height_m=0.345),), SHORT, "crowded", ("smooth", "long"), 55, fps=15, travel=False),
    Scene("short-small", 8810, (d405(height_m=0.35),), SHORT, "touching", ("small",), 60, lane_m=0.3,
        speed_mps=0.15, fps=10),
    Scene("short-in-view", 8811, (d405(height_m=0.40),), SHORT, "crowded", ("smooth", "bumpy"), 105,
        lane_m=0.25, bare=False),
    Scene("wide-touching", 8812, (vga(),), WIDE, "touching", ("smooth", "knobby"), 50, travel=False),
    Scene("wide-crowded", 8813, (vga(height_m=0.5),), WIDE, "crowded", MIX, 60, fps=20),
    Scene("wide-tilted", 8814, (vga(height_m=0.55, pitch_deg=-6, roll_deg=2),), WIDE, "touching", ("bumpy",),
        50, speed_mps=0.45),
    Scene("wide-far", 8815, (hd(height_m=0.80),), WIDE, "touching", ("smooth",), 55, lane_m=0.6, speed_mps=0.6, fps=10),
    Scene("wide-in-view", 8816, (vga(height_m=0.5, pitch_deg=3),), WIDE, "touching", MIX, 110, lane_m=0.25,
        bare=False, travel=False),
    Scene("harsh-singulated", 8817, (d405(height_m=0.5),), HARSH, "singulated", ("smooth",), 40, speed_mps=0.5),
    Scene("harsh-touching", 8818, (d405(height_m=0.5),), HARSH, "touching", ("smooth", "bumpy"), 50, swing=0.1),
    Scene("fat-touching", 8819, (d405(height_m=0.5),), FAT, "touching", ("smooth", "long"), 50),
    Scene("specks-singulated", 8820, (vga(height_m=0.5),), SPECKS, "singulated", ("long",), 40, travel=False,
        speed_mps=0.4),
    Scene("specks-crowded", 8821, (d405(height_m=0.45),), SPECKS, "crowded", MIX, 60, lost_frames=(31, 32, 55)),
    Scene("flight-touching", 8822, (vga(height_m=0.6),), FLIGHT, "touching", ("smooth", "bumpy"), 50, colour=True),
    Scene("filled-touching", 8823, (d405(height_m=0.38),), FILLED, "touching", ("smooth", "knobby"), 50),
    Scene("small-image", 8824, (small(),), SHORT, "singulated", ("smooth",), 40, fps=30),
    Scene("small-image-touching", 8825, (small(height_m=0.35),), EXACT, "touching", ("smooth", "bumpy"), 50,
        swing=0.15),
    Scene("side-by-side", 8826, SIDE, SHORT, "touching", ("smooth", "bumpy"), 60, lane_m=0.8, speed_mps=0.4),
    Scene("tandem", 8827, TANDEM, WIDE, "touching", MIX, 45, travel=False, lane_m=0.45),
    Scene("tandem-exact", 8828, TANDEM, TENTH, "crowded", ("smooth",), 50, origin_m=-3.2, lane_m=0.45),
    Scene("foreign-touching", 8829, (d405(),), SHORT, "touching", ("smooth", "bumpy"), 45, foreign=15, colour=True),
    Scene("foreign-crowded", 8830, (vga(height_m=0.5),), WIDE, "crowded", MIX, 50, foreign=20),
)  # fmt: skip
