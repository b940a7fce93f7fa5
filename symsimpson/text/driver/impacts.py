"""Events within steps: their location, and the loop over steps with single impacts.

This file is compiled together with the text of the driver and uses its names. This code locates all
events. Python (:class:`symsimpson.run.event_run.EventRun`) handles all events that are not plain
impacts, by the same rules. Impacts are not plain if several act at one time, or if a part of a step
fails. Then the loop returns after the whole step, without a change of the state.
"""

import numpy as np
from numba import njit, types

from symsimpson.text.driver.between import take
from symsimpson.text.driver.short_run import take_all
from symsimpson.text.driver.steps import *
from symsimpson.text.interface import *

#: A rest of a step below this part of it is none; events that are so near act together.
NOTHING, TOGETHER = 4 * 2.0**-52, 16 * 2.0**-52
#: Rates of gaps below this part of the fastest velocity are none.
STILL = 1e-12
#: Newton's method for the time of an event ends with corrections below this part of the span.
EXACT, MOST_NEWTON = 4 * 2.0**-52, 100
#: Where a gap is lowest is known to this part of the span.
LOWEST = 1e-9
#: So near to a start at zero, relative to the span, an expression is looked at to begin there; one
#: that stays above a part of the values around its change of sign is not zero, but jumps.
NEARBY, JUMP = 1e-6, 1e-6
#: The least number that is not rounded to zero.
TINY = 2.0**-1022
#: The most plain impacts within one step; more of them may accumulate.
MOST_PLAIN = 3
#: Columns of an event: among all expressions its rate and the first of its slopes (-1 if it has
#: none), its condition (or -1), and the size of its terms; then the sign to wait for.
RATE_AT, SLOPES_AT, WHEN_AT, SIZE_AT, SIGN = range(5)
#: Columns of a record: the number of the event, the time, the step, the impulse; then q and p
#: before and after the impact.
EVENT, TIME_OF, STEP_OF, IMPULSE, STATES_OF = range(5)

#: Kernels that take parts of steps, their workspace, and the layout for the driver.
PARTING = types.Tuple((SET, WORKSPACE, DRIVER_LAYOUT_ROWS))
#: The evaluation of all expressions: addresses of prepare, the energy and the kernel; a prepared
#: workspace, the layout for the driver, and the number of expressions.
LOOKING = types.Tuple((types.UniTuple(types.int64, 3), WORKSPACE, DRIVER_LAYOUT_ROWS, types.int64))
#: Progress of parts of steps, where nothing is stored, how many were lost, and inputs.
ROOM = types.Tuple((types.int64[::1], STATES, COUNTS, INPUTS))
ROW = types.float64[::1]
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
    ),
    "locate": types.int64(
        types.Tuple((PARTING, LOOKING, ROOM)),
        types.UniTuple(ROW, 2),
        types.float64,
        types.float64,
        types.UniTuple(ROW, 3),
        types.UniTuple(ROW, 3),
        types.int64[:, ::1],
        types.Tuple((ROW, types.UniTuple(ROW, 2))),
    ),
}


@njit(**RARE)
def zero_of_cubic(first, last, a, b, side):
    """Return the approximate zero in 0..1 of the cubic with these end values and slopes."""
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
def look(looking, t, q, p, row):
    """Evaluate all expressions at a state; return whether all values are finite."""
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
def try_part_of_step(parting, start, t, size, state, room):
    """Take a part of a step from one state to the other; return whether it succeeded."""
    (kernels, W, at), (from_q, from_p), (q, p) = parting, start, state
    for a in range(at[DIMENSION]):
        q[a], p[a] = from_q[a], from_p[a]
    progress, nothing, counted, inputs = room
    here, aside = (size, t, W, at), (progress, nothing, counted)
    return size == 0.0 or take(kernels, here, 1, (q, p), (inputs, 0), aside, False)


@njit(**RARE)
def sign_of(value, small, before):
    """Return the sign of a value; a value near zero keeps its sign before."""
    return 1.0 if value > small else (-1.0 if value < -small else before)


@njit(**RARE)
def expression_size(events, k, row, q, before):
    """Return the size of an expression: of its terms, or the decayed size before."""
    size, terms, gap = row[events[k, SIZE_AT]], 0.0, events[k, SLOPES_AT] >= 0
    for a in range(q.size if gap else 0):
        terms += abs(row[events[k, SLOPES_AT] + a] * q[a])
    return max(before if gap else FADED * before, size, terms)


@njit(**RARE)
def value_at(means, start, t, x, place, work):
    """Return a value after a part of a step; if the part fails, count that and return NaN."""
    (parting, looking, room), (row, state) = means, work
    if not try_part_of_step(parting, start, t, x, state, room):
        room[2][0, 0] += 1
        return np.nan
    look(looking, t + x, state[0], state[1], row)
    return row[place]


@njit(**RARE)
def ridders(means, start, t, span, ends, place, size, work):
    """Find the zero of a value in a span, to this size; NaN if a value is not finite.

    C. Ridders, IEEE Transactions on Circuits and Systems 26 (1979) 979.
    """
    (low, high), (first, last) = span, ends
    while abs(high - low) > size:
        middle = (low + high) / 2.0
        value = value_at(means, start, t, middle, place, work)
        root = np.sqrt(value * value - first * last)
        if not root < np.inf:
            return np.nan
        if value == 0.0 or not (middle - low) * (high - middle) > 0.0:
            return middle
        share = abs(value) / root if root > 0.0 else 0.0
        x = middle + (middle - low) * (share if (first > 0.0) == (value > 0.0) else -share)
        there = value_at(means, start, t, x, place, work)
        if not abs(there) < np.inf:
            return np.nan
        if (x - middle) * (high - low) < 0.0:
            x, there, middle, value = middle, value, x, there
        # the smallest bracket among low, middle, x and high, which are in this order
        if (first > 0.0) != (value > 0.0) or value == 0.0:
            high, last = middle, value
        elif (value > 0.0) != (there > 0.0) or there == 0.0:
            low, first, high, last = middle, value, x, there
        else:
            low, first = x, there
        if last == 0.0:
            return high
    return (low + high) / 2.0


@njit(**RARE)
def zero_by_rate(means, start, t, span, ends, places, side, work):
    """Find the zero of a gap between 0 and a span; NaN if a value is not finite.

    ``ends`` has the gap and its rate at both ends, and ``places`` their columns. Newton's method
    begins at the zero of a cubic, and bisects if it leaves the bracket.
    """
    ((first, down), (last, up)), (k, rate_at) = ends, places
    low, high, before, met, tries = 0.0, span, 0.0, False, 0
    x = span * zero_of_cubic(first, last, span * down, span * up, side)
    while not met and tries < MOST_NEWTON:
        value = value_at(means, start, t, x, k, work)
        rate = work[0][rate_at]
        if not abs(value) < np.inf:
            return np.nan
        if value * side > 0.0:
            low = x
        else:
            high = x
        change = -value / rate if rate != 0.0 else np.inf
        # slopes of the scheme differ from the rate: convergence is linear
        left = abs(change) * abs(change) / before if before != 0.0 else np.inf
        falls = rate * span * side <= 0.0
        inside = (x + change - low) * (high - x - change) >= 0.0
        fine = falls and min(left, abs(change)) <= EXACT * abs(span)
        met = fine or abs(high - low) <= EXACT * abs(span)
        if met and inside and change != 0.0:
            # the next correction is rounding: the state there is all that is left to find
            x += change
            value_at(means, start, t, x, k, work)
        elif not met and inside:
            before, x = abs(change), x + change
        elif not met:
            before, x = 0.0, (low + high) / 2.0
        tries += 1
    return 0.0 if abs(x) <= 4.0 * EXACT * abs(span) else x


@njit(**RARE)
def zero_without_rate(means, start, t, span, ends, k, side, work):
    """Find the zero of an expression without a rate between 0 and a span; NaN if it jumps."""
    (first, last), low, size = ends, 0.0, EXACT * abs(span)
    if abs(first) < NEARBY * abs(last):  # rounding: it begins a little later
        there = value_at(means, start, t, NEARBY * span, k, work)
        if there * side > first:
            low, first = NEARBY * span, there
    x = ridders(means, start, t, (low, span), (first, last), k, size, work)
    most = JUMP * (abs(first) + abs(last))
    return x if x == x and abs(value_at(means, start, t, x, k, work)) <= most else np.nan


@njit(**RARE)
def find_dip(means, start, t, span, ends, places, small, work):
    """Find the minimum of a gap that is negative only within a span; NaN if there is none."""
    (first, last), (k, rate), x = ends, places, np.nan
    if min(first[k], last[k]) > small and span * first[rate] < 0.0 and span * last[rate] > 0.0:
        rates, size = (first[rate], last[rate]), LOWEST * abs(span)
        x = ridders(means, start, t, (0.0, span), rates, rate, size, work)
    return x if x == x and value_at(means, start, t, x, k, work) < -small else np.nan


@njit(**RARE)
def closing_speed(looking, events, k, row, sign):
    """Return the closing speed of a gap at the last evaluated state; 0 if it is rounding."""
    (_, W, at, _), rate = looking, row[events[k, RATE_AT]]
    terms, rest = 0.0, rate
    for a in range(at[DIMENSION]):
        term = row[events[k, SLOPES_AT] + a] * W[at[VELOCITY] + a, 0]
        terms, rest = terms + abs(term), rest - term
    return -sign * rate if -sign * rate > STILL * max(terms + abs(rest), 1e-300) else 0.0


@njit(**RARE)
def impact_weight(looking, events, k, t, row, q):
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
def locate(means, start, t, span, ends, sides, events, work):
    """Find the first event within a span of a step; return its number, or -1 for no event.

    ``ends`` has all expressions at both ends, and q at the last one. ``sides`` has their signs and
    sizes, and an array for zeros. This finds sign changes, and gaps that are negative only within
    the span. An entry of that array other than NaN is the end of the span for its event. ``work``
    takes the state at the first zero, with all expressions. Return -2 if a part of a step fails.
    """
    (first, last, q), (side, size, zeros) = ends, sides
    lost, earliest, tried = means[2][2], -1, 0
    lost[0, 0] = 0
    for k in range(events.shape[0]):
        after = sign_of(last[k], ZERO * expression_size(events, k, last, q, size[k]), side[k])
        sign, rate = events[k, SIGN], events[k, RATE_AT]
        if side[k] * after < 0.0 and (sign == 0 or after == sign):
            zeros[k] = span
        elif events[k, SLOPES_AT] >= 0:
            rows, small = (first, last), ZERO * size[k]
            zeros[k] = find_dip(means, start, t, span, rows, (k, rate), small, work)
    for k in range(events.shape[0]):
        if zeros[k] == zeros[k]:
            tried, until, rate = tried + 1, zeros[k], events[k, RATE_AT]
            then, up = last[k], last[rate]
            if until != span:
                then = value_at(means, start, t, until, k, work)
                up = work[0][rate]
            # rounding may have moved the start past zero
            now = first[k] if first[k] * side[k] > 0.0 else side[k] * TINY
            if events[k, SLOPES_AT] < 0:
                zeros[k] = zero_without_rate(means, start, t, until, (now, then), k, side[k], work)
            else:
                both = (now, first[rate]), (then, up)
                zeros[k] = zero_by_rate(means, start, t, until, both, (k, rate), side[k], work)
            if zeros[k] == zeros[k] and (earliest < 0 or abs(zeros[k]) < abs(zeros[earliest])):
                earliest = k
    if earliest >= 0 and (tried > 1 or zeros[earliest] == 0.0):  # the last evaluation was elsewhere
        value_at(means, start, t, zeros[earliest], earliest, work)
    return earliest if lost[0, 0] == 0 else -2


@njit(**RARE)
def take_impacts(means, setting, step, impacts, sides):
    """Repeat a step with its impacts, from its initial state in the workspace.

    Return whether all impacts are plain, or there is none. Then ``behind`` has the state after the
    step, and the arrays in ``sides`` have signs and sizes there.
    """
    (h, t0, W, at), (events, restitution, _, records, counts) = setting, impacts
    (side, size, zeros, state, there, behind, first, last, row), n = sides, at[DIMENSION]
    shift = at[PREVIOUS] - at[POSITION]
    (q, p), (parting, looking, room) = state, means
    for a in range(n):
        q[a], p[a] = W[at[POSITION] + shift + a, 0], W[at[MOMENTUM] + shift + a, 0]
        behind[0][a], behind[1][a] = W[at[POSITION] + a, 0], W[at[MOMENTUM] + a, 0]
    done, acted, over, near = 0.0, 0, False, TOGETHER * max(abs(t0 + h), abs(h))
    well = look(looking, t0, q, p, first)
    while well and not over:
        t, rest = t0 + done, h - done
        if acted > 0:  # else the whole step is known
            well = acted <= MOST_PLAIN and try_part_of_step(parting, state, t, rest, behind, room)
        well = well and look(looking, t0 + h, behind[0], behind[1], last)
        k = -2
        if well:
            for j in range(events.shape[0]):
                zeros[j] = np.nan
            ends, work = (first, last, behind[0]), (row, there)
            k = locate(means, state, t, rest, ends, (side, size, zeros), events, work)
        well = k != -2
        if well and k == -1:
            over = True
            for k in range(events.shape[0]):
                before, size[k] = side[k], expression_size(events, k, last, behind[0], size[k])
                side[k] = sign_of(last[k], ZERO * size[k], before)
                well = well and (acted > 0 or side[k] == before)
        elif well:
            x = zeros[k]
            t += x
            well = counts[0] + acted < records.shape[0] and abs(rest - x) > NOTHING * abs(h)
            well = well and x != 0.0
            well = well and (events[k, WHEN_AT] < 0 or row[events[k, WHEN_AT]] > 0.0)
            for other in range(events.shape[0]):
                apart = not abs(zeros[other] - x) <= near and abs(row[other]) > ZERO * size[other]
                well = well and (other == k or apart)
            sign, speed, weight = 1.0 if h > 0.0 else -1.0, 0.0, 0.0
            if well:
                speed = closing_speed(looking, events, k, row, sign)
                weight = impact_weight(looking, events, k, t, row, there[0])
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
                well = well and closing_speed(looking, events, k, first, sign) == 0.0
    counts[0] += acted if well else 0
    return well


@njit(**DRIVER_OPTIONS)
def take_bouncing(sets, setting, progress, asked, stores, inputs, impacts):
    """Take steps like ``take_steps``, including steps with plain impacts.

    Return after a step with an impact that is not plain, or if there is no room for a record.
    ``asked`` has the last step, and the number of steps between stored states.
    """
    (kernels, parting, looking), (h, t0, W, at), (stop, every) = sets, setting, asked
    (events, _, watched, records, counts), n = impacts, at[DIMENSION]
    number, width = events.shape[0], looking[3]
    side, size, zeros = np.empty(number), np.empty(number), np.empty(number)
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
    more = True
    while more:
        take_all(kernels, setting, progress, stop, every, stores, inputs)
        more = progress[1] == 0 and W[at[STATUS], 0] == MET and counts[0] < records.shape[0]
        step, before = progress[2] + progress[0] - 1, counts[0]
        if more:
            for k in range(number):
                side[k] = W[watched + WATCHED * k, 0]
                size[k] = W[watched + WATCHED * k + SIZE_WATCHED, 0]
            rows = side, size, zeros, state, there, behind, first, last, row
            here = h, t0 + h * step, W, at
            more = take_impacts((parting, looking, room), here, step, impacts, rows)
        t = t0 + h * (step + 1)
        if more and counts[0] == before:  # the step does not change
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
