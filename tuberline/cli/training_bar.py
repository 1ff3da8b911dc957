"""A training's progress bar."""

from __future__ import annotations

from typing import Any, Self

from regressor.network.sidecar import unit_of
from regressor.training.train import Training
from tuberline.cli.progress import progress_bar


class TrainingBar:
    """A progress bar in plain words on stderr."""

    def __init__(self) -> None:
        self._bar = progress_bar()
        self._task = self._bar.add_task("reading views", total=None)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def prepared(self, what: str, done: int) -> None:
        """`done` views of the `what` set are prepared."""
        self._bar.update(self._task, description=f"preparing {what} views: {done}")

    def step(self, training: Training, name: str = "") -> None:
        """One more step of the training `name` is made."""
        progress = training.progress
        pace = progress.seconds / progress.step
        words = f"{name} step {progress.step}, {pace:.2f} s each, loss {progress.loss:.2f}".lstrip()
        self._bar.update(self._task, description=words, completed=training.share, total=1.0)

    def stopping(self) -> None:
        """The training was asked to stop."""
        self._bar.console.print("stopping after this step, once the state is written; Ctrl-C again stops at once")

    def validated(self, training: Training, metrics: dict[str, Any]) -> None:
        """A validation is done."""
        figures, unit = metrics["validation"], unit_of(training.settings.target)
        self._bar.console.print(
            f"after {training.progress.seconds / 60:.1f} min, {training.progress.step} steps: validation MAE "
            f"{figures['mae_g']:.2f} {unit}, RMSE {figures['rmse_g']:.2f} {unit}, bias {figures['bias_g']:+.2f} {unit} "
            "per view"
        )
