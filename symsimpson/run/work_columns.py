"""Work of forces in runs whose modes have different forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from symsimpson.program.recorders import Recorder
from symsimpson.results.mode_history import work_names
from symsimpson.stepping.run import Run
from symsimpson.support.array_types import Reals

if TYPE_CHECKING:
    from symsimpson.program.program import Program


class WorkColumns:
    """A column of work for each force, for each friction element and for moving constraints."""

    def __init__(self, program: Program, first: int, *, works: bool) -> None:
        self.works = works
        self._names = work_names(program, program.modes.elements) if works else ()
        self.before = np.zeros(len(self._names))  # the work of all pieces before this one
        self.rows = slice(first, first + len(self._names))

    def recorders(self) -> list[Recorder]:
        """Return a recorder with a row for each column."""
        first, count = self.rows.start, len(self._names)
        kernel = "energy"  # of the module, as a recorder needs one; it is not called
        return [Recorder(kernel, first, count, count, name="work")] if self.works else []

    def now(self, piece: Run, program: Program) -> Reals:
        """Return the present work, which includes the work of a piece."""
        now = self.before.copy()
        if self.works and program.header.powers:
            now[self._places(program)] += piece.rows("WORK", program.header.powers)
        return now

    def copy(
        self, piece: Run, program: Program, recorded: Reals, every: int, steps: tuple[int, int]
    ) -> None:
        """Copy the work of a piece at the states that it stored in these steps."""
        if not (self.works and every):
            return
        before, last = (step - piece.first for step in steps)
        some = slice(before // every + 1, last // every + 1)
        columns, count = recorded[some, -len(self._names) :, 0], program.header.powers
        columns[:] = self.before
        if count:
            columns[:, self._places(program)] += piece.recorded[some, -count:, 0]

    def end(self, piece: Run, program: Program) -> None:
        """Add the work of a piece, because the next one begins with none."""
        self.before = self.now(piece, program)

    def _places(self, program: Program) -> list[int]:
        names = work_names(program)
        return [self._names.index(name) for name in names]
