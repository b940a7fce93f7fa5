"""Checkpoint files: the arguments of a run, its workspace, and all states stored so far.

``run.ckpt`` has the arguments and the workspace. ``run.ckpt.states`` has the states; the run only
appends to it. ``run.ckpt.previous`` is the checkpoint before. Each checkpoint contains digests of
itself and of its states. A file gets its final name only when it is complete.
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
from symsimpson.stepping.run import Run, StoredStates
from symsimpson.stepping.spec import RunSpec
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import warn
from symsimpson.support.interpreter import defer_interrupts
from symsimpson.text.header import digest

#: The first line of a file: format, version, and the digest of the other lines.
MAGIC, VERSION = "symsimpson checkpoint", 2
#: Approximate time between checkpoints in seconds, unless the user sets a number of steps.
SECONDS = 10.0
#: Number of steps before the first checkpoint.
FEWEST = 4096
#: Largest size of the states in memory, in bytes.
BUFFER = 2**24

Content = TypeVar("Content")


def count_buffered(every: int, stored: int, width: int) -> int:
    """Return how many states of ``width`` numbers a run stores in memory between checkpoints."""
    return min(stored, max(2, BUFFER // (8 * (width + 2)))) if every else 1


def describe_run(program: Program, run: Run, spec: RunSpec) -> dict[str, Any]:
    """Return the arguments of a run as JSON values; floats have all digits."""
    return {
        "source": program.source,
        **({"names": program.names.users} if program.names.users else {}),
        "parameters": spec.parameters.tolist(),
        **spec.as_json(),
        "q0": run.rows("POSITION", program.n).tolist(),
        "p0": run.rows("MOMENTUM", program.n).tolist(),
        **({"recorded": run.recorded.shape[1]} if run.recorded.shape[1] else {}),
        **({"tangents": spec.tangents.tolist()} if spec.tangents is not None else {}),
        **({} if program.modes is None else {"modes": list(program.modes.names)}),
        **({"record": list(spec.record)} if spec.record else {}),
        **({"events": [repr(x) for x in spec.run_events.events]} if spec.run_events else {}),
        **({"reduce": [x.entries for x in spec.reductions]} if spec.reductions else {}),
    }


@dataclass(frozen=True)
class CheckpointContent:
    """Content of a checkpoint: arguments, position and workspace of the run, stored states.

    ``stored`` is the number of stored states, ``digest`` the digest of their file, and ``last`` the
    last of them.
    """

    description: dict[str, Any]
    position: list[int]
    workspace: Floats
    stored: int
    digest: Any
    last: Floats


class Checkpoint(Sink):
    """Sink that writes the run and all its states to disk.

    If the checkpoint file exists, the run continues from it. ``description`` has the arguments of
    the run, which must agree. Checkpoints are ``every`` steps apart, by default about ten seconds.
    """

    def __init__(
        self, path: Any, description: dict[str, Any], run: Run, every: int | None = None
    ) -> None:
        super().__init__(run)
        self.path, self._description, self._every = Path(path), description, every
        self._rows, self._digest = 0, hashlib.sha256()
        self._segment, self._began = every or FEWEST, 0.0
        try:
            if checkpoint_exists(self.path):
                self._resume()
                self._saved = run.step
            else:
                self._sibling("states").write_bytes(b"")
                with defer_interrupts():
                    self._append(self._rows_of(slice(0, 1)))
                    self._save()
        except OSError as error:
            reject(
                f"the checkpoint cannot be written: {error.strerror or error}.",
                where=str(self.path),
                remedy="Choose another file, or free disk space.",
                error=StorageError,
                cause=error,
            )

    def next_stop(self, stop: int) -> int:
        """Return the step of the next checkpoint, at most ``stop``."""
        self._began = time.perf_counter()
        return min(stop, self._run.step + self._segment)

    def take(self) -> None:
        """Write a checkpoint, unless the run has taken no steps since the last one.

        Raises StorageError if it cannot be written.
        """
        done = self._run.step - self._saved
        if not done:
            return
        soon = time.perf_counter() - self._began < SECONDS / 2
        if self._every is None and done == self._segment and soon:
            self._segment *= 2
        try:
            with defer_interrupts():
                self._append(self._new_rows())
                self._save()
        except OSError as error:
            reject(
                f"the checkpoint cannot be written: {error.strerror or error}.",
                where=str(self.path),
                remedy="The previous checkpoint is valid: free disk space and continue with "
                "symsimpson.resume. This error's .trajectory has the states computed so far.",
                error=StorageError,
                cause=error,
            )

    def states(self) -> StoredStates:
        """Return all stored states, from the file of states and from memory."""
        if not self._run.every:
            return super().states()
        n = self._run.header.n
        shape = (self._rows, 2 * n + 1 + self._run.recorded.shape[1])
        rows: Any = np.memmap(self._sibling("states"), dtype="<f8", mode="r", shape=shape)
        unwritten = self._new_rows()
        if len(unwritten):
            rows = np.vstack([rows, unwritten])
        iterations = rows[:, 2 * n].astype(np.int64)
        columns = rows[:, :n], rows[:, n : 2 * n], iterations, rows[:, 2 * n + 1 :]
        return StoredStates(*columns, self._run.every)

    def _sibling(self, suffix: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{suffix}")

    def _new_rows(self) -> Floats:
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
            with open(self._sibling("states"), "rb+") as file:
                file.truncate(self._rows * rows.shape[1] * 8)
                file.seek(0, os.SEEK_END)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            self._digest.update(data)
            self._rows += len(rows)
            self._run.discard_stored()

    def _save(self) -> None:
        """Write a new file, then rename it, so that a complete checkpoint always exists."""
        run = self._run
        body = json.dumps(
            {
                "asked": self._description,
                "position": run.position(),
                "stored": self._rows,
                "states": self._digest.hexdigest(),
                "workspace": base64.b64encode(run.W.astype("<f8").tobytes()).decode(),
            }
        )
        new = self._sibling("new")
        with open(new, "w", encoding="utf-8") as file:
            file.write(f"{MAGIC} {VERSION} {digest(body)}\n{body}")
            file.flush()
            os.fsync(file.fileno())
        if self.path.exists():
            os.replace(self.path, self._sibling("previous"))
        os.replace(new, self.path)
        _sync(self.path.parent)
        self._saved = run.step

    def _resume(self) -> None:
        """Restore the run from the file; raise InputError if the arguments differ."""
        record = read_checkpoint(self.path)
        for key, example in (("inputs", "inputs=..."), ("events", "events=[...]")):
            old, new = record.description.get(key), self._description.get(key)
            if old != new and {**record.description, key: new} == {key: None, **self._description}:
                reject(
                    f"{self.path} contains a run with {'no' if old is None else 'other'} {key}.",
                    remedy=f"Pass the original {key}: symsimpson.resume(path, {example}).",
                )
        if record.description != self._description:
            reject(
                f"{self.path} contains another run.",
                remedy="Continue that run with symsimpson.resume, delete its files, or choose "
                "another file.",
            )
        run = self._run
        run.restore(record.position, record.workspace)
        self._rows, self._digest = record.stored, record.digest
        if run.every:
            n = run.header.n
            run.q[0, :, 0], run.p[0, :, 0] = record.last[:n], record.last[n : 2 * n]
            run.recorded[0, :, 0] = record.last[2 * n + 1 :]


def checkpoint_exists(path: Path) -> bool:
    """Return whether a checkpoint or its predecessor exists at this path."""
    return path.exists() or path.with_name(f"{path.name}.previous").exists()


def _digest_of(file: Any, size: int) -> Any:
    """Read ``size`` bytes and return their digest."""
    checksum = hashlib.sha256()
    while size > 0:
        block = file.read(min(size, 2**20))
        if not block:
            break
        checksum.update(block)
        size -= len(block)
    return checksum


def read_description(path: Path) -> dict[str, Any]:
    """Read the arguments of a run; raise StorageError if no file is intact."""
    request: dict[str, Any] = _read_first_intact(path, _read_statements)[0]["asked"]
    return request


def read_checkpoint(path: Path) -> CheckpointContent:
    """Read a checkpoint; if it is damaged, warn and read the one before it.

    Raises StorageError if neither file is intact.
    """
    record, problems = _read_first_intact(path, _read_content)
    if problems:
        warn(
            f"{path}: the last checkpoint is damaged ({problems[0]}). The run continues from the "
            "one before.",
            RuntimeWarning,
        )
    return record


def _read_first_intact(
    path: Path, read: Callable[[Path, Path], Content]
) -> tuple[Content, list[str]]:
    """Return the content of the first intact file, and the problems of the files before it."""
    problems: list[str] = []
    for place in (path, path.with_name(f"{path.name}.previous")):
        try:
            return read(place, path.with_name(f"{path.name}.states")), problems
        except (OSError, ValueError, KeyError, TypeError) as error:
            problems.append(f"{place.name}: {getattr(error, 'strerror', None) or error}")
    reject(
        f"no intact checkpoint exists ({'; '.join(problems)}).",
        where=str(path),
        remedy="Start the run again with another file.",
        error=StorageError,
    )


def _read_statements(path: Path, states: Path) -> dict[str, Any]:
    """Read one file; raise ValueError if it has another format or was changed."""
    head, _, body = path.read_text(encoding="utf-8").partition("\n")
    if head != f"{MAGIC} {VERSION} {digest(body)}":
        if not head.startswith(f"{MAGIC} "):
            raise ValueError("not a checkpoint file")
        if not head.startswith(f"{MAGIC} {VERSION} "):
            raise ValueError("format of another version")
        raise ValueError("its digest does not match its content")
    statements: dict[str, Any] = json.loads(body)
    return statements


def _read_content(path: Path, states: Path) -> CheckpointContent:
    """Read one checkpoint and its file of states; raise ValueError if either is damaged."""
    statements = _read_statements(path, states)
    workspace = np.frombuffer(base64.b64decode(statements["workspace"]), dtype="<f8")
    width = 8 * (2 * len(statements["asked"]["q0"]) + 1 + statements["asked"].get("recorded", 0))
    size = statements["stored"] * width
    with open(states, "rb") as file:
        checksum = _digest_of(file, size)
        whole = file.tell() == size
        file.seek(max(0, size - width))
        last = np.frombuffer(file.read(width), dtype="<f8")
    if not whole or checksum.hexdigest() != statements["states"]:
        raise ValueError("its file of states is damaged")
    return CheckpointContent(
        statements["asked"], statements["position"], workspace, statements["stored"], checksum, last
    )


def _sync(folder: Path) -> None:
    """Flush the entries of a folder to disk."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
