"""Dense output of runs with contacts and dry friction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.results.interpolate import DenseOutput
from symsimpson.results.mode_history import Piece, check_whole
from symsimpson.results.states import FinishedRun
from symsimpson.stepping.parts import PartialSteps
from symsimpson.support.array_types import Reals


class DenseOutputOfModes(DenseOutput):
    """The dense output of a run with contacts or friction: each piece has its own mode."""

    def __init__(self, run: FinishedRun) -> None:
        check_whole(run)
        super().__init__(run)

    def after(
        self, start: NDArray[np.int64], later: Reals
    ) -> tuple[Reals, Reals, NDArray[np.int64]]:
        """Return q, p and a status at the times ``later`` after the stored states ``start``."""
        run: Any = self._run
        t = np.asarray(run.t[start] + later, dtype=float)
        q, p = np.zeros((2, len(start), run.program.n))
        codes = np.zeros(len(start), dtype=np.int64)
        places = run.history.places(t)
        for i, place in enumerate(places.tolist()):
            if later[i] == 0:
                q[i], p[i] = run.q[start[i]], run.p[start[i]]
                continue
            (q[i], p[i]), codes[i] = self._in_piece(run.history.pieces[place], start[i], t[i])
        return q, p, codes

    def _in_piece(self, piece: Piece, start: int, t: float) -> tuple[Any, Any]:
        """Return the state at a time in a piece, from the last stored state or its beginning."""
        run, h, sign = self._run, float(self._run.h), self._sign
        first, every = float(run.t[0]), run.every or 1
        step, at, state = int(start) * every, float(run.t[start]), (run.q[start], run.p[start])
        for record in run.records:  # events of the user that do not change the mode
            if sign * at <= sign * record.t <= sign * t and sign * record.t >= sign * piece.t:
                step, at, state = record.step, record.t, (record.q_after, record.p_after)
        if sign * piece.t > sign * at:
            step, at, state = piece.step, piece.t, piece.state
        assert piece.program is not None
        parts = PartialSteps(piece.program, piece.values, h, run.input_values)
        status: Any = 0
        while sign * (t - at) > 0 and status == 0:
            end = first + h * (step + 1)
            part = (end if sign * end < sign * t else t) - at
            state, status = parts(state, at, part, step, (at - first) / h - step)
            at, step = at + part, step + 1
        return state, status
