"""Zarr stores in which a missing or damaged chunk raises an error instead of reading as NaN."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from zarr.storage import WrapperStore

from symsimpson.errors import StorageError, reject
from symsimpson.support.extras import import_library

decompress = import_library("numcodecs.zstd", "store=", "data").decompress  # a part of zarr


class VerifiedStore(WrapperStore[Any]):
    """A Zarr store that raises an error for missing or damaged chunks.

    ``waiting`` contains pairs of array name and chunk number that may be missing, because they are
    not computed yet.
    """

    def __init__(self, store: Any, waiting: Container[tuple[str, int]] = ()) -> None:
        super().__init__(store)
        self.waiting = waiting

    def with_read_only(self, read_only: bool = False) -> VerifiedStore:
        """Return the same store, read-only or writable."""
        return type(self)(self._store.with_read_only(read_only), self.waiting)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return the content of a key; raise StorageError if a chunk is missing or damaged."""
        content = await self._store.get(key, prototype, byte_range)
        name, _, place = key.partition("/c/")
        if not place:  # metadata, which may be missing
            return content
        problem = "is missing"
        try:
            if content is not None:
                decompress(content.to_bytes())
            if content is not None or (name, int(place.partition("/")[0])) in self.waiting:
                return content
        except (RuntimeError, ValueError) as error:
            problem = f"is damaged ({error})"
        reject(
            f"the chunk {key} of the store {problem}.",
            where=str(self._store),
            remedy="Repeat the call that created the store. It computes the missing chunks.",
            error=StorageError,
        )

    def __str__(self) -> str:
        return str(self._store)
