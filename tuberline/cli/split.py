"""`tuberline split`: tubers shared out over training, validation and test."""

from __future__ import annotations

import sys
from pathlib import Path

from tuberline.cli.numbers import Seed


def split(folder: Path, /, *, seed: Seed = 20, force: bool = False) -> None:
    """Share the tubers of a 3DPotatoTwin folder out 60/20/20 over training, validation and test; writes splits.csv.

    Stratified by ten weight classes of equal size, as in the paper. The draw is our own: keep the splits.csv of the
    authors' download where there is one.

    Parameters
    ----------
    folder
        With ground_truth.csv.
    seed
        Of the draw.
    force
        Overwrite a splits.csv that is there.
    """
    from conveyor.formats.potatotwin.layout import is_potatotwin
    from conveyor.formats.potatotwin.views import left_out_told
    from regressor.training.split import write_splits

    counts = write_splits(folder, seed=seed, force=force)
    sys.stdout.write(f"{folder / 'splits.csv'}: {', '.join(f'{name} {count}' for name, count in counts.items())}\n")
    if is_potatotwin(folder) and (told := left_out_told(folder)):
        sys.stderr.write(f"{told}\n")
