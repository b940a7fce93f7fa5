"""Machine code, texts or answers on disk, under what they follow from."""

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
from symsimpson.support.files import written_beside
from symsimpson.support.interpreter import rarely_collected, undisturbed
from symsimpson.support.progress import waiting
from symsimpson.text.header import digest

Result = TypeVar("Result")
LOG = logging.getLogger(__name__)

_VARIABLE = "SYMSIMPSON_CACHE_DIR"
DIGESTS = "digests.json"
#: How folders begin in which entries are built, and names of modules in them.
BUILDING, MODULE = ".building-", "symsimpson_compiled_"
_results: dict[str, object] = {}
#: So many entries can be made at a time; nobody waits longer, in seconds, for whoever makes one.
LOCKS, LONGEST = 64, 600.0
#: Settings of numba that change nothing in what it compiles.
_IDLE = ("CACHE_DIR", "NUM_THREADS", "THREADING_LAYER", "THREADING_LAYER_PRIORITY", "WARNINGS")


def cache_folder() -> Path:
    """Return the folder of compiled code, made if need be and checked to be private.

    ``$SYMSIMPSON_CACHE_DIR``, else ``$XDG_CACHE_HOME/symsimpson``, else ``~/.cache/symsimpson``.
    Raises GenerationError if others may write there: its files are executed.
    """
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(os.environ.get(_VARIABLE) or Path(base) / "symsimpson")
    try:
        folder = folder.expanduser()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        info = folder.lstat()
        writable = os.access(folder, os.W_OK)
    except (OSError, RuntimeError) as error:  # the latter where no home is known
        reason = str(getattr(error, "strerror", None) or error).rstrip(".")
        return _temporary_folder(folder, reason)
    foreign = hasattr(os, "getuid") and info.st_uid != os.getuid()
    shared = os.name == "posix" and info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    why = ""
    if shared:
        why = f"others may write there (mode {info.st_mode & 0o777:04o}; chmod 700 changes it)"
    if foreign:
        why = "it belongs to another user"
    if not stat.S_ISDIR(info.st_mode):
        why = "it is a link"
    if why:
        reject(
            f"the cache folder {folder} is not private to you: {why}.",
            remedy="Files in it are executed, so nobody else may write there. Name "
            "another folder in "
            f"${_VARIABLE}.",
            error=GenerationError,
        )
    return folder if writable else _temporary_folder(folder, "it cannot be written to")


@cache
def _temporary_folder(folder: Path, why: str) -> Path:
    """Return a private folder for this process alone, where no other can be had; say so once."""
    warn(
        f"the cache folder {folder} cannot be used ({why}): each process compiles anew.\n"
        f"Name a folder of your own in ${_VARIABLE}.",
        RuntimeWarning,
    )
    holder = tempfile.TemporaryDirectory(prefix="symsimpson-")
    _results["temporary folder"] = holder  # removed when the process ends
    return Path(holder.name)


@cache
def _without_cache(folder: Path, why: str) -> None:
    """Say once that what is compiled is not kept."""
    warn(
        f"nothing can be written to the cache folder {folder} ({why}): what is compiled now is not "
        f"kept, and each process compiles anew.\nMake room, or name another folder in "
        f"${_VARIABLE}.",
        RuntimeWarning,
    )


@cache
def _machine() -> str:
    """Name everything besides its text that compiled code depends on."""
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


def compiled(
    text: str, label: str, use: Callable[[ModuleType, bool], Result], file: str | None = None
) -> Result:
    """Import a module from its text and compile what is used of it, or load that from disk.

    Parameters
    ----------
    text : str
        The module's text; it must be trusted.
    label : str
        Names what ``use`` takes of it; part of the key.
    use : callable
        Takes the module, and whether numba is to keep on disk what it compiles of it. What it gives
        is returned, the same object for the same text and label in one process.
    file : str, optional
        What the module is, if its code follows from more than that: from all of ``text``.
    """
    content = _content(text, label)
    if content not in _results:
        _results[content] = _load_or_build(file or text, f"{label}_{content[:32]}", use)
    return _results[content]  # type: ignore[return-value]


def location(text: str, label: str) -> str:
    """Say where the compiled code of a text is: loaded, on disk, or nowhere yet."""
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
            "numba compiles nothing here, as NUMBA_DISABLE_JIT says, and steps are compiled code.",
            remedy="Unset that variable and begin Python anew; symsimpson.compile(..., "
            "precision=20) "
            "needs no compiler.",
            error=GenerationError,
        )
    folder = cache_folder()
    result = _loaded(folder, key, use)
    if result is not None:
        return result
    with waiting("compiling, once for this machine"), rarely_collected(), _alone(folder, key):
        result = _loaded(folder, key, use)  # another process may have made it meanwhile
        if result is not None:
            return result
        try:
            return _build(folder, key, text, use)
        except OSError as error:  # a disk that is full
            name = f"{MODULE}{key}"
            sys.modules.pop(name, None)
            _without_cache(folder, str(error.strerror or error))
            return _in_memory(name, text, use)


@undisturbed(most=1)  # from within LLVM, numba's callbacks lose an exception
def _loaded(folder: Path, key: str, use: Callable[[ModuleType, bool], Result]) -> Result | None:
    """Load an entry, if there is a whole one; what is left of another is taken away."""
    entry, name = folder / key, f"{MODULE}{key}"
    if not entry.is_dir():
        return None
    if _intact(entry):
        try:
            result = _import(entry / f"{name}.py", name, use)
            LOG.info("machine code taken from the cache: %s", entry)
            return result
        except Exception:  # whatever a stale pickle may raise, the entry can be made again
            sys.modules.pop(name, None)
    LOG.info("machine code in the cache is damaged, and compiled again: %s", entry)
    shutil.rmtree(entry, ignore_errors=True)
    return None


def lock_file(folder: Path, key: str) -> Path:
    """Return the file that a process locks while it makes an entry."""
    return folder / f".lock-{int(key[-4:], 16) % LOCKS}"


@contextlib.contextmanager
def _alone(folder: Path, key: str) -> Iterator[None]:
    """Let one process at a time make an entry; the system frees the lock of one that died."""
    lock = FileLock(lock_file(folder, key), timeout=LONGEST)
    # without the lock both make it, and one is kept
    with contextlib.suppress(OSError, NotImplementedError, Timeout):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


@undisturbed(most=1)  # from within LLVM, numba's callbacks lose an exception
def _build(folder: Path, key: str, text: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    """Compile in a folder of its own, and rename it into place."""
    entry, name = folder / key, f"{MODULE}{key}"
    start = time.perf_counter()
    building = Path(tempfile.mkdtemp(prefix=BUILDING, dir=folder))
    try:
        path = building / f"{name}.py"
        path.write_text(text, encoding="utf-8")
        result = _import(path, name, use)
        (building / DIGESTS).write_text(json.dumps(_digests(building)), encoding="utf-8")
        with contextlib.suppress(OSError):  # another process was first
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
    """Import a file under a name, registered before it runs: numba finds its cache by it."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    with _own_numba_cache():
        spec.loader.exec_module(module)
        return use(module, True)


@undisturbed(most=1)  # from within LLVM, numba's callbacks lose an exception
def _in_memory(name: str, text: str, use: Callable[[ModuleType, bool], Result]) -> Result:
    """Make a module of its text alone."""
    module = ModuleType(name)
    sys.modules[name] = module
    exec(compile(text, f"<{name}>", "exec"), module.__dict__)
    return use(module, False)


@contextlib.contextmanager
def _own_numba_cache() -> Iterator[None]:
    """Keep numba's files inside the entry, wherever the environment would put them."""
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


#: Folders of answers, beside compiled code.
Kind = Literal["choices", "texts"]
KINDS = get_args(Kind)
Answer = TypeVar("Answer")
#: What a file may raise that is not there, not whole, or not what it should be.
DAMAGE = (OSError, ValueError, KeyError, TypeError, AttributeError, SymsimpsonError)


def kept(
    kind: Kind,
    question: str,
    read: Callable[[Any], Answer],
    make: Callable[[], Answer],
    write: Callable[[Answer], Any],
) -> Answer:
    """Return the answer that was kept for the same question, or make it and keep it.

    ``kind`` is the folder of such answers, beside compiled code; ``question`` is all that the
    answer follows from. ``read`` makes the answer of what JSON holds, and raises an error of
    ``DAMAGE`` if that makes no sense; ``write`` returns what is to be kept, for JSON, or None if it
    is not worth it.
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
        with contextlib.suppress(StorageError, OSError):  # a full disk keeps nothing
            place.parent.mkdir(mode=0o700, exist_ok=True)
            with written_beside(place, "answer") as whole:
                whole.write_text(json.dumps(content), encoding="utf-8")
            LOG.info("%s: remembered in %s", kind, place)
    return answer


#: What the generator is made of.
GENERATOR = ("graph", "declare", "schemes", "discrete", "text", "lower")
#: A derivation that took less, in seconds, is as soon done again as read.
BRIEF = 0.1


def kept_text(source: Iterable[str], derive: Callable[[], Derivation]) -> Derivation:
    """Return the derivation that was kept for the same source, or make it and keep it.

    The ``source`` is all that the text follows from, beside the generator itself. Stages of the
    derivation took no time where it was kept.
    """
    return kept("texts", "\n".join([_generator(), *source]), _derivation, derive, _written)


def _derivation(content: Any) -> Derivation:
    text = content["text"]
    if digest(text) != content["sha256"]:
        raise ValueError("the text does not have the digest that it names")
    seconds = dict.fromkeys(map(str, content["stages"]), 0.0)
    return Derivation(text, seconds, content["operations"], content["unrolled"] is True)


def _written(derivation: Derivation) -> dict[str, Any] | None:
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
def _generator() -> str:
    """Return what tells this generator from others, which may write other texts."""
    package, content = resources.files("symsimpson"), hashlib.sha256()
    for name in GENERATOR:
        for file in _files(package.joinpath(name)):
            content.update(file.read_bytes())
    return content.hexdigest()


def _files(place: Traversable) -> list[Traversable]:
    if place.is_file():
        return [place] if place.name.endswith(".py") else []
    return [x for entry in sorted(place.iterdir(), key=lambda x: x.name) for x in _files(entry)]
