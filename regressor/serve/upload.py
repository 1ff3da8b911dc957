"""A parcel that arrives in pieces: bounded, in order, and taken only when it is what its name says."""

from __future__ import annotations

from conveyor.errors import InputError
from regressor.serve.messages import MAX_PARCEL_BYTES, digest_of


class Upload:
    """The one parcel that is on its way to this regressor; another one takes its place."""

    def __init__(self) -> None:
        self._digest = ""
        self._size = 0
        self._data = bytearray()

    def take(self, digest: str, *, offset: int, size: int, piece: bytes) -> tuple[int, bytes | None]:
        """(bytes so far, the parcel when it is whole). A piece that came before changes nothing.

        Raises:
            InputError: too large, a piece beyond the end or after a gap, or not what `digest` says.
        """
        if not 0 < size <= MAX_PARCEL_BYTES:
            raise InputError(f"weights of {size} bytes: allowed are 1 to {MAX_PARCEL_BYTES}")
        if (digest, size) != (self._digest, self._size):
            self._digest, self._size, self._data = digest, size, bytearray()
        if offset > len(self._data) or offset + len(piece) > size:
            raise InputError(
                f"a piece of {len(piece)} bytes at {offset} does not follow the {len(self._data)} of {size} bytes that "
                "are here: send them from the beginning"
            )
        if offset == len(self._data):
            self._data += piece
        if len(self._data) < size:
            return len(self._data), None
        parcel = bytes(self._data)
        self._digest, self._size, self._data = "", 0, bytearray()
        if digest_of(parcel) != digest:
            raise InputError(f"the {size} bytes are not the weights {digest[:16]}: they were damaged on the way")
        return size, parcel
