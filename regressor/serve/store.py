"""The weights a regressor was given, on its own disk: parcels named by their SHA-256, and the order it follows."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from conveyor.errors import InputError, StorageError
from conveyor.files import cause, replacing, told
from conveyor.refused import all_in_words
from regressor.serve.messages import digest_of, write_checkpoint
from regressor.weigh.weigher import Weigher


@dataclass(frozen=True, slots=True)
class Order:
    """Weigh with parcel `digest`. Of two orders the higher `n` holds, and at the same `n` the higher digest.

    Attributes:
        n: 0 is what the config says.
        previous, previous_model: the parcel before it, and its name in the ledger.
        config_digest: of the config's own weights when it was given; under another config the order is void.
    """

    n: int
    digest: str
    previous: str = ""
    previous_model: str = ""
    config_digest: str = ""

    def newer_than(self, other: Order) -> bool:
        """This one holds."""
        return self.n > 0 and (self.n, self.digest) > (other.n, other.digest)


_ORDER: TypeAdapter[Order] = TypeAdapter(Order)


class WeightsStore:
    """Parcels and the order, in a folder that is made when first written to.

    Args:
        folder: kept across restarts; None takes a temporary one, gone when the process stops.
    """

    def __init__(self, folder: Path | None) -> None:
        self._given = folder
        self._temporary: tempfile.TemporaryDirectory[str] | None = None

    def close(self) -> None:
        """Remove what was temporary."""
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    def has(self, digest: str) -> bool:
        """Whether this parcel is here, whole: one that the disk has damaged is not, so that it can be given again."""
        return (data := self._read(digest)) is not None and digest_of(data) == digest

    def add(self, parcel: bytes) -> str:
        """Keep a parcel, durably; its digest.

        Raises:
            StorageError: it cannot be written now.
        """
        digest = digest_of(parcel)
        if not self.has(digest):
            self._write(_file(self._folder(), digest), parcel)
        return digest

    def parcel(self, digest: str) -> bytes:
        """The bytes of a parcel.

        Raises:
            InputError: it is not here, or is not what its name says any more.
        """
        data = self._read(digest)
        if data is None:
            raise InputError(f"weights {digest[:16]} are not here")
        if digest_of(data) != digest:
            raise InputError(f"weights {digest[:16]} in {self._found()} were damaged on the disk; give them again")
        return data

    def _read(self, digest: str) -> bytes | None:
        """What stands under that name, damaged or not."""
        folder = self._found()
        try:
            return _file(folder, digest).read_bytes() if folder is not None else None
        except OSError:
            return None

    def load(self, digest: str) -> Weigher:
        """A weigher with these weights.

        Raises:
            InputError: not here, damaged, or no weights that can be used.
            StorageError: there is no room to unpack them now.
        """
        parcel = self.parcel(digest)
        try:
            with tempfile.TemporaryDirectory(prefix="tuberline-weights-") as folder:
                return Weigher.load(write_checkpoint(parcel, Path(folder)))
        except OSError as error:
            raise StorageError(f"weights {digest[:16]} cannot be unpacked: {told(error)}") from error

    def keep_only(self, digests: set[str]) -> None:
        """Remove all other parcels.

        Raises:
            StorageError: one cannot be removed now.
        """
        folder = self._found()
        for file in folder.glob("*.parcel") if folder is not None else ():
            if file.stem not in digests:
                try:
                    file.unlink(missing_ok=True)
                except OSError as error:
                    raise StorageError(f"{file} cannot be removed: {cause(error)}") from error

    def record(self, order: Order) -> None:
        """Make durable which order is followed.

        Raises:
            StorageError: it cannot be written now.
        """
        self._write(self._folder() / "order.json", json.dumps(asdict(order)).encode())

    def recorded(self, *, config_digest: str) -> Order | None:
        """The order followed before a restart; None without one, or under another config's weights.

        Raises:
            InputError: it is there and cannot be read.
        """
        folder = self._found()
        if folder is None or not (file := folder / "order.json").is_file():
            return None
        try:
            order = _ORDER.validate_json(file.read_bytes())
        except (OSError, ValidationError) as error:
            why = all_in_words(error) if isinstance(error, ValidationError) else cause(error)
            raise InputError(f"{file} cannot be read: {why}; remove it to go on with the config's weights") from error
        return order if order.config_digest == config_digest else None

    def _found(self) -> Path | None:
        if self._temporary is not None:
            return Path(self._temporary.name)
        return self._given if self._given is not None and self._given.is_dir() else None

    def _folder(self) -> Path:
        if self._given is not None:
            try:
                self._given.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise StorageError(f"regressor.state_dir: {self._given} cannot be made: {error.strerror}") from error
            return self._given
        if self._temporary is None:
            try:
                self._temporary = tempfile.TemporaryDirectory(prefix="tuberline-given-")
            except OSError as error:
                raise StorageError(f"weights cannot be kept: {told(error)}") from error
        return Path(self._temporary.name)

    @staticmethod
    def _write(path: Path, data: bytes) -> None:
        try:
            with replacing(path) as file:
                file.write(data)
        except OSError as error:
            raise StorageError(f"{path} cannot be written: {cause(error)}") from error


def _file(folder: Path, digest: str) -> Path:
    return folder / f"{digest}.parcel"
