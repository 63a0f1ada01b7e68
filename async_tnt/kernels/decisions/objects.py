"""Objects on a map of logits: the peaks of how much likelier a class is than nothing.

    score[y, x] = max over classes k of map[k, y, x] - map[nothing, y, x]
    peak[y, x]  = score[y, x] > 0, and no score within NEAR rows and columns is larger

`nothing` is the map's last channel. Of equal scores near each other, only the first one is a peak,
row by row from the left. Scores and peaks are kept between calls: scores are computed again where
the map has changed, and peaks within NEAR of such places.

Each peak is an object, of the likeliest class there. Its position is the mean of the places within
one row and column of the peak, weighted by their scores where these are positive. The likeliest
object is listed first; equally likely objects are listed in the order of their peaks, row by row.

A map may say how large objects are. Then two channels a and b follow `nothing`, and with the
distances dx and dy between neighbouring places, in sensor pixels, an object at a peak has

    width = dx exp(a),  height = dy exp(b)        with a and b limited to [-10, 10]

Its box has this size around its position. Two more channels c and d may say where the middle of the
box is. Then the position of an object at a peak is not a mean over places, but

    x = (the peak's x) + dx c,  y = (the peak's y) + dy d        with c and d limited as well

If the boxes of two objects of a class overlap by more than SUPPRESSED, only the likelier object is
listed. The overlap of two boxes is the area that they share, divided by the area that they cover
together.

An object takes the number of an earlier object that is nearer than a given reach, or else a new
number. The likeliest object chooses first, and takes the number of the nearest earlier object. Of
equally near objects it takes the object seen last or, if they were seen in the same decision, the
likelier one. An object with a box takes the number of the earlier one whose box overlaps most with
its own, however near others are; of equal overlaps, the nearer one.

What is remembered has limited room. The objects of a decision are remembered first, then those that
were seen before and are not found now. Where there is no room for all, those that were seen longest
ago are forgotten. However many false objects come and go, an object that is found in each decision
keeps its number.

Each array of the network and of the objects is an argument of its own, so the kernels here have
more than eight: to unpack a tuple of arrays takes Numba longer than to take them.
"""

import numpy as np
from numba import boolean, float32, float64, int64, uint64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import compiled
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.changes import EVERY_BIT, FIRST_ROW, LAST_ROW, MAX_ROW, WORDS
from async_tnt.kernels.network.empty_window import begin_window
from async_tnt.kernels.network.forward import forward
from async_tnt.kernels.network.sync_input import sync_input
from async_tnt.kernels.simd import trailing_zeros
from async_tnt.kernels.volume import state as S

NEAR = 1
"""Rows and columns around a peak within which no score is larger."""
SUPPRESSED = 0.5
"""The largest overlap of two boxes of a class that are both listed."""
LARGEST = 10.0
"""The limit of the numbers that say how large an object is, and where."""
MOST_TRACKED = 256
"""How many objects of a decision, the likeliest ones, may take the number of an earlier one."""

# `about`, int64: how the map lies in memory, and what is known of it
FIRST = 0  # where its place (0, 0) begins
DY = 1  # stride of the rows, in numbers
DX = 2  # stride of the columns, in numbers
DK = 3  # stride of the channels, in numbers
ROWS = 4
COLUMNS = 5
CHANNELS = 6  # the classes, and then `nothing`; not the channels of boxes
NOT_FINITE = 7  # number of places with a logit that is not finite
# How many steps write the map. Behind the header stands a number for each of these steps: where in
# the program the record of its changes begins.
N_SOURCES = 8
# How many channels behind `nothing` say what box an object has: none, 2 its size, or 4 its size and
# where its middle is.
N_OF_BOXES = 9
ABOUT_SIZE = 10  # numbers in the header

# `found`, float64: a row for each object
X = 0  # sensor pixels
Y = 1
PROBABILITY = 2
CLASS = 3
NUMBER = 4
WIDTH = 5  # of its box, in sensor pixels; 0 without sizes
HEIGHT = 6
FOUND_SIZE = 7  # numbers in a row

# `tracks`, float64: rows of TRACK_SIZE numbers. The first three rows are headers. The rows after
# them are objects of earlier decisions.
# the first header: how many objects are known, and for how long
HEAD = 0
N_KNOWN = 0
NEXT_NUMBER = 1
MEMORY_US = 2  # how long an object is remembered
# the second header: where on the sensor places lie, (x0 + dx column, y0 + dy row), in pixels
ON_SENSOR = 1
X0 = 0
DX_PX = 1
Y0 = 2
DY_PX = 3
# the third header: how far an object may move from one decision to the next, in pixels
REACH = 2
REACH_X = 0
REACH_Y = 1
# the first object. Objects seen last come last; of those of one decision, the likeliest comes last.
KNOWN = 3
KNOWN_NUMBER = 0
KNOWN_X = 1
KNOWN_Y = 2
KNOWN_US = 3  # when it was seen last
KNOWN_WIDTH = 4
KNOWN_HEIGHT = 5
TRACK_SIZE = 6  # numbers in a row


SCORES = (int64[::1], float64[:, ::1], uint64[:, ::1])
"""Numba's types of `about`, the scores and the peaks."""
OBJECTS = (float64[:, ::1], float64[:, ::1], float64[:, ::1], int64, boolean)
"""Numba's types of what objects are listed in and tracked by: probabilities, `found`, `tracks`, the
time, and whether to keep the tracks."""


@entry_point(float32[::1], *SCORES)
def score_map(maps, about, scores, peaks):
    """Compute the scores and the peaks of a whole map. For parameters see `locate_on_map`."""
    for y in range(about[ROWS]):
        for x in range(about[COLUMNS]):
            _write_score(maps, about, scores, y, x)
    for y in range(about[ROWS]):
        for word in range(peaks.shape[1]):
            _note_peaks(scores, peaks, y, word, EVERY_BIT)


@entry_point(float32[::1], *SCORES, *OBJECTS)
def list_objects(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep):
    """List the objects of a map whose scores and peaks are known; see `locate_on_map`."""
    if about[NOT_FINITE] > 0:
        return -1
    n = np.int64(0)  # With a literal 0, `_number_objects` would be compiled twice.
    for y in range(peaks.shape[0]):
        for word in range(peaks.shape[1]):
            peak_bits = peaks[y, word]
            while peak_bits != 0:
                x = 64 * word + trailing_zeros(peak_bits)
                best = _softmax_at(maps, about, y, x, probabilities[n])
                found[n, PROBABILITY] = probabilities[n, best]
                found[n, CLASS] = best
                found[n, NUMBER] = n  # of the peak, until objects get their numbers
                _write_position(scores, y, x, tracks[ON_SENSOR], found[n])
                _write_box(maps, about, y, x, tracks[ON_SENSOR], found[n])
                peak_bits &= peak_bits - np.uint64(1)  # clears the lowest bit
                n += 1
    _sort(probabilities, found, n)
    if about[N_OF_BOXES] != 0:
        n = _suppress(probabilities, found, n)
    _number_objects(found, n, tracks, time_us, keep)
    return n


@entry_point(
    S.STATE, *P.NETWORK, *SCORES, *OBJECTS, calls=(sync_input, forward, list_objects), nogil=True
)
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
    """The objects of a volume. Only what has changed since the last call is computed.

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


@entry_point(float32[::1], *SCORES, *OBJECTS, calls=(score_map, list_objects), nogil=True)
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
    found : float64, (n, FOUND_SIZE). Overwritten, a row for each object.
    tracks : float64, (KNOWN + m, TRACK_SIZE): the m objects seen last. Updated in place if `keep`.
    time_us : int. The decision's time.
    keep : bool. Whether these objects, and their numbers, are remembered.

    Returns
    -------
    int : objects; -1 if a logit is not finite.
    """
    score_map(maps, about, scores, peaks)
    return list_objects(maps, about, scores, peaks, probabilities, found, tracks, time_us, keep)


@compiled
def _follow_changes(program, bits, maps, about, scores, peaks):
    """Update the scores where the last `forward` has changed the map, and the peaks near them."""
    sources = about[ABOUT_SIZE : ABOUT_SIZE + about[N_SOURCES]]
    top = np.int64(MAX_ROW)
    bottom = np.int64(-1)
    for record in sources:
        top = min(top, program[record + FIRST_ROW])
        bottom = max(bottom, program[record + LAST_ROW])

    n_words = peaks.shape[1]
    for y in range(top, bottom + 1):
        for word in range(n_words):
            changed_bits = _changed_bits(program, bits, sources, y, y, word)
            while changed_bits != 0:
                _write_score(maps, about, scores, y, 64 * word + trailing_zeros(changed_bits))
                changed_bits &= changed_bits - np.uint64(1)  # clears the lowest bit

    for y in range(max(0, top - NEAR), min(about[ROWS], bottom + NEAR + 1)):
        previous = np.uint64(0)
        current = _changed_bits(program, bits, sources, y - NEAR, y + NEAR, 0)
        for word in range(n_words):
            following = np.uint64(0)
            if word + 1 < n_words:
                following = _changed_bits(program, bits, sources, y - NEAR, y + NEAR, word + 1)
            # A bit for each column within NEAR of one that has changed.
            nearby = current
            for k in range(1, NEAR + 1):
                n = np.uint64(k)
                opposite = np.uint64(64 - k)
                nearby |= current << n | previous >> opposite | current >> n | following << opposite
            previous = current
            current = following
            _note_peaks(scores, peaks, y, word, nearby)


@compiled
def _changed_bits(program, bits, sources, first, last, word):
    """The columns that have changed in any of the rows `first` to `last`, as bits.

    Bit k stands for column 64 `word` + k.
    """
    changed = np.uint64(0)
    for record in sources:
        begin = max(first, program[record + FIRST_ROW])
        end = min(last, program[record + LAST_ROW])
        for y in range(begin, end + 1):
            changed |= bits[np.uint64(program[record] + y * program[record + WORDS] + word)]
    return changed


@compiled
def _write_score(maps, about, scores, y, x):
    """Write the score of a place: nan where a number of its channels is not finite.

    Scores are float64, in which no difference of logits overflows.
    """
    n_classes = about[CHANNELS] - 1
    at = about[FIRST] + y * about[DY] + x * about[DX]
    nothing = maps[np.uint64(at + n_classes * about[DK])]
    best = maps[np.uint64(at)]
    finite = np.isfinite(nothing)
    for k in range(n_classes):
        logit = maps[np.uint64(at + k * about[DK])]
        finite &= np.isfinite(logit)
        best = max(best, logit)
    for k in range(n_classes + 1, n_classes + 1 + about[N_OF_BOXES]):
        finite &= np.isfinite(maps[np.uint64(at + k * about[DK])])
    score = np.float64(best) - np.float64(nothing) if finite else np.nan
    about[NOT_FINITE] += np.int64(np.isnan(score)) - np.int64(np.isnan(scores[y, x]))
    scores[y, x] = score


@compiled
def _note_peaks(scores, peaks, y, word, candidates):
    """Store which `candidates` are peaks: a bit for each place in a word of a row."""
    columns = scores.shape[1]
    untested = candidates
    peak_bits = np.uint64(0)
    while untested != 0:
        bit = trailing_zeros(untested)
        x = 64 * word + bit
        if x < columns and scores[y, x] > 0 and _is_peak(scores, y, x):
            peak_bits |= np.uint64(1) << np.uint64(bit)
        untested &= untested - np.uint64(1)  # clears the lowest bit
    peaks[y, word] = peaks[y, word] & ~candidates | peak_bits


@compiled
def _is_peak(scores, y, x):
    """Whether a place has the largest score near it. Of equal scores, only the first one counts.

    Places are ordered row by row, from the left.
    """
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
def _softmax_at(maps, about, y, x, probabilities):
    """Write the softmax of a place's logits, and return the likeliest class there.

    The last channel, `nothing`, takes part in the softmax but is no class. Of equally likely
    classes, the first one is returned.
    """
    n_classes = about[CHANNELS] - 1
    at = about[FIRST] + y * about[DY] + x * about[DX]
    largest = maps[at]
    for k in range(about[CHANNELS]):
        largest = max(largest, maps[at + k * about[DK]])
    best = 0
    total = 0.0
    for k in range(about[CHANNELS]):
        probabilities[k] = np.exp(np.float64(maps[at + k * about[DK]]) - np.float64(largest))
        total += probabilities[k]
        if k < n_classes and maps[at + k * about[DK]] > maps[at + best * about[DK]]:
            best = k
    for k in range(about[CHANNELS]):
        probabilities[k] /= total
    return best


@compiled
def _write_position(scores, y, x, map_to_sensor, row):
    """Write the position of a peak, in sensor pixels, into its row of `found`."""
    total = 0.0
    sum_x = 0.0
    sum_y = 0.0
    for near_y in range(max(0, y - 1), min(scores.shape[0], y + 2)):
        for near_x in range(max(0, x - 1), min(scores.shape[1], x + 2)):
            weight = max(scores[near_y, near_x], 0.0)
            total += weight
            sum_x += weight * (near_x - x)
            sum_y += weight * (near_y - y)
    row[X] = map_to_sensor[X0] + map_to_sensor[DX_PX] * (x + sum_x / total)
    row[Y] = map_to_sensor[Y0] + map_to_sensor[DY_PX] * (y + sum_y / total)


@compiled
def _write_box(maps, about, y, x, map_to_sensor, row):
    """Write the width and the height of an object at a peak; zeros if the map has none.

    If the map says where the middles of boxes are, the position is written again.
    """
    row[WIDTH] = 0.0
    row[HEIGHT] = 0.0
    at = about[FIRST] + y * about[DY] + x * about[DX] + about[CHANNELS] * about[DK]
    if about[N_OF_BOXES] > 0:
        row[WIDTH] = map_to_sensor[DX_PX] * np.exp(_limited(maps[at]))
        row[HEIGHT] = map_to_sensor[DY_PX] * np.exp(_limited(maps[at + about[DK]]))
    if about[N_OF_BOXES] > 2:
        aside = _limited(maps[at + 2 * about[DK]])
        down = _limited(maps[at + 3 * about[DK]])
        row[X] = map_to_sensor[X0] + map_to_sensor[DX_PX] * (x + aside)
        row[Y] = map_to_sensor[Y0] + map_to_sensor[DY_PX] * (y + down)


@compiled
def _limited(number):
    """A number that is limited to [-LARGEST, LARGEST]."""
    return min(max(np.float64(number), -LARGEST), LARGEST)


@compiled
def overlap(x, y, width, height, other_x, other_y, other_width, other_height):
    """The area that two boxes share, divided by the area that they cover; 0 without areas."""
    right = min(x + width / 2, other_x + other_width / 2)
    left = max(x - width / 2, other_x - other_width / 2)
    bottom = min(y + height / 2, other_y + other_height / 2)
    top = max(y - height / 2, other_y - other_height / 2)
    shared = max(right - left, 0.0) * max(bottom - top, 0.0)
    covered = width * height + other_width * other_height - shared
    return shared / covered if covered > 0.0 else 0.0


@compiled
def _suppress(probabilities, found, n):
    """Leave out objects that overlap with likelier ones of their class. Returns how many stay.

    The n objects are sorted, the likeliest first.
    """
    n_kept = 0
    for i in range(n):
        is_kept = True
        for j in range(n_kept):
            if found[j, CLASS] == found[i, CLASS] and _overlap_of(found[i], found[j]) > SUPPRESSED:
                is_kept = False
                break
        if is_kept:
            if n_kept < i:
                _swap(found, n_kept, i)
                _swap(probabilities, n_kept, i)
            n_kept += 1
    return n_kept


@compiled
def _overlap_of(one, other):
    """The overlap of two objects of a decision."""
    return overlap(
        one[X],
        one[Y],
        one[WIDTH],
        one[HEIGHT],
        other[X],
        other[Y],
        other[WIDTH],
        other[HEIGHT],
    )


@compiled
def _overlap_with_known(one, known):
    """The overlap of an object of a decision with an earlier one."""
    return overlap(
        one[X],
        one[Y],
        one[WIDTH],
        one[HEIGHT],
        known[KNOWN_X],
        known[KNOWN_Y],
        known[KNOWN_WIDTH],
        known[KNOWN_HEIGHT],
    )


@compiled
def _sort(probabilities, found, n):
    """Sort n objects, the likeliest first, and equally likely ones by the numbers of their peaks.

    By Shell's sort: a map of noise may have thousands.
    """
    step = 1
    while 3 * step + 1 < n:
        step = 3 * step + 1
    while step > 0:
        for last in range(step, n):
            k = last
            while k >= step and _is_behind(found, k - step, k):
                _swap(found, k, k - step)
                _swap(probabilities, k, k - step)
                k -= step
        step //= 3


@compiled
def _is_behind(found, i, k):
    """Whether object i must stand behind object k."""
    if found[i, PROBABILITY] != found[k, PROBABILITY]:
        return found[i, PROBABILITY] < found[k, PROBABILITY]
    return found[i, NUMBER] > found[k, NUMBER]


@compiled
def _swap(rows, i, k):
    """Swap two rows."""
    for c in range(rows.shape[1]):
        rows[i, c], rows[k, c] = rows[k, c], rows[i, c]


@compiled
def _number_objects(found, n, tracks, time_us, keep):
    """Give each of n objects the number of an earlier one, or a new number."""
    n_known = np.int64(tracks[HEAD, N_KNOWN])
    is_taken = np.zeros(n_known, np.bool_)
    next_number = tracks[HEAD, NEXT_NUMBER]
    for i in range(n):
        nearest = -1
        least_distance = 1.0  # squared distance, in units of the reach
        most_overlap = 0.0  # of boxes; without sizes it is always 0
        n_candidates = n_known if i < MOST_TRACKED else 0
        # From the object seen last on, so that it is taken if others are as near.
        for j in range(n_candidates - 1, -1, -1):
            dx = (found[i, X] - tracks[KNOWN + j, KNOWN_X]) / tracks[REACH, REACH_X]
            dy = (found[i, Y] - tracks[KNOWN + j, KNOWN_Y]) / tracks[REACH, REACH_Y]
            distance = dx * dx + dy * dy
            is_old = time_us - tracks[KNOWN + j, KNOWN_US] > tracks[HEAD, MEMORY_US]
            if is_taken[j] or is_old:
                continue
            shared = _overlap_with_known(found[i], tracks[KNOWN + j])
            is_nearer = shared == most_overlap and distance < least_distance
            if shared > most_overlap or is_nearer:
                nearest = j
                least_distance = distance
                most_overlap = shared
        if nearest >= 0:
            is_taken[nearest] = True
            found[i, NUMBER] = tracks[KNOWN + nearest, KNOWN_NUMBER]
        else:
            found[i, NUMBER] = next_number
            next_number += 1
    if keep:
        tracks[HEAD, NEXT_NUMBER] = next_number
        _remember(found, n, tracks, is_taken, time_us)


@compiled
def _remember(found, n, tracks, is_taken, time_us):
    """Keep in `tracks` the objects of this decision, and stale objects as far as there is room.

    An object is stale if it was known and is not taken now. An object that was last seen too long
    ago is forgotten: it is marked as taken.
    """
    room = len(tracks) - KNOWN
    n_present = min(n, MOST_TRACKED, room)
    n_stale = 0
    for j in range(len(is_taken)):
        is_taken[j] |= time_us - tracks[KNOWN + j, KNOWN_US] > tracks[HEAD, MEMORY_US]
        n_stale += not is_taken[j]

    # Where there is no room for all, the oldest objects are left out. They stand first: `n_kept`
    # counts up from minus their number, and is negative for them.
    n_left_out = max(0, n_stale + n_present - room)
    n_kept = -n_left_out
    for j in range(len(is_taken)):
        if not is_taken[j]:
            if n_kept >= 0:
                # A slice would take seconds to compile, because it may overlap.
                for k in range(tracks.shape[1]):
                    tracks[KNOWN + n_kept, k] = tracks[KNOWN + j, k]
            n_kept += 1

    for i in range(n_present - 1, -1, -1):
        row = tracks[KNOWN + n_kept]
        row[KNOWN_NUMBER] = found[i, NUMBER]
        row[KNOWN_X] = found[i, X]
        row[KNOWN_Y] = found[i, Y]
        row[KNOWN_US] = time_us
        row[KNOWN_WIDTH] = found[i, WIDTH]
        row[KNOWN_HEIGHT] = found[i, HEIGHT]
        n_kept += 1
    tracks[HEAD, N_KNOWN] = n_kept
