"""The cache on disk: compiled code, derived texts, and choices, by digests of their inputs."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar, get_args

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np
from filelock import FileLock, Timeout

from symsimpson.errors import GenerationError, StorageError, SymsimpsonError, reject
from symsimpson.support.calling import warn
from symsimpson.support.derivation import Derivation
from symsimpson.support.files import atomic_path
from symsimpson.support.interpreter import collect_rarely, defer_interrupts
from symsimpson.support.progress import announce
from symsimpson.text.header import digest

Result = TypeVar("Result")
LOG = logging.getLogger(__name__)

_VARIABLE = "SYMSIMPSON_CACHE_DIR"
DIGESTS = "digests.json"
#: Prefixes of folders in which entries are built, and of the modules in them.
BUILDING, MODULE = ".building-", "symsimpson_compiled_"
_results: dict[str, object] = {}
#: The number of entries that can be built at a time, and the longest wait for one in seconds.
LOCKS, LONGEST = 64, 600.0
#: Settings of numba that do not change compiled code.
_IDLE = ("CACHE_DIR", "NUM_THREADS", "THREADING_LAYER", "THREADING_LAYER_PRIORITY", "WARNINGS")


def cache_folder() -> Path:
    """Return the private folder of compiled code; create it if necessary.

    The folder is ``$SYMSIMPSON_CACHE_DIR``, ``$XDG_CACHE_HOME/symsimpson`` or
    ``~/.cache/symsimpson``, in this order. Raises GenerationError if other users may write there,
    because its files are executed.
    """
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(os.environ.get(_VARIABLE) or Path(base) / "symsimpson")
    try:
        folder = folder.expanduser()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        info = folder.lstat()
        writable = os.access(folder, os.W_OK)
    except (OSError, RuntimeError) as error:  # RuntimeError if there is no home folder
        reason = str(getattr(error, "strerror", None) or error).rstrip(".")
        return _temporary_folder(folder, reason)
    foreign = hasattr(os, "getuid") and info.st_uid != os.getuid()
    shared = os.name == "posix" and info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    why = ""
    if shared:
        why = f"other users may write there (mode {info.st_mode & 0o777:04o}; use chmod 700)"
    if foreign:
        why = "it belongs to another user"
    if not stat.S_ISDIR(info.st_mode):
        why = "it is a link"
    if why:
        reject(
            f"the cache folder {folder} is not private to you: {why}.",
            why="Files in this folder are executed.",
            remedy=f"Name another folder in ${_VARIABLE}.",
            error=GenerationError,
        )
    return folder if writable else _temporary_folder(folder, "it cannot be written to")


@cache
def _temporary_folder(folder: Path, why: str) -> Path:
    """Return a temporary folder for this process, and warn once that nothing is cached."""
    warn(
        f"the cache folder {folder} cannot be used ({why}), so each process compiles again.\n"
        f"Name a folder of your own in ${_VARIABLE}.",
        RuntimeWarning,
    )
    holder = tempfile.TemporaryDirectory(prefix="symsimpson-")
    _results["temporary folder"] = holder  # removed when the process ends
    return Path(holder.name)


@cache
def _warn_without_cache(folder: Path, why: str) -> None:
    """Warn once that compiled code is not stored."""
    warn(
        f"nothing can be written to the cache folder {folder} ({why}), so each process compiles "
        f"again.\nFree space on the disk, or name another folder in ${_VARIABLE}.",
        RuntimeWarning,
    )


@cache
def _machine() -> str:
    """Return a digest of everything but the text that compiled code depends on."""
    idle = {f"NUMBA_{name}" for name in _IDLE}
    settings = {x: y for x, y in os.environ.items() if x.startswith("NUMBA_") and x not in idle}
    parts = (
        sys.version,
        numba.__version__,
        llvmlite.__version__,
        np.__version__,
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        str(llvm.get_host_cpu_features().flatten()),
        *sorted(f"{name}={value}" for name, value in settings.items()),
    )
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def load_or_compile(
    text: str, label: str, use: Callable[[ModuleType, bool], Result], file: str | None = None
) -> Result:
    """Compile a module, or load it from disk, and return the result of ``use``.

    Parameters
    ----------
    text : str
        The key of the entry; without ``file`` also the text of the module, which must be trusted.
    label : str
        A name for the result of ``use``. It is a part of the key.
    use : callable
        A function of the module and of a flag, whether numba stores compiled code on disk. Its
        result is returned. It is the same object for the same text and label in a process.
    file : str, optional
        The text of the module, if its code depends on more than this text. Then ``text`` has all
        that the code depends on.
    """
    content = _content(text, label)
    if content not in _results:
        _results[content] = _load_or_build(file or text, f"{label}_{content[:32]}", use)
    return _results[content]  # type: ignore[return-value]


def location(text: str, label: str) -> str:
    """Return as a text whether the compiled code is loaded, on disk, or not compiled yet."""
    content = _content(text, label)
    if content in _results:
        return "loaded"
    on_disk = (cache_folder() / f"{label}_{content[:32]}").is_dir()
    return "on disk, loaded when first used" if on_disk else "made when first used"


def _content(text: str, label: str) -> str:
    return hashlib.sha256(f"{_machine()}\n{label}\n{text}".encode()).hexdigest()


def _load_or_build(text: str, key: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    if getattr(numba.config, "DISABLE_JIT", False):
        reject(
            "NUMBA_DISABLE_JIT turns off the compiler, but steps are compiled code.",
            remedy="Unset this variable and restart Python. symsimpson.compile(..., precision=20) "
            "needs no compiler.",
            error=GenerationError,
        )
    folder = cache_folder()
    result = _load(folder, key, use)
    if result is not None:
        return result
    with announce("compiling, once for this machine"), collect_rarely(), _build_lock(folder, key):
        result = _load(folder, key, use)  # another process may have built it meanwhile
        if result is not None:
            return result
        try:
            return _build(folder, key, text, use)
        except OSError as error:  # the disk may be full
            name = f"{MODULE}{key}"
            sys.modules.pop(name, None)
            _warn_without_cache(folder, str(error.strerror or error))
            return _build_in_memory(name, text, use)


@defer_interrupts(most=1)  # from within LLVM, numba's callbacks lose an exception
def _load(folder: Path, key: str, use: Callable[[ModuleType, bool], Result]) -> Result | None:
    """Load an entry if it is intact. Remove a damaged entry and return None."""
    entry, name = folder / key, f"{MODULE}{key}"
    if not entry.is_dir():
        return None
    if _intact(entry):
        try:
            result = _import(entry / f"{name}.py", name, use)
            LOG.info("machine code taken from the cache: %s", entry)
            return result
        except Exception:  # a stale pickle may raise anything, and the entry can be built again
            sys.modules.pop(name, None)
    LOG.info("machine code in the cache is damaged, and compiled again: %s", entry)
    shutil.rmtree(entry, ignore_errors=True)
    return None


def lock_file(folder: Path, key: str) -> Path:
    """Return the file that a process locks while it builds an entry."""
    return folder / f".lock-{int(key[-4:], 16) % LOCKS}"


@contextlib.contextmanager
def _build_lock(folder: Path, key: str) -> Iterator[None]:
    """Lock an entry against other processes. The system frees the lock of a process that died."""
    lock = FileLock(lock_file(folder, key), timeout=LONGEST)
    # without the lock both processes build the entry, and one of them is stored
    with contextlib.suppress(OSError, NotImplementedError, Timeout):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


@defer_interrupts(most=1)  # from within LLVM, numba's callbacks lose an exception
def _build(folder: Path, key: str, text: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    """Compile an entry in a temporary folder, and rename the folder into place."""
    entry, name = folder / key, f"{MODULE}{key}"
    start = time.perf_counter()
    building = Path(tempfile.mkdtemp(prefix=BUILDING, dir=folder))
    try:
        path = building / f"{name}.py"
        path.write_text(text, encoding="utf-8")
        result = _import(path, name, use)
        (building / DIGESTS).write_text(json.dumps(_digests(building)), encoding="utf-8")
        with contextlib.suppress(OSError):  # another process may have been first
            building.rename(entry)
        LOG.info("compiled %s in %.2f s", entry, time.perf_counter() - start)
        return result
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _digests(entry: Path) -> dict[str, str]:
    return {
        str(path.relative_to(entry)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(entry.rglob("*"))
        if path.is_file() and path.name != DIGESTS and path.suffix != ".pyc"
    }


def _intact(entry: Path) -> bool:
    try:
        if entry.is_symlink() or any(path.is_symlink() for path in entry.rglob("*")):
            return False
        expected = json.loads((entry / DIGESTS).read_text(encoding="utf-8"))
        return bool(expected) and expected == _digests(entry)
    except (OSError, ValueError):
        return False


def _import(path: Path, name: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    """Import a file under a registered name, by which numba finds its cache."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    with _own_numba_cache():
        spec.loader.exec_module(module)
        return use(module, True)


@defer_interrupts(most=1)  # from within LLVM, numba's callbacks lose an exception
def _build_in_memory(name: str, text: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    """Compile a module without any file."""
    module = ModuleType(name)
    sys.modules[name] = module
    exec(compile(text, f"<{name}>", "exec"), module.__dict__)
    return use(module, False)


@contextlib.contextmanager
def _own_numba_cache() -> Iterator[None]:
    """Make numba store its files in the entry, whatever the environment says."""
    config: Any = numba.core.config
    elsewhere, bytecode = config.CACHE_DIR, sys.dont_write_bytecode
    config.CACHE_DIR, sys.dont_write_bytecode = "", True
    try:
        yield
    finally:
        config.CACHE_DIR, sys.dont_write_bytecode = elsewhere, bytecode


SOURCE = re.compile(MODULE + r"(.+_[0-9a-f]{32})\.py")
ANSWER = re.compile(r"\.?[0-9a-f]{64}(\.new)?\.json")


def clear_cache() -> int:
    """Remove compiled code and stored choices from the disk.

    The next run of each system compiles again. Code that this process has loaded remains in use.
    Entries that another process compiles at this moment are not removed, nor are files that
    symsimpson did not write.

    Returns
    -------
    int
        The number of removed bytes.

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
    freed = sum(_remove(folder, path) for path in list(_list_paths(folder)))
    for kind in KINDS:
        with contextlib.suppress(OSError):  # it may contain other files
            (folder / kind).rmdir()
    return freed


def usage(folder: Path) -> tuple[int, int]:
    """Return the number of compiled entries in a cache folder, and the size of all in bytes."""
    paths = list(_list_paths(folder))
    entries = [path for path in paths if path.is_dir() and not path.name.startswith(BUILDING)]
    return len(entries), sum(map(_count_bytes, paths))


def _list_paths(folder: Path) -> Iterator[Path]:
    """List the entries, the folders in which entries are built, and the answers."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            if path.name in KINDS:
                yield from (x for x in path.glob("*.json") if ANSWER.fullmatch(x.name))
            elif path.name in _keys(path) or (path.name.startswith(BUILDING) and _keys(path)):
                yield path


def _keys(path: Path) -> list[str]:
    """Return the keys of the entries in a folder; an empty list if it contains anything else."""
    names = [x.name for x in path.rglob("*") if not x.is_dir()]
    if not all(x.startswith(MODULE) or x == DIGESTS for x in names):
        return []
    return [match[1] for x in names if (match := SOURCE.fullmatch(x))]


def _count_bytes(path: Path) -> int:
    total = 0
    for file in (path, *path.rglob("*")):
        with contextlib.suppress(OSError):  # another process may have removed it
            total += file.lstat().st_size * (not file.is_dir())
    return total


def _remove(folder: Path, path: Path) -> int:
    """Remove a file or a folder, unless another process builds it; return the removed bytes."""
    size, keys = _count_bytes(path), _keys(path) if path.name.startswith(BUILDING) else []
    try:
        with contextlib.ExitStack() as stack:
            for key in keys:
                stack.enter_context(FileLock(lock_file(folder, key), timeout=0))
            temporary = tempfile.TemporaryDirectory(
                prefix=BUILDING, dir=folder, ignore_cleanup_errors=True
            )
            # renamed first, so that another process finds a whole entry or none
            path.rename(Path(stack.enter_context(temporary)) / path.name)
    except (OSError, NotImplementedError, Timeout):
        return 0
    return size


#: Folders of cached answers in the cache folder.
Kind = Literal["choices", "texts"]
KINDS = get_args(Kind)
Answer = TypeVar("Answer")
#: Errors of a file that is missing, incomplete or wrong.
DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, SymsimpsonError)


def load_or_make(
    kind: Kind,
    question: str,
    read: Callable[[Any], Answer],
    make: Callable[[], Answer],
    write: Callable[[Answer], Any],
) -> Answer:
    """Return the cached answer to a question, or compute and store it.

    ``kind`` is the folder of the answer in the cache folder. ``question`` has all that the answer
    depends on. ``read`` converts JSON data to the answer, and raises an error of ``DAMAGE`` for
    invalid data. ``make`` computes the answer. ``write`` converts it to JSON data, or returns None
    if it is not worth storing.
    """
    place = cache_folder() / kind / f"{digest(question)}.json"
    try:
        answer = read(json.loads(place.read_text(encoding="utf-8")))
        LOG.info("%s: taken from the cache, %s", kind, place)
        return answer
    except FileNotFoundError:
        pass
    except DAMAGE as error:
        LOG.info("%s: %s is damaged, and made again: %s", kind, place, error)
    answer = make()
    content = write(answer)
    if content is not None:
        with contextlib.suppress(StorageError, OSError):  # the disk may be full
            place.parent.mkdir(mode=0o700, exist_ok=True)
            with atomic_path(place, "answer") as whole:
                whole.write_text(json.dumps(content), encoding="utf-8")
            LOG.info("%s: remembered in %s", kind, place)
    return answer


#: The rooms of the generator.
GENERATOR = ("graph", "declare", "schemes", "discrete", "text", "lower")
#: A derivation that took less than this, in seconds, is not stored: reading takes as long.
BRIEF = 0.1


def load_or_derive(source: Iterable[str], derive: Callable[[], Derivation]) -> Derivation:
    """Return the cached derivation of a source, or derive and store it.

    The ``source`` has all that the text depends on, except the generator itself. The stages of a
    cached derivation took 0 seconds.
    """
    question = "\n".join([_digest_of_generator(), *source])
    return load_or_make("texts", question, _read_derivation, derive, _write_derivation)


def _read_derivation(content: Any) -> Derivation:
    text = content["text"]
    if digest(text) != content["sha256"]:
        raise ValueError("the text does not have the digest that it names")
    seconds = dict.fromkeys(map(str, content["stages"]), 0.0)
    return Derivation(text, seconds, content["operations"], content["unrolled"] is True)


def _write_derivation(derivation: Derivation) -> dict[str, Any] | None:
    if sum(derivation.seconds.values()) <= BRIEF:
        return None
    return {
        "text": derivation.text,
        "sha256": digest(derivation.text),
        "operations": derivation.operations,
        "unrolled": derivation.unrolled,
        "stages": [*derivation.seconds],
    }


@cache
def _digest_of_generator() -> str:
    """Return a digest of the generator's source files."""
    package, content = resources.files("symsimpson"), hashlib.sha256()
    for name in GENERATOR:
        for file in _files(package.joinpath(name)):
            content.update(file.read_bytes())
    return content.hexdigest()


def _files(place: Traversable) -> list[Traversable]:
    if place.is_file():
        return [place] if place.name.endswith(".py") else []
    return [x for entry in sorted(place.iterdir(), key=lambda x: x.name) for x in _files(entry)]
