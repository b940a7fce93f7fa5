"""Chunks of a Zarr store: what is missing or damaged raises an error, and is not read as NaN."""

from __future__ import annotations

from collections.abc import Container
from typing import Any

from zarr.storage import WrapperStore

from symsimpson.errors import StorageError, reject
from symsimpson.support.extras import library

decompress = library("numcodecs.zstd", "store=", "data").decompress  # a part of zarr


class WholeChunks(WrapperStore[Any]):
    """A Zarr store whose chunks are there and whole.

    Chunks may be missing that are ``waiting`` to be computed: names of arrays, and numbers.
    """

    def __init__(self, store: Any, waiting: Container[tuple[str, int]] = ()) -> None:
        super().__init__(store)
        self.waiting = waiting

    def with_read_only(self, read_only: bool = False) -> WholeChunks:
        """Return the same store for reading only, or for writing, too."""
        return type(self)(self._store.with_read_only(read_only), self.waiting)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return what is stored under a key.

        Raises StorageError with the key of a chunk that is missing or damaged.
        """
        content = await self._store.get(key, prototype, byte_range)
        name, _, place = key.partition("/c/")
        if not place:  # of metadata there need not be any
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
            f"{self._store}: the chunk {key} of the store {problem}.",
            remedy="Repeat the call that began the store: it computes what is missing.",
            error=StorageError,
        )

    def __str__(self) -> str:
        return str(self._store)
