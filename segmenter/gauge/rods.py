"""Rods of a web as a gauge: their pitch by the depth that is seen, against the pitch that is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.gauge.points import depths_m, rays

Floats = NDArray[np.float64]

STRIDE = 4
"""Pixels between columns: rods lie along the rows, and four columns see the same."""
REACH_M = 0.020
"""How far the rods' tops may lie off the calibrated plane: 6 mm of mount and 11 mm of drift."""
LEVEL_STEP_M = 0.0005
ABOVE_M = 0.005
"""Over the tops: what is still taken for rods. Flanks are seen down to `2 * radius`; the ground is lower."""
CREST, CREST_LEVEL_M = 0.25, 0.004
"""Of a rod's radius, either side of the middle that is seen, and of the level: where its height is measured. The
camera's matching window mixes the ground into what lies nearer to the rod's edge."""
PITCH_REACH, PITCH_STEP = 0.03, 0.0005
"""Share by which the pitch seen may differ from the known one, and between two that are tried."""
CELL_M = 0.0005
LEAST_POINTS = 2000
LEAST_CONTRAST = 0.25
"""Of the points whose phase is that of the rods; without rods it is below 0.1."""


def rods_distances_m(
    frame: Frame, belt: BeltGeometry, *, pitch_m: float, radius_m: float
) -> tuple[float, float] | None:
    """Camera to the rods' tops along the optical axis by depth, and by their pitch, metres; None: none are seen."""
    z = depths_m(frame, stride=STRIDE)
    along, _, up = rays(frame, belt, stride=STRIDE)
    height = z * up + belt.belt_from_camera[2, 3]
    near = np.abs(height) < REACH_M
    if np.count_nonzero(near) < LEAST_POINTS:
        return None
    level_m = _level(height[near])
    rods = (height < level_m + ABOVE_M) & (height > level_m - 2 * radius_m)
    if np.count_nonzero(rods) < LEAST_POINTS:
        return None
    # What is seen of a rod lies evenly about the ray through its axis: so places are those of rays at the axes' height.
    t = float(belt.belt_from_camera[2, 3])
    along, up = along[rods], up[rods]
    x_m = (level_m - radius_m - t) / up * along
    found = _pitch(x_m, pitch_m)
    if found is None:
        return None
    seen_pitch_m, phase = found
    beside_m = ((x_m / seen_pitch_m - phase + 0.5) % 1 - 0.5) * seen_pitch_m
    slant = np.arctan2(along, -up)
    crest = (np.abs(beside_m) < CREST * radius_m) & (np.abs(height[rods] - level_m) < CREST_LEVEL_M)
    if np.count_nonzero(crest) < LEAST_POINTS / 20:
        return None
    lean = np.arcsin(beside_m[crest] * np.cos(slant[crest]) / radius_m) - slant[crest]
    # A mean: whole millimetres have no median of their own.
    top_m = float(np.mean(height[rods][crest] + radius_m * (1 - np.cos(lean))))
    seen_m = belt.distance_m + top_m / float(belt.belt_from_camera[2, 2])
    # Pitch at the height that was taken for the tops; what is seen of it grows with the distance.
    taken_m = belt.distance_m + level_m / float(belt.belt_from_camera[2, 2]) + radius_m
    return seen_m, taken_m * pitch_m / seen_pitch_m - radius_m


def _level(heights_m: Floats) -> float:
    """Where most of the heights lie: the crests, for a round rod shows more of its crest than of any other height."""
    counts, edges = np.histogram(heights_m, bins=round(2 * REACH_M / LEVEL_STEP_M), range=(-REACH_M, REACH_M))
    smooth = np.convolve(counts, np.ones(5), mode="same")
    return float(edges[int(np.argmax(smooth))] + LEVEL_STEP_M / 2)


def _pitch(x_m: Floats, pitch_m: float) -> tuple[float, float] | None:
    """(pitch, phase of the rods' middles in turns) with which the points repeat most clearly; None where none do."""
    low = float(x_m.min())
    counts = np.bincount(((x_m - low) / CELL_M).astype(int)).astype(np.float64)
    # What lies far out must not end a rod in its middle: the ends fade.
    weight = counts * np.hanning(len(counts) + 2)[1:-1]
    at_m = low + (np.arange(len(counts)) + 0.5) * CELL_M
    tried = pitch_m * (1 + np.arange(-PITCH_REACH, PITCH_REACH + PITCH_STEP / 2, PITCH_STEP))
    waves = np.exp(-2j * np.pi * at_m[None, :] / tried[:, None]) @ weight
    power = np.abs(waves) / weight.sum()
    best = int(np.argmax(power))
    if not 0 < best < len(tried) - 1 or power[best] < LEAST_CONTRAST:
        return None
    left, middle, right = power[best - 1 : best + 2]
    shift = 0.5 * (left - right) / (left - 2 * middle + right)
    pitch = float(tried[best] + shift * pitch_m * PITCH_STEP)
    wave = np.exp(-2j * np.pi * at_m / pitch) @ weight
    return pitch, float(-np.angle(wave) / (2 * np.pi))
