"""`tuberline camera profile`: what a recording's cameras are like, beside those that the weights were trained for."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from conveyor.errors import InputError
from tuberline.cli.numbers import within
from tuberline.cli.recordings import tell_doubts

if TYPE_CHECKING:
    from segmenter.profile.recording import ProfiledCamera

VERDICTS = {"inside": "green", "better": "green", "outside": "red", "not seen": "yellow", "": "default"}


def profile(
    recording: Path,
    /,
    *,
    out: Path | None = None,
    weights: Path | None = None,
    frames: Annotated[int, within(1, 100_000)] = 12,
    baseline_mm: Annotated[float | None, within(1, 1000, "mm")] = None,
    json: bool = False,
) -> None:
    """Measure each camera's noise, disparity step, holes, islands of mismatch and bow; say what follows for weights.

    Parameters
    ----------
    recording
        Recording of any kind that `replay` takes.
    out
        A picture (.png) of depth, holes, bow and noise; needs the extra 'train'.
    weights
        Compare with what these were trained for; default: the shipped ones.
    frames
        How many frames to look at, spread over the recording.
    baseline_mm
        Distance of the camera's two imagers; default: found from the steps of its depth, else 18 mm (D405).
    json
        Print the profiles as JSON on stdout.
    """
    import importlib.util

    from conveyor.camera_range import camera_range
    from conveyor.extras import install_hint
    from conveyor.files import check_picture, whole_output
    from regressor.network.stored import SHIPPED, read_weights
    from segmenter.profile.recording import profile_recording
    from tuberline.cli.progress import frames_bar

    if out is not None and importlib.util.find_spec("matplotlib") is None:
        raise InputError(f"the picture needs matplotlib; {install_hint('train')}")
    if out is not None:
        check_picture(out, option="--out")
    sidecar = read_weights(weights or SHIPPED)[1]
    tell_doubts(recording, masks=False)
    trained, belt = camera_range(sidecar.worlds), sidecar.calibrated_belt_m
    baseline_m = None if baseline_mm is None else baseline_mm / 1000
    with frames_bar() as on_frame:
        cameras = profile_recording(
            recording,
            trained,
            frames=frames,
            baseline_m=baseline_m,
            belt_m=(belt.low, belt.high),
            on_frame=on_frame,
        )
    if out is not None:
        from segmenter.profile.picture import draw_profiles

        with whole_output(out) as partial:
            draw_profiles(partial, cameras, trained, title=f"{recording.name}, trained range of {sidecar.model_id}")
    if json:
        report = {"weights": sidecar.model_id, "worlds": sidecar.worlds, "cameras": [c.as_dict() for c in cameras]}
        sys.stdout.write(json_module.dumps(report, indent=1) + "\n")
        return
    for camera in cameras:
        _print(camera, sidecar.model_id)
    if out is not None:
        sys.stdout.write(f"picture: {out}\n")


def _print(camera: ProfiledCamera, model: str) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    p = camera.profile
    unit = f"{1000 * p.depth_scale_m:g} mm"
    title = f"{escape(p.camera)}: {p.frames} frames" + (f", {p.blank} more without depth: not seen" if p.blank else "")
    table = Table("property", "measured", f"{escape(model)} trained for", "", title=title, title_justify="left")
    for finding in camera.findings:
        colour = VERDICTS[finding.verdict]
        table.add_row(finding.name, finding.measured, finding.trained, f"[{colour}]{finding.verdict}[/]")
    console = Console(highlight=False, soft_wrap=True)
    console.print(table)
    for text in camera.unread:
        console.print(f"left out: {text}", markup=False)
    by = {"given": "as given", "found": "found from its steps", "assumed": "assumed; give --baseline-mm"}[p.baseline_by]
    console.print(f"{p.width}x{p.height} in units of {unit}; px are of disparity, imagers {1000 * p.baseline_m:.1f} mm "
                  f"apart ({by})", markup=False)  # fmt: skip
    for finding in camera.outside:
        console.print(f"{finding.name}: {finding.follows}", markup=False)
    for finding in camera.unseen:
        console.print(f"{finding.name} not seen: {finding.follows}", markup=False)
    if camera.unseen and not camera.outside:
        console.print("nothing that was seen is outside; of the rest this recording says nothing", markup=False)
    elif not camera.outside:
        console.print("nothing is outside: weights and intervals hold as stated", markup=False)
