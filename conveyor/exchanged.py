"""What is said where a camera is another one than it was."""

from __future__ import annotations

from collections.abc import Iterable

from conveyor.messages import CameraExchanged


def exchanged_in_words(found: Iterable[CameraExchanged]) -> str:
    """One sentence for each camera; '' where there is none."""
    return "; ".join(exchanged_told(each) for each in found)


def exchanged_told(change: CameraExchanged) -> str:
    """What it was, what it is, and what that does."""
    return (
        f"camera {change.camera} was exchanged or is set otherwise: it was {change.before}, it is {change.now}. Its "
        "place, its belt distance and tickets from before are of the former one: measure them again, and enter a "
        "ticket of a load since"
    )
