"""The compiled loop over steps between which bodies bounce, one impact at a time.

Compiled behind the text of the driver, whose names it uses. Python has a say for all events
(:class:`symsimpson.run.event_run.EventRun`); what is plain is done here by the same rules. Where it
is not (several impacts at one time, a gap that may close and open within a step, a part of a step
that fails), the loop is left behind the step as it was taken, and nothing else has changed.
"""

import numpy as np
from numba import njit, types

from symsimpson.driver.begin import begin
from symsimpson.driver.between import take
from symsimpson.driver.short_run import take_all
from symsimpson.driver.solving import DRIVER_OPTIONS, RARE, call
from symsimpson.driver.steps import (
    DRIVER_LAYOUT_ROWS,
    INPUTS,
    SET,
    SETTING,
    SIGNATURES,
    STORES,
    WORKSPACE,
    store_lane,
)
from symsimpson.module.interface import *

#: A rest of a step below this part of it is none; events that are so near act together.
NOTHING, TOGETHER = 4 * 2.0**-52, 16 * 2.0**-52
#: Rates of gaps below this part of the fastest velocity are none.
STILL = 1e-12
#: Newton's method for the time of an event ends with corrections below this part of the span.
EXACT, MOST_NEWTON = 4 * 2.0**-52, 100
#: A gap is looked at in between where it may come below this part of what it is at the ends.
NEAR = 0.1
#: More impacts within one step may be those that accumulate.
MOST_PLAIN = 3
#: Of each event, where its rate stands among what is asked for, the first of its slopes, its
#: condition (or -1), the size of its terms, and the sign that is waited for.
RATE_AT, SLOPES_AT, WHEN_AT, SIZE_AT, SIGN = range(5)
#: Of each impact that acted: its number, the time, the step, the impulse; then q and p before it
#: and behind it.
EVENT, TIME_OF, STEP_OF, IMPULSE, STATES_OF = range(5)

#: Kernels that take parts of steps, their workspace, and the layout for the driver.
PARTING = types.Tuple((SET, WORKSPACE, DRIVER_LAYOUT_ROWS))
#: What evaluates all that is asked for: prepare, the energy and the kernel; its workspace,
#: the layout for the driver, and how much is asked for.
LOOKING = types.Tuple((types.UniTuple(types.int64, 3), WORKSPACE, DRIVER_LAYOUT_ROWS, types.int64))
#: Numbers of the events, restitutions, the first row of what is watched, records, and how
#: many there are of these.
IMPACTS = types.Tuple(
    (types.int64[:, ::1], types.float64[::1], types.int64, WORKSPACE, types.int64[::1])
)
SIGNATURES |= {
    "take_bouncing": types.void(
        types.Tuple((SET, PARTING, LOOKING)),
        SETTING,
        types.int64[::1],
        types.Tuple((types.int64, types.int64)),
        STORES,
        INPUTS,
        IMPACTS,
    )
}


@njit(**RARE)
def zero_of_cubic(first, last, a, b, side):
    """Return about where from 0 to 1 the cubic changes its side that has these ends and slopes."""
    rest = last - first
    c, d = 3.0 * rest - 2.0 * a - b, a + b - 2.0 * rest
    low, high = 0.0, 1.0
    for _ in range(30):
        x = (low + high) / 2.0
        if (first + x * (a + x * (c + x * d))) * side > 0.0:
            low = x
        else:
            high = x
    return (low + high) / 2.0


@njit(**RARE)
def lowest_of_cubic(first, last, a, b):
    """Return about how low a cubic goes that falls, then rises, by ends and slopes."""
    rest = last - first
    c, d = 3.0 * rest - 2.0 * a - b, a + b - 2.0 * rest
    low, high = 0.0, 1.0
    for _ in range(30):
        x = (low + high) / 2.0
        if a + x * (2.0 * c + x * 3.0 * d) < 0.0:
            low = x
        else:
            high = x
    x = (low + high) / 2.0
    return first + x * (a + x * (c + x * d))


@njit(**RARE)
def look(looking, t, q, p, row):
    """Evaluate all that is asked for at a state; tells whether all of it has a value."""
    (_, energy, kernel), W, at, _ = looking
    for a in range(at[DIMENSION]):
        W[at[POSITION] + a, 0], W[at[MOMENTUM] + a, 0] = q[a], p[a]
    call(energy, 1.0, t, W)
    call(kernel, 1.0, t, W)
    total = 0.0
    for k in range(row.size):
        row[k] = W[at[ROWS] + k, 0]
        total += 0.0 * row[k]
    return total == 0.0


@njit(**RARE)
def through_part(parting, start, t, size, state, room):
    """Go from a state at a time through a part of a step, to the other state; tells if it went."""
    (kernels, W, at), (from_q, from_p), (q, p) = parting, start, state
    for a in range(at[DIMENSION]):
        q[a], p[a] = from_q[a], from_p[a]
    progress, nothing, counted, inputs = room
    return take(
        kernels, (size, t, W, at), 1, (q, p), (inputs, 0), (progress, nothing, counted), False
    )


@njit(**RARE)
def side_of(value, small, before):
    """Return on which side of zero a value is; near it, where it was."""
    return 1.0 if value > small else (-1.0 if value < -small else before)


@njit(**RARE)
def size_of(events, k, row, q, before):
    """Return the size of a gap: that of its terms, or the one before if that is larger."""
    size, terms = row[events[k, SIZE_AT]], 0.0
    for a in range(q.size):
        terms += abs(row[events[k, SLOPES_AT] + a] * q[a])
    return max(before, size, terms)


@njit(**RARE)
def zero_in(means, start, t, span, ends, at_zero, side):
    """Find where from 0 to a span a gap is zero, by Newton's method; tells if it was found.

    Its number among events, and where its rate stands, are in ``at_zero``, with what is asked for
    there, and the state; ``ends`` is what is asked for at both ends.
    """
    (parting, looking, room), (first_row, last_row), (k, place, row, state) = means, ends, at_zero
    first, last = first_row[k], last_row[k]
    low, high, before, met = 0.0, span, 0.0, False
    x = span * zero_of_cubic(first, last, span * first_row[place], span * last_row[place], side)
    tries, well = 0, True
    while well and not met and tries < MOST_NEWTON:
        well = through_part(parting, start, t, x, state, room)
        well = well and look(looking, t + x, state[0], state[1], row)
        value, rate = row[k], row[place]
        if well:
            if value * side > 0.0:
                low = x
            else:
                high = x
            change = -value / rate if rate != 0.0 else np.inf
            left = abs(change) * abs(change) / before if before != 0.0 else np.inf
            falls = rate * span * side <= 0.0
            inside = (x + change - low) * (high - x - change) >= 0.0
            met = falls and abs(change) <= EXACT * abs(span)
            met = met or abs(high - low) <= EXACT * abs(span)
            if not met and falls and inside and left <= EXACT * abs(span):
                # the next correction is rounding: the state there is all that is left to find
                x, met = x + change, True
                well = through_part(parting, start, t, x, state, room)
                well = well and look(looking, t + x, state[0], state[1], row)
            elif not met and inside:
                before, x = abs(change), x + change
            elif not met:
                before, x = 0.0, (low + high) / 2.0
        tries += 1
    return x, well and met and abs(x) > 4.0 * EXACT * abs(span)


@njit(**RARE)
def closing(looking, events, k, row, sign):
    """Return how fast a gap closes at the state that was looked at last, 0 where it is rounding."""
    (_, W, at, _), rate = looking, row[events[k, RATE_AT]]
    terms, rest = 0.0, rate
    for a in range(at[DIMENSION]):
        term = row[events[k, SLOPES_AT] + a] * W[at[VELOCITY] + a, 0]
        terms, rest = terms + abs(term), rest - term
    return -sign * rate if -sign * rate > STILL * max(terms + abs(rest), 1e-300) else 0.0


@njit(**RARE)
def weight_of(looking, events, k, t, row, q):
    """Return n.M^-1 n of the slope n of a gap."""
    (_, energy, _), W, at, _ = looking
    weight = 0.0
    for turn in range(2):
        for a in range(at[DIMENSION]):
            slope = row[events[k, SLOPES_AT] + a]
            W[at[POSITION] + a, 0], W[at[MOMENTUM] + a, 0] = q[a], slope * (1.0 - turn)
        call(energy, 1.0, t, W)
        for a in range(at[DIMENSION]):
            slope, v = row[events[k, SLOPES_AT] + a], W[at[VELOCITY] + a, 0]
            weight += slope * v if turn == 0 else -slope * v
    return weight


@njit(**RARE)
def first_zero(means, start, t, span, rows, sides, events, work):
    """Find the first zero of a gap from 0 to a span: its event, or -1 if there is none, and where.

    It is -2 if the zero is not plain. In ``work`` is left what is asked for there, and the state.
    """
    (side, size, near), (row, state), count = sides, work, events.shape[0]
    (first, last, q), (parting, looking, room) = rows, means
    event, place, zeros = -1, span, 0
    for k in range(count):
        rate = events[k, RATE_AT]
        behind = side_of(last[k], ZERO * size_of(events, k, last, q, size[k]), side[k])
        sign = events[k, SIGN]
        met = side[k] * behind < 0.0 and (sign == 0 or behind == sign)
        falls, rises = span * first[rate], span * last[rate]
        least = min(first[k], last[k])
        if met:
            at_zero = k, rate, row, state
            x, well = zero_in(means, start, t, span, (first, last), at_zero, side[k])
            if not well or (event >= 0 and abs(x - place) <= near):
                return -2, 0.0
            zeros += 1
            if event == -1 or abs(x) < abs(place):
                event, place = k, x
        elif (
            least > ZERO * size[k]
            and falls < 0.0
            and rises > 0.0
            and lowest_of_cubic(first[k], last[k], falls, rises) < NEAR * least
        ):
            return -2, 0.0
    if zeros > 1:  # the last one that was looked for need not be the first
        well = through_part(parting, start, t, place, state, room)
        if not well or not look(looking, t + place, state[0], state[1], row):
            return -2, 0.0
    return event, place


@njit(**RARE)
def bounce(means, setting, step, impacts, sides):
    """Take a step with its impacts, from where the workspace says that it began.

    Returns whether they are plain, or there is none; then the state behind it stands in what was
    made for it, and sides and sizes are those behind it.
    """
    (h, t0, W, at), (events, restitution, _, records, counts) = setting, impacts
    (side, size, state, there, behind, first, last, row), n = sides, at[DIMENSION]
    shift = at[PREVIOUS] - at[POSITION]
    (q, p), (parting, looking, room) = state, means
    for a in range(n):
        q[a], p[a] = W[at[POSITION] + shift + a, 0], W[at[MOMENTUM] + shift + a, 0]
        behind[0][a], behind[1][a] = W[at[POSITION] + a, 0], W[at[MOMENTUM] + a, 0]
    done, acted, over, near = 0.0, 0, False, TOGETHER * max(abs(t0 + h), abs(h))
    well = look(looking, t0, q, p, first)
    while well and not over:
        t, rest = t0 + done, h - done
        if acted > 0:  # else it is the step as it was taken
            well = acted <= MOST_PLAIN and through_part(parting, state, t, rest, behind, room)
        well = well and look(looking, t0 + h, behind[0], behind[1], last)
        k, x = -2, 0.0
        if well:
            now, work, ends = (side, size, near), (row, there), (first, last, behind[0])
            k, x = first_zero(means, state, t, rest, ends, now, events, work)
        well = k != -2
        if well and k == -1:
            over = True
            for k in range(events.shape[0]):
                before, size[k] = side[k], size_of(events, k, last, behind[0], size[k])
                side[k] = side_of(last[k], ZERO * size[k], before)
                well = well and (acted > 0 or side[k] == before)
        elif well:
            t += x
            well = counts[0] + acted < records.shape[0] and abs(rest - x) > NOTHING * abs(h)
            well = well and (events[k, WHEN_AT] < 0 or row[events[k, WHEN_AT]] > 0.0)
            for other in range(events.shape[0]):
                well = well and (other == k or abs(row[other]) > ZERO * size[other])
            sign, speed, weight = 1.0 if h > 0.0 else -1.0, 0.0, 0.0
            if well:
                speed = closing(looking, events, k, row, sign)
                weight = weight_of(looking, events, k, t, row, there[0])
                well = speed > 0.0 and weight > 0.0
            if well:
                impulse = (1.0 + restitution[k]) * sign * speed / weight
                kept = records[counts[0] + acted]
                kept[EVENT], kept[TIME_OF], kept[STEP_OF], kept[IMPULSE] = k, t, step, impulse
                for a in range(n):
                    q[a], p[a] = there[0][a], there[1][a] + impulse * row[events[k, SLOPES_AT] + a]
                    kept[STATES_OF + a], kept[STATES_OF + n + a] = there[0][a], there[1][a]
                    kept[STATES_OF + 2 * n + a], kept[STATES_OF + 3 * n + a] = q[a], p[a]
                done, acted = done + x, acted + 1
                well = look(looking, t, q, p, first)
                well = well and closing(looking, events, k, first, sign) == 0.0
    counts[0] += acted if well else 0
    return well


@njit(**DRIVER_OPTIONS)
def take_bouncing(sets, setting, progress, asked, stores, inputs, impacts):
    """Take steps as ``take_steps`` does, and those with plain impacts in them.

    Leaves where an impact is not plain, behind the step as it was taken, or where there is no room
    for a record. ``asked`` are where to stop and how many steps lie between stored states.
    """
    (kernels, parting, looking), (h, t0, W, at), (stop, every) = sets, setting, asked
    (events, _, watched, records, counts), n = impacts, at[DIMENSION]
    (prepare, _, _), W_look, _, width = looking
    number = events.shape[0]
    side, size = np.empty(number), np.empty(number)
    state, there = (np.empty(n), np.empty(n)), (np.empty(n), np.empty(n))
    behind, first, last, row = (
        (np.empty(n), np.empty(n)),
        np.empty(width),
        np.empty(width),
        np.empty(width),
    )
    room = (
        np.zeros(4, dtype=np.int64),
        np.empty((1, 1, 1)),
        np.empty((1, 1), dtype=np.int64),
        inputs,
    )
    call(prepare, 1.0, 0.0, W_look)
    more = True
    while more:
        take_all(kernels, setting, progress, stop, every, stores, inputs)
        more = progress[1] == 0 and W[at[STATUS], 0] == MET and counts[0] < records.shape[0]
        step, before = progress[2] + progress[0] - 1, counts[0]
        if more:
            for k in range(number):
                side[k] = W[watched + WATCHED * k, 0]
                size[k] = W[watched + WATCHED * k + SIZE_WATCHED, 0]
            rows = side, size, state, there, behind, first, last, row
            here = h, t0 + h * step, W, at
            more = bounce((parting, looking, room), here, step, impacts, rows)
        t = t0 + h * (step + 1)
        if more and counts[0] == before:  # the step stays as it was taken
            W[at[STATUS], 0], W[at[ACTIVE], 0] = 0.0, 1.0
            for k in range(RECORDERS + at[OF_EVENTS], len(kernels) - at[OF_STATES]):
                call(kernels[k], h, t0 + h * step, W)
        elif more:
            iterations = W[at[ITERATIONS], 0]
            for k in range(4 * n):
                W[at[POSITION] + k, 0] = 0.0
            for a in range(n):
                W[at[POSITION] + a, 0], W[at[MOMENTUM] + a, 0] = behind[0][a], behind[1][a]
            begin(kernels, 0, h, t, W, at)
            W[at[ITERATIONS], 0], W[at[ACTIVE], 0] = iterations, 1.0
        if more:
            for k in range(number):
                place, value = watched + WATCHED * k, last[k]
                W[place, 0], W[place + 1, 0], W[place + 2, 0] = (
                    side[k],
                    max(size[k], abs(value)),
                    value,
                )
                W[place + 3, 0] = value - h * last[events[k, RATE_AT]]
            for k in range(len(kernels) - at[OF_STATES], len(kernels)):
                call(kernels[k], h, t, W)
            if every != 0 and progress[0] % every == 0:
                store_lane(W, at, progress[0] // every, 0, stores)
