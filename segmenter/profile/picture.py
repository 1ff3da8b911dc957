"""A picture of a camera's profile: its depth, its noise, what is missing, its bow and its steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from conveyor.camera_range import CameraRange
from conveyor.depth_noise import disparity, window_residuals_px
from segmenter.profile.recording import ProfiledCamera
from segmenter.profile.verdict import own_px


def draw_profiles(path: Path, cameras: list[ProfiledCamera], trained: CameraRange, *, title: str) -> None:
    """Write the picture, a row of four panels for each camera. Needs matplotlib."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, rows = plt.subplots(len(cameras), 4, figsize=(18, 4.2 * len(cameras)), squeeze=False)
    for row, camera in zip(rows, cameras, strict=True):
        _depth(row[0], camera)
        _missing(row[1], camera)
        _bow(row[2], camera)
        _noise(row[3], camera, trained)
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _depth(axes: Any, camera: ProfiledCamera) -> None:
    frame = camera.first
    z = np.where(frame.depth > 0, frame.depth * float(1000 * frame.depth_scale_m), np.nan)
    low, high = np.nanquantile(z, [0.01, 0.99])
    image = axes.imshow(z, vmin=low, vmax=high, cmap="viridis_r")
    axes.figure.colorbar(image, ax=axes, shrink=0.7, label="mm")
    axes.set_title(f"{camera.profile.camera}: depth of frame {frame.seq}")
    axes.axis("off")


def _missing(axes: Any, camera: ProfiledCamera) -> None:
    axes.imshow(camera.first.depth == 0, cmap="gray_r")
    p = camera.profile
    width = "" if p.outline_px is None else f", {p.outline_px[0]:.0f} px wide at outlines"
    axes.set_title(f"without depth: {p.missing:.1%}{width}\nislands per frame: {p.islands_per_frame:.1f}")
    axes.axis("off")


def _bow(axes: Any, camera: ProfiledCamera) -> None:
    field = camera.profile.field
    if field is None or not np.isfinite(field.bow).any():
        axes.text(0.5, 0.5, "no belt plane is seen", ha="center", va="center")
        axes.axis("off")
        return
    reach = max(0.05, float(np.nanquantile(np.abs(field.bow), 0.99)))
    image = axes.imshow(field.bow, vmin=-reach, vmax=reach, cmap="RdBu")
    axes.figure.colorbar(image, ax=axes, shrink=0.7, label="px of disparity")
    bow = "too little seen" if field.bow_px is None else f"bow {field.bow_px:.3f} px"
    axes.set_title(f"departure from the plane, mean of {field.frames} frames\n{bow}, 3 to 40 px: {field.mid_px:.3f} px")
    axes.axis("off")


def _noise(axes: Any, camera: ProfiledCamera, trained: CameraRange) -> None:
    p, frame = camera.profile, camera.first
    d = disparity(frame.depth, depth_scale_m=frame.depth_scale_m, focal_baseline=p.focal_px * p.baseline_m)
    residuals = window_residuals_px(d)
    low, high = (own_px(p) * px for px in trained.local_px)
    axes.axvspan(low, high, color="tab:green", alpha=0.15, label="median of the trained cameras")
    if len(residuals):
        most = max(1.2 * high, float(np.quantile(residuals, 0.98)))
        axes.hist(residuals, bins=60, range=(0, most), color="tab:blue")
        axes.axvline(float(np.median(residuals)), color="tab:red", label=f"median here {np.median(residuals):.3f} px")
    step = "hidden by the depth unit" if p.step is None else f"1/{p.step.steps_per_px} px"
    axes.set_title(f"local noise of 11 x 11 px; step {step}")
    axes.set_xlabel("px of disparity")
    axes.set_yticks([])
    axes.legend(loc="upper right")
