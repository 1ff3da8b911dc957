"""No frame waits for the compiler: what frames call has been compiled before the node says that it is ready."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT

FRAMES = """
import sys
from pathlib import Path
from numba.core.registry import CPUDispatcher
from conveyor.formats import camera_names, open_source
from conveyor.messages import Frame
from segmenter.pipeline import Segmenter, Settings
from segmenter.warmup import warm_up

def compiled():
    modules = [module for name, module in sys.modules.items() if name.split(".")[0] in ("conveyor", "segmenter")]
    found = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, CPUDispatcher)}
    return {f"{kernel.__module__}.{kernel.__name__}": len(kernel.signatures) for kernel in found}

warm_up(Settings().split.pixel_mm)
ready = compiled()
core, recording = Segmenter(Settings()), Path(sys.argv[1])
counted = 0
for frame in open_source(recording, camera=camera_names(recording)[0], ignore_masks=True).frames(run="r"):
    if isinstance(frame, Frame):
        counted += len(core.step(Frame.decode(frame.encode())).closed)
assert counted > 5 and len(ready) > 25, (counted, ready)
print(*(name for name, kinds in compiled().items() if kinds != ready.get(name)))
"""


def test_warming_up_compiles_whatever_frames_call(live_recording: Path) -> None:
    """Two kernels of the classifier were compiled by the first decision: with 22 processes starting on two cores that
    took 40 s, and every segmenter was taken for stuck and killed, twice.
    """
    done = subprocess.run(
        [sys.executable, "-c", FRAMES, str(live_recording)], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []
