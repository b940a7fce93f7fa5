"""The files that the package keeps on disk: how large they are, and how they are removed."""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from symsimpson.program.answers import KINDS
from symsimpson.program.cache import BUILDING, DIGESTS, MODULE, cache_folder, lock_file

SOURCE = re.compile(MODULE + r"(.+_[0-9a-f]{32})\.py")
ANSWER = re.compile(r"\.?[0-9a-f]{64}(\.new)?\.json")


def clear_cache() -> int:
    """Remove compiled code and remembered choices from the disk.

    The next run of each system compiles again. Code that is loaded stays in use, and other
    processes may go on: what one of them compiles at the moment is not removed. Files in the
    cache folder that symsimpson did not write stay there.

    Returns
    -------
    int
        Number of bytes that were removed.

    Raises
    ------
    GenerationError
        If the cache folder is not private to you.

    Examples
    --------
    >>> import os, tempfile, symsimpson as ss
    >>> from unittest import mock
    >>> with mock.patch.dict(os.environ, SYMSIMPSON_CACHE_DIR=tempfile.mkdtemp()):  # a new one
    ...     ss.clear_cache()
    0
    """
    folder = cache_folder()
    freed = sum(_removed(folder, path) for path in list(_ours(folder)))
    for kind in KINDS:
        with contextlib.suppress(OSError):  # it holds something else
            (folder / kind).rmdir()
    return freed


def usage(folder: Path) -> tuple[int, int]:
    """Return the number of compiled entries in a cache folder, and the bytes of all in it."""
    ours = list(_ours(folder))
    entries = [path for path in ours if path.is_dir() and not path.name.startswith(BUILDING)]
    return len(entries), sum(map(_bytes, ours))


def _ours(folder: Path) -> Iterator[Path]:
    """Return entries, folders in which entries are built, and answers."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            if path.name in KINDS:
                yield from (x for x in path.glob("*.json") if ANSWER.fullmatch(x.name))
            elif path.name in _keys(path) or (path.name.startswith(BUILDING) and _keys(path)):
                yield path


def _keys(path: Path) -> list[str]:
    """Return keys of the entries in a folder; none if it holds anything else."""
    names = [x.name for x in path.rglob("*") if not x.is_dir()]
    if not all(x.startswith(MODULE) or x == DIGESTS for x in names):
        return []
    return [match[1] for x in names if (match := SOURCE.fullmatch(x))]


def _bytes(path: Path) -> int:
    total = 0
    for file in (path, *path.rglob("*")):
        with contextlib.suppress(OSError):  # another process removed it
            total += file.lstat().st_size * (not file.is_dir())
    return total


def _removed(folder: Path, path: Path) -> int:
    """Remove a file or a folder, unless another process builds it; return the bytes removed."""
    size, keys = _bytes(path), _keys(path) if path.name.startswith(BUILDING) else []
    try:
        with contextlib.ExitStack() as stack:
            for key in keys:
                stack.enter_context(FileLock(lock_file(folder, key), timeout=0))
            aside = tempfile.TemporaryDirectory(
                prefix=BUILDING, dir=folder, ignore_cleanup_errors=True
            )
            # renamed first: another process finds all of it, or nothing
            path.rename(Path(stack.enter_context(aside)) / path.name)
    except (OSError, NotImplementedError, Timeout):
        return 0
    return size
