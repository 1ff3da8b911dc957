"""Count and weigh all that passes in a recording, with the processes of a real line, and read the ledger."""

import tempfile
from pathlib import Path

import tuberline

with tempfile.TemporaryDirectory() as folder:
    recording = tuberline.simulate(Path(folder) / "belt", seed=4, tubers=6, scene="singulated", fps=15)
    ledger = tuberline.replay(recording.path, out=Path(folder) / "run", regressors=1)
    truth = recording.truth()

for tuber in ledger.tubers:
    print(f"tuber {tuber.tuber_id}: {tuber.weight_g:.1f} g, {tuber.length_mm:.0f} mm long, {tuber.views} views")
if ledger.totals and truth:
    low_g, high_g = ledger.totals.low_g, ledger.totals.high_g
    print(f"{ledger.totals.count} tubers, {ledger.totals.weight_g:.0f} g (90 %: {low_g:.0f} to {high_g:.0f} g)")
    print(f"in truth: {len(truth['tubers'])} tubers, {sum(tuber['weight_g'] for tuber in truth['tubers']):.0f} g")

# Later, or of a line that runs: ledger = tuberline.read_ledger("runs/latest")
