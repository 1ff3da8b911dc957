"""The few real depth frames at hand go through the segmentation as docs/evaluation-real.md says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import real


def test_real_frames_give_what_the_page_says(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    real.main(["--shared", str(shared), "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert re.findall(r"(\d+) instances in the empty bin", said) == ["0", "0", "0"]
    away = [float(m) for m in re.findall(r"floor (\S+) m away", said)]
    assert away == pytest.approx([0.840, 0.653, 0.773], abs=0.005)
    assert "R9-9: 1 instance, 99.8% of the measured tuber" in said
    volume = re.search(r"(\S+) ml between", said)
    assert volume is not None
    assert float(volume[1]) == pytest.approx(107.3, abs=1.0)
    pictures = sorted(tmp_path.glob("real-*.jpg"))
    assert len(pictures) == 5
    assert all(picture.stat().st_size < 300_000 for picture in pictures)
