"""A run on disk: what it is, where it stands, and all states stored so far.

``run.ckpt`` holds what was asked for and the workspace, ``run.ckpt.states`` the states, which
are only ever appended to, and ``run.ckpt.previous`` the file before. Each checkpoint knows the
digests of itself and of the states that it counts; it appears under its name when it is complete.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from symsimpson.errors import StorageError, reject
from symsimpson.program.program import Program
from symsimpson.run.ended import Sink
from symsimpson.stepping.run import KeptStates, Run
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.interpreter import undisturbed
from symsimpson.text.header import digest

#: The first line of a file: what it is, its version and the digest of what follows.
MAGIC, VERSION = "symsimpson checkpoint", 2
#: A checkpoint is written after about so many seconds where no number of steps is given.
SECONDS = 10.0
#: So many steps are taken before the first one.
FEWEST = 4096
#: So many bytes of states at most are kept in memory.
BUFFER = 2**24

Content = TypeVar("Content")


def buffered(every: int, stored: int, width: int) -> int:
    """Return the number of states of so many numbers that a run keeps in memory."""
    return min(stored, max(2, BUFFER // (8 * (width + 2)))) if every else 1


def asked(program: Program, run: Run, spec: RunSpec) -> dict[str, Any]:
    """Return what a run was asked for, in values of JSON; floats are written with all digits."""
    return {
        "source": program.source,
        **({"names": program.names.users} if program.names.users else {}),
        "parameters": spec.parameters.tolist(),
        **spec.as_json(),
        "q0": run.rows("POSITION", program.n).tolist(),
        "p0": run.rows("MOMENTUM", program.n).tolist(),
        **({"recorded": run.recorded.shape[1]} if run.recorded.shape[1] else {}),
        **({"tangents": spec.tangents.tolist()} if spec.tangents is not None else {}),
        **({"record": list(spec.record)} if spec.record else {}),
        **({"events": [repr(x) for x in spec.run_events.events]} if spec.run_events else {}),
        **({"reduce": [x.asked for x in spec.reductions]} if spec.reductions else {}),
    }


@dataclass(frozen=True)
class Record:
    """The statements of a checkpoint, the digest of its states so far, and the last of them."""

    asked: dict[str, Any]
    position: list[int]
    workspace: Floats
    stored: int
    digest: Any
    last: Floats


class Checkpoint(Sink):
    """All states of a run, and the run itself, on disk.

    The run is at its beginning, and goes on where the file says, if there is one; ``asked`` is what
    it was asked for. Checkpoints are ``every`` steps apart, about ten seconds unless that is given.
    """

    def __init__(
        self, path: Any, asked: dict[str, Any], run: Run, every: int | None = None
    ) -> None:
        super().__init__(run)
        self.path, self._asked, self._every = Path(path), asked, every
        self._rows, self._digest = 0, hashlib.sha256()
        self._segment, self._began = every or FEWEST, 0.0
        try:
            if exists(self.path):
                self._go_on()
                self._kept = run.step
            else:
                self._beside("states").write_bytes(b"")
                with undisturbed():
                    self._append(self._rows_of(slice(0, 1)))
                    self._save()
        except OSError as error:
            reject(
                f"{self.path}: the checkpoint cannot be written: {error.strerror or error}.",
                remedy="Choose another file, or make room.",
                error=StorageError,
                cause=error,
            )

    def due(self, stop: int) -> int:
        """Return the step at which the next checkpoint is to be written."""
        self._began = time.perf_counter()
        return min(stop, self._run.step + self._segment)

    def take(self) -> None:
        """Write a checkpoint, if there is anything new.

        Raises StorageError if it cannot be written.
        """
        done = self._run.step - self._kept
        if not done:
            return
        soon = time.perf_counter() - self._began < SECONDS / 2
        if self._every is None and done == self._segment and soon:
            self._segment *= 2
        try:
            with undisturbed():
                self._append(self._since())
                self._save()
        except OSError as error:
            reject(
                f"{self.path}: the checkpoint cannot be written: {error.strerror or error}.",
                remedy="The one before is good: make room and go on with "
                "symsimpson.resume. What was "
                "computed is in this error's .trajectory.",
                error=StorageError,
                cause=error,
            )

    def states(self) -> KeptStates:
        """Return what is stored, which stays on disk."""
        if not self._run.every:
            return super().states()
        n = self._run.header.n
        shape = (self._rows, 2 * n + 1 + self._run.recorded.shape[1])
        rows: Any = np.memmap(self._beside("states"), dtype="<f8", mode="r", shape=shape)
        unwritten = self._since()
        if len(unwritten):
            rows = np.vstack([rows, unwritten])
        iterations = rows[:, 2 * n].astype(np.int64)
        columns = rows[:, :n], rows[:, n : 2 * n], iterations, rows[:, 2 * n + 1 :]
        return KeptStates(*columns, self._run.every)

    def _beside(self, suffix: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{suffix}")

    def _since(self) -> Floats:
        """Return the states stored since the last checkpoint, one row each."""
        run = self._run
        last = (run.step - run.first) // run.every if run.every else 0
        return self._rows_of(slice(1, last + 1))

    def _rows_of(self, places: slice) -> Floats:
        run = self._run
        parts = [x[places, :, 0] for x in (run.q, run.p, run.iterations[:, None], run.recorded)]
        rows: Floats = np.column_stack(parts)
        return rows

    def _append(self, rows: Floats) -> None:
        """Append states to their file."""
        if self._run.every:
            data = np.ascontiguousarray(rows, dtype="<f8").tobytes()
            with open(self._beside("states"), "rb+") as file:
                file.truncate(self._rows * rows.shape[1] * 8)
                file.seek(0, os.SEEK_END)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            self._digest.update(data)
            self._rows += len(rows)
            self._run.forget()

    def _save(self) -> None:
        """Write a new file under another name, then give it the name: one or the other is there."""
        run = self._run
        body = json.dumps(
            {
                "asked": self._asked,
                "position": run.position(),
                "stored": self._rows,
                "states": self._digest.hexdigest(),
                "workspace": base64.b64encode(run.W.astype("<f8").tobytes()).decode(),
            }
        )
        new = self._beside("new")
        with open(new, "w", encoding="utf-8") as file:
            file.write(f"{MAGIC} {VERSION} {digest(body)}\n{body}")
            file.flush()
            os.fsync(file.fileno())
        if self.path.exists():
            os.replace(self.path, self._beside("previous"))
        os.replace(new, self.path)
        _sync(self.path.parent)
        self._kept = run.step

    def _go_on(self) -> None:
        """Put the run where the file says, if it is asked for the same."""
        record = read_record(self.path)
        for key, example in (("inputs", "inputs=..."), ("events", "events=[...]")):
            old, given = record.asked.get(key), self._asked.get(key)
            if old != given and {**record.asked, key: given} == {key: None, **self._asked}:
                reject(
                    f"{self.path} holds a run with {'no' if old is None else 'other'} {key}.",
                    remedy=f"Pass those that it began with: symsimpson.resume(path, {example}).",
                )
        if record.asked != self._asked:
            reject(
                f"{self.path} holds another run.",
                remedy="Go on with that one by symsimpson.resume, delete "
                "its files, or choose another file.",
            )
        run = self._run
        run.put_back(record.position, record.workspace)
        self._rows, self._digest = record.stored, record.digest
        if run.every:
            n = run.header.n
            run.q[0, :, 0], run.p[0, :, 0] = record.last[:n], record.last[n : 2 * n]
            run.recorded[0, :, 0] = record.last[2 * n + 1 :]


def exists(path: Path) -> bool:
    """Return whether there is a checkpoint, or the one before it."""
    return path.exists() or path.with_name(f"{path.name}.previous").exists()


def _digest_of(file: Any, size: int) -> Any:
    """Read so many bytes and give their digest so far."""
    checksum = hashlib.sha256()
    while size > 0:
        block = file.read(min(size, 2**20))
        if not block:
            break
        checksum.update(block)
        size -= len(block)
    return checksum


def read_asked(path: Path) -> dict[str, Any]:
    """Read what a run was asked for; raise StorageError if there is no whole file."""
    request: dict[str, Any] = _first_whole(path, _said)[0]["asked"]
    return request


def read_record(path: Path) -> Record:
    """Read a checkpoint, or with a warning the one before it where it is damaged.

    Raises StorageError if there is none, or neither is whole.
    """
    record, problems = _first_whole(path, _read)
    if problems:
        warn(
            f"{path}: the last checkpoint is damaged ({problems[0]}); the one before is used.",
            RuntimeWarning,
        )
    return record


def _first_whole(path: Path, read: Callable[[Path, Path], Content]) -> tuple[Content, list[str]]:
    """Return what the first whole file says, and what is wrong with those before it."""
    problems: list[str] = []
    for place in (path, path.with_name(f"{path.name}.previous")):
        try:
            return read(place, path.with_name(f"{path.name}.states")), problems
        except (OSError, ValueError, KeyError, TypeError) as error:
            problems.append(f"{place.name}: {getattr(error, 'strerror', None) or error}")
    reject(
        f"{path}: there is no whole checkpoint ({'; '.join(problems)}).",
        remedy="Nothing can be resumed from it. Begin the run anew, with another file.",
        error=StorageError,
    )


def _said(path: Path, states: Path) -> dict[str, Any]:
    """Read one file; raises ValueError if it is not as it was written."""
    head, _, body = path.read_text(encoding="utf-8").partition("\n")
    if head != f"{MAGIC} {VERSION} {digest(body)}":
        if not head.startswith(f"{MAGIC} "):
            raise ValueError("it is no checkpoint")
        if not head.startswith(f"{MAGIC} {VERSION} "):
            raise ValueError("it is of another version")
        raise ValueError("it does not match its digest")
    said: dict[str, Any] = json.loads(body)
    return said


def _read(path: Path, states: Path) -> Record:
    """Read one file and the states that it counts."""
    said = _said(path, states)
    workspace = np.frombuffer(base64.b64decode(said["workspace"]), dtype="<f8")
    width = 8 * (2 * len(said["asked"]["q0"]) + 1 + said["asked"].get("recorded", 0))
    size = said["stored"] * width
    with open(states, "rb") as file:
        checksum = _digest_of(file, size)
        whole = file.tell() == size
        file.seek(max(0, size - width))
        last = np.frombuffer(file.read(width), dtype="<f8")
    if not whole or checksum.hexdigest() != said["states"]:
        raise ValueError("the states beside it are damaged")
    return Record(said["asked"], said["position"], workspace, said["stored"], checksum, last)


def _sync(folder: Path) -> None:
    """Have the names in a folder written."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
