"""A zarr group of which only the chunks of pieces that are done can be seen: all else reads as NaN, whatever files there are."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path
from typing import Any

from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype

from bayesftc.cosim.errors import StoreError


class MaskedGroup(Store):
    """The group as zarr reads it; nothing can be written.

    Parameters
    ----------
    folder : pathlib.Path
        Of the group.
    signals : collection of str
        Names of the arrays whose chunks are those of pieces.
    done : collection of int
        Pieces that can be seen.
    read : callable
        Returns the bytes of a file, by its name in the group.
    """

    supports_writes = supports_deletes = supports_partial_writes = False
    supports_listing = True

    def __init__(self, folder: Path, signals: Iterable[str], done: Iterable[int], read: Callable[[str], bytes]):
        super().__init__(read_only=True)
        self._folder, self._signals, self._done, self._read = folder, frozenset(signals), frozenset(done), read

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def _content(self, key: str) -> bytes | None:
        name, _, chunk = key.rpartition("/")
        if name not in self._signals or not chunk.startswith("c."):
            try:
                return self._read(key)
            except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
                return None
        if int(chunk.split(".")[1]) not in self._done:
            return None
        try:
            return self._read(key)
        except FileNotFoundError:
            raise StoreError(
                f"The file {key} of the campaign is missing; resume the campaign, which makes its runs again."
            ) from None

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        """Return what is under a key, or a part of it; None if nothing can be seen there."""
        content = await asyncio.to_thread(self._content, key)
        return None if content is None else prototype.buffer.from_bytes(content[_slice(byte_range)])

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Return what is under some keys."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def exists(self, key: str) -> bool:
        """Return whether something can be seen under a key."""
        return await asyncio.to_thread(self._content, key) is not None

    async def set(self, key: str, value: Buffer) -> None:
        """Refuse: a campaign's own writer does that."""
        self._check_writable()

    async def set_partial_values(self, key_start_values: Iterable[tuple[str, int, Any]]) -> None:
        """Refuse; zarr 3.1 asks for it."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Refuse."""
        self._check_writable()

    async def list(self) -> AsyncIterator[str]:
        """Yield all keys."""
        async for key in self.list_prefix(""):
            yield key

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """Yield the keys that begin so."""
        for path in sorted(self._folder.rglob("*")):
            key = path.relative_to(self._folder).as_posix()
            if path.is_file() and key.startswith(prefix):
                yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """Yield the names in a folder."""
        folder = self._folder / prefix
        if folder.is_dir():
            for path in sorted(folder.iterdir()):
                yield path.name


def _slice(byte_range: ByteRequest | None) -> slice:
    found: Any = byte_range
    if isinstance(found, RangeByteRequest):
        return slice(found.start, found.end)
    if isinstance(found, OffsetByteRequest):
        return slice(found.offset, None)
    if isinstance(found, SuffixByteRequest):
        return slice(-found.suffix, None)
    return slice(None)


__all__ = ["MaskedGroup"]
