"""Objects on a map of logits: the places where some class is likelier than nothing, by more than
anywhere near.

    score[y, x] = max over classes k of map[k, y, x] - map[nothing, y, x]
    peak[y, x]  = score[y, x] > 0, and no score within NEAR rows and columns is larger; of equal ones the first, by rows

Nothing is the map's last channel. Scores and peaks are kept: scores are computed where the map has
changed, peaks within NEAR of that. Each peak is an object, of the likeliest class there. Its
position is the mean of the places within one row and column of the peak, weighted by their scores
where these are positive. Objects are listed from the likeliest on.

An object has the number of an earlier one that is nearer than a given reach, or a new number: the
likeliest object takes the nearest one, then the next object. Of equally near ones it takes the one
seen last, and of those of one decision the likeliest.

What is remembered has limited room. The objects of a decision are remembered first, then those that
were seen before and are not found now: where there is no room for all, those that were seen longest
ago are forgotten. However many false objects come and go, an object that is found in each decision
keeps its number.
"""

import numpy as np

from async_tnt.kernels.jit import compiled, compiled_without_gil
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import EVERY_BIT, FIRST_ROW, LAST_ROW, MAX_ROW, WORDS
from async_tnt.kernels.network.empty_window import begin_window
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import sync_input
from async_tnt.kernels.simd import trailing_zeros
from async_tnt.kernels.volume import state as S

NEAR = 1
MOST_TRACKED = 256
"""Objects, the likeliest, that may have the number of an earlier one."""

# `about`, int64: how the map lies in memory, and what is known of it
FIRST = 0  # where its place (0, 0) begins
DY = 1  # numbers from one row to the next
DX = 2
DK = 3  # from one channel to the next
ROWS = 4
COLUMNS = 5
CHANNELS = 6
NOT_FINITE = 7  # places with a logit that is not finite
# and behind it, of each step that writes the map: where in the program the record of its changes
# begins
N_SOURCES = 8
ABOUT_SIZE = 9

# `found`, float64: a row for each object
X, Y, PROBABILITY, CLASS, NUMBER = range(5)  # x, y in sensor pixels
FOUND_SIZE = 5

# `tracks`, float64: rows of four; the first ones are headers, the others objects of earlier
# decisions
# in the first row: how many, the next number, how long they are remembered
N_KNOWN, NEXT_NUMBER, MEMORY_US = range(3)
# in the second: where on the sensor places lie, (x0 + dx column, y0 + dy row)
X0, DX_PX, Y0, DY_PX = range(4)
REACH_X, REACH_Y = range(2)  # in the third, in pixels
# the first of them: number, x, y, time. Those seen last come last; of one decision, the likeliest
KNOWN = 3


@compiled_without_gil
def locate_cells(
    buffer,
    program,
    weights,
    maps,
    places,
    about,
    scores,
    peaks,
    probabilities,
    found,
    tracks,
    time_us,
    keep,
):
    """The objects of a volume's `state`; only what has changed since the last call is computed.

    Parameters
    ----------
    buffer : float64, the volume's `state`. Only read.
    program, weights, maps, places : the network's, see `program`. Updated in place.
    about, scores, peaks, probabilities, found, tracks, time_us, keep : see `locate_on_map`.

    Returns
    -------
    int : objects; -1 if a logit is not finite.
    """
    epoch = buffer.view(np.int64)[S.EPOCH]
    if program[P.EPOCH] != epoch:
        begin_window(epoch, program, weights, maps, places)
        _follow_changes(program, places.view(np.uint64), maps, about, scores, peaks)
    sync_input(buffer, program, maps, places)
    forward(program, weights, maps, places)
    _follow_changes(program, places.view(np.uint64), maps, about, scores, peaks)
    return list_objects(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep)


@compiled_without_gil
def locate_on_map(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep):
    """The objects of a whole map.

    Parameters
    ----------
    maps : float32, with the map as `about` tells.
    about : int64, see above.
    scores : float64, (rows, columns). Overwritten.
    peaks : uint64, (rows, words): a bit for each place. Overwritten.
    probabilities : float64, (n, channels). Overwritten, a row for each object: softmax of the
        logits at its peak.
    found : float64, (n, FOUND_SIZE). Overwritten, likewise.
    tracks : float64, (KNOWN + m, 4). Updated in place if `keep`: the m objects seen last.
    time_us : int. Of the decision.
    keep : bool. Whether these objects, and their numbers, are remembered.

    Returns
    -------
    int : objects; -1 if a logit is not finite.
    """
    score_map(maps, about, scores, peaks)
    return list_objects(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep)


@compiled
def score_map(maps, about, scores, peaks):
    """Scores and peaks of a whole map."""
    for y in range(about[ROWS]):
        for x in range(about[COLUMNS]):
            _score(maps, about, scores, y, x)
    for y in range(about[ROWS]):
        for word in range(peaks.shape[1]):
            _note_peaks(scores, peaks, y, word, EVERY_BIT)


@compiled
def _follow_changes(program, bits, maps, about, scores, peaks):
    """Scores where the map has changed in the last `forward`, peaks where these reach."""
    sources = about[ABOUT_SIZE : ABOUT_SIZE + about[N_SOURCES]]
    top, bottom = np.int64(MAX_ROW), np.int64(-1)
    for record in sources:
        top, bottom = min(top, program[record + FIRST_ROW]), max(bottom, program[record + LAST_ROW])
    n_words = peaks.shape[1]
    for y in range(top, bottom + 1):
        for word in range(n_words):
            changed = _changed(program, bits, sources, y, y, word)
            while changed != 0:
                _score(maps, about, scores, y, 64 * word + trailing_zeros(changed))
                changed &= changed - np.uint64(1)
    for y in range(max(0, top - NEAR), min(about[ROWS], bottom + NEAR + 1)):
        before, now = np.uint64(0), _changed(program, bits, sources, y - NEAR, y + NEAR, 0)
        for word in range(n_words):
            after = (
                _changed(program, bits, sources, y - NEAR, y + NEAR, word + 1)
                if word + 1 < n_words
                else np.uint64(0)
            )
            reached = now
            for k in range(1, NEAR + 1):
                n, rest = np.uint64(k), np.uint64(64 - k)
                reached |= now << n | before >> rest | now >> n | after << rest
            before, now = now, after
            _note_peaks(scores, peaks, y, word, reached)


@compiled
def _changed(program, bits, sources, first, last, word):
    """A bit for each column of a word where one of the rows from `first` to `last` has changed."""
    changed = np.uint64(0)
    for record in sources:
        begin, end = max(first, program[record + FIRST_ROW]), min(last, program[record + LAST_ROW])
        for y in range(begin, end + 1):
            changed |= bits[np.uint64(program[record] + y * program[record + WORDS] + word)]
    return changed


@compiled
def _score(maps, about, scores, y, x):
    """The score of a place, nan where a logit is not finite. In float64, where no difference
    overflows."""
    n_classes = about[CHANNELS] - 1
    at = about[FIRST] + y * about[DY] + x * about[DX]
    nothing = maps[np.uint64(at + n_classes * about[DK])]
    best, finite = maps[np.uint64(at)], np.isfinite(nothing)
    for k in range(n_classes):
        logit = maps[np.uint64(at + k * about[DK])]
        finite &= np.isfinite(logit)
        best = max(best, logit)
    score = np.float64(best) - np.float64(nothing) if finite else np.nan
    about[NOT_FINITE] += np.int64(np.isnan(score)) - np.int64(np.isnan(scores[y, x]))
    scores[y, x] = score


@compiled
def _note_peaks(scores, peaks, y, word, which):
    """Which of these places, a bit each of a word, are peaks."""
    columns, left, found = scores.shape[1], which, np.uint64(0)
    while left != 0:
        bit = trailing_zeros(left)
        x = 64 * word + bit
        if x < columns and scores[y, x] > 0 and _is_peak(scores, y, x):
            found |= np.uint64(1) << np.uint64(bit)
        left &= left - np.uint64(1)
    peaks[y, word] = peaks[y, word] & ~which | found


@compiled
def _is_peak(scores, y, x):
    rows, columns = scores.shape
    score = scores[y, x]
    for near_y in range(max(0, y - NEAR), min(rows, y + NEAR + 1)):
        for near_x in range(max(0, x - NEAR), min(columns, x + NEAR + 1)):
            is_before = near_y < y or (near_y == y and near_x < x)
            other = scores[near_y, near_x]
            if other > score or (is_before and other == score):
                return False
    return True


@compiled
def list_objects(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep):
    if about[NOT_FINITE] > 0:
        return -1
    n = np.int64(0)  # a literal 0 would have `_number` compiled twice
    for y in range(peaks.shape[0]):
        for word in range(peaks.shape[1]):
            left = peaks[y, word]
            while left != 0:
                x = 64 * word + trailing_zeros(left)
                best = _softmax_at(maps, about, y, x, probabilities[n])
                found[n, PROBABILITY], found[n, CLASS] = probabilities[n, best], best
                _position_at(scores, y, x, tracks[1], found[n])
                left &= left - np.uint64(1)
                n += 1
    _sort(probabilities, found, n)
    _number(found, n, tracks, time_us, keep)
    return n


@compiled
def _softmax_at(maps, about, y, x, probabilities):
    """Returns the likeliest class, the first of several."""
    at = about[FIRST] + y * about[DY] + x * about[DX]
    largest = maps[at]
    for k in range(about[CHANNELS]):
        largest = max(largest, maps[at + k * about[DK]])
    best, total = 0, 0.0
    for k in range(about[CHANNELS]):
        probabilities[k] = np.exp(np.float64(maps[at + k * about[DK]]) - np.float64(largest))
        total += probabilities[k]
        if k < about[CHANNELS] - 1 and maps[at + k * about[DK]] > maps[at + best * about[DK]]:
            best = k
    for k in range(about[CHANNELS]):
        probabilities[k] /= total
    return best


@compiled
def _position_at(scores, y, x, on_sensor, row):
    """Of a peak."""
    total = sum_x = sum_y = 0.0
    for near_y in range(max(0, y - 1), min(scores.shape[0], y + 2)):
        for near_x in range(max(0, x - 1), min(scores.shape[1], x + 2)):
            weight = max(scores[near_y, near_x], 0.0)
            total += weight
            sum_x += weight * (near_x - x)
            sum_y += weight * (near_y - y)
    row[X] = on_sensor[X0] + on_sensor[DX_PX] * (x + sum_x / total)
    row[Y] = on_sensor[Y0] + on_sensor[DY_PX] * (y + sum_y / total)


@compiled
def _sort(probabilities, found, n):
    """The likeliest first. Shell's sort: a map of noise may have thousands."""
    step = 1
    while 3 * step + 1 < n:
        step = 3 * step + 1
    while step > 0:
        for last in range(step, n):
            k = last
            while k >= step and found[k - step, PROBABILITY] < found[k, PROBABILITY]:
                _swap(found, k, k - step)
                _swap(probabilities, k, k - step)
                k -= step
        step //= 3


@compiled
def _swap(rows, i, k):
    for c in range(rows.shape[1]):
        rows[i, c], rows[k, c] = rows[k, c], rows[i, c]


@compiled
def _number(found, n, tracks, time_us, keep):
    n_known = np.int64(tracks[0, N_KNOWN])
    taken = np.zeros(n_known, np.bool_)
    following = tracks[0, NEXT_NUMBER]
    for i in range(n):
        nearest, least = -1, 1.0
        for j in range(n_known - 1 if i < MOST_TRACKED else -1, -1, -1):
            across = (found[i, X] - tracks[KNOWN + j, 1]) / tracks[2, REACH_X]
            down = (found[i, Y] - tracks[KNOWN + j, 2]) / tracks[2, REACH_Y]
            away = across * across + down * down
            is_old = time_us - tracks[KNOWN + j, 3] > tracks[0, MEMORY_US]
            if away < least and not taken[j] and not is_old:
                nearest, least = j, away
        if nearest >= 0:
            taken[nearest] = True
            found[i, NUMBER] = tracks[KNOWN + nearest, 0]
        else:
            found[i, NUMBER] = following
            following += 1
    if keep:
        tracks[0, NEXT_NUMBER] = following
        _remember(found, n, tracks, taken, time_us)


@compiled
def _remember(found, n, tracks, taken, time_us):
    """Keep in `tracks` the objects of this decision, and as many of the stale ones as there is room
    for.

    An object is stale if it was known and is not `taken` now. One that was last seen too long ago
    is forgotten.
    """
    n_present = min(n, MOST_TRACKED, len(tracks) - KNOWN)
    n_stale = 0
    for j in range(len(taken)):
        taken[j] |= time_us - tracks[KNOWN + j, 3] > tracks[0, MEMORY_US]
        n_stale += not taken[j]
    # the oldest ones, which stand first
    n_left_out = max(0, n_stale + n_present - (len(tracks) - KNOWN))
    kept = -n_left_out
    for j in range(len(taken)):
        if not taken[j]:
            if kept >= 0:
                # a slice would take seconds to compile: it may overlap
                for k in range(tracks.shape[1]):
                    tracks[KNOWN + kept, k] = tracks[KNOWN + j, k]
            kept += 1
    for i in range(n_present - 1, -1, -1):
        row = tracks[KNOWN + kept]
        row[0] = found[i, NUMBER]
        row[1] = found[i, X]
        row[2] = found[i, Y]
        row[3] = time_us
        kept += 1
    tracks[0, N_KNOWN] = kept
