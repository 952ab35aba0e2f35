"""One level of reach-while-avoid on slabs of bits (`row_moves`): what the cells won last let others win.

A cell is won at a level because a box became wholly won at the level before, so that only rows of an erosion whose
surroundings changed are made again, and every input that is found there for a cell is admissible, none is missed. The
loops are flat over the words of a slab; bits behind the end of a row are empty, and stay so.
"""

from __future__ import annotations

import numpy as np

from simgap.late import njit

GAP = 256  # words without a change that are cheaper made again than stepped over: judgement
CHUNK = 64  # words that are looked at together
_PLACE = np.zeros(64, np.int64)
_DEBRUIJN = np.uint64(0x03F79D71B4CB0A89)
for _bit in range(64):
    _PLACE[(0x03F79D71B4CB0A89 << _bit & 2**64 - 1) >> 58] = _bit


def stage_size(rows: int, words: int, widest: int) -> tuple[int, int]:
    """Five slabs with an empty row in front and as many behind as a box covers: buffers of `spread`."""
    return 5, (rows + widest + 2) * words


@njit(cache=True, nogil=True)
def lowest(word):  # type: ignore[no-untyped-def]
    """Number of the lowest bit of a word that is not 0 (de Bruijn; Leiserson, Prokop and Randall, 1998)."""
    return _PLACE[np.int64(((word & (~word + np.uint64(1))) * _DEBRUIJN) >> np.uint64(58))]


@njit(cache=True, nogil=True)
def _and_of_slabs(lead, at, extent, won, news, out):  # type: ignore[no-untyped-def]
    """out = AND of a box of slabs (slabs, words); False, with nothing written, if none of them has news."""
    any_news = False
    for pas in range(2):
        first = True
        for a in range(extent[0]):
            for b in range(extent[1]):
                for c in range(extent[2]):
                    i, j, k = (at[0] + a) % lead[0, 0], (at[1] + b) % lead[0, 1], (at[2] + c) % lead[0, 2]
                    slab = (i * lead[0, 1] + j) * lead[0, 2] + k
                    if pas == 0:
                        any_news |= news[slab] != 0
                    else:
                        for q in range(out.size):
                            out[q] = won[slab, q] if first else out[q] & won[slab, q]
                        first = False
        if not any_news:
            return False
    return True


@njit(cache=True, nogil=True)
def _runs(new, old, rows, words, widest, runs):  # type: ignore[no-untyped-def]
    """Ranges of rows whose erosion may differ, since a row of `new` that it covers differs from `old`; how many.

    They begin where the widest box does that ends in the first such row, be it in front of the slab.
    """
    number = 0
    for r in range(rows):
        differs = np.uint64(0)
        for q in range(r * words, (r + 1) * words):
            differs |= new[q] ^ old[q]
        if differs:
            start = r - widest + 1
            if number and start <= runs[1, number - 1] + GAP // words:
                runs[1, number - 1] = r + 1
            else:
                runs[0, number], runs[1, number] = start, r + 1
                number += 1
    return number


@njit(cache=True, nogil=True)
def _moved_and(source, out, first, last, by, bits):  # type: ignore[no-untyped-def]
    """out = source AND source moved by words and bits, for the words first..last of two buffers."""
    here, there, to = source[first:last], source[first + by : last + by + 1], out[first:last]
    left = np.uint64(63) - bits
    for q in range(to.size):
        to[q] = here[q] & (there[q] >> bits | there[q + 1] << np.uint64(1) << left)


@njit(cache=True, nogil=True)
def _eroded(stage, source, spare, extent, along, first, last, words):  # type: ignore[no-untyped-def]
    """Erode the rows first..last of buffer `source` by doubling into one of two spare buffers; which one holds it.

    `along` a row (True) the extent counts bits, else rows. Rows behind `last` are read as far as the extent reaches.
    """
    have, at = 1, source
    first, last = (1 + first) * words, (1 + last) * words
    while have < extent:
        by = min(have, extent - have)
        to = spare if at != spare else spare + 1
        if along:
            _moved_and(stage[at], stage[to], first, last, by >> 6, np.uint64(by & 63))
        else:
            _moved_and(stage[at], stage[to], first, last, by * words, np.uint64(0))
        have += by
        at = to
    return at


@njit(cache=True, nogil=True)
def _empty(buffer, first, last):  # type: ignore[no-untyped-def]
    """True if no bit is set in the words first..last."""
    seen, part = np.uint64(0), buffer[first:last]
    for q in range(part.size):
        seen |= part[q]
    return seen == 0


@njit(cache=True, nogil=True)
def spread(  # type: ignore[no-untyped-def]
    moves, won, todo, news, made, clear, stage, runs, line, fresh, ends, entries, count,
    workers, block,
):  # fmt: skip
    """Find what can be won of `todo` for every `workers`-th block from `block` on.

    Args:
        moves: `row_moves.Moves`. won, todo: (classes, slabs, words of a slab), cells that are won, and that may be.
        news: (classes, slabs) whether a slab won cells at the last level.
        made: (blocks, words of a slab) the AND of slabs as it was when the block was looked at last.
        clear: flat words of free cells eroded by swept boxes, one row in front and behind.
        stage, runs, line: work space: `stage_size`, (2, rows), (words of a slab,).
        fresh: (classes * slabs, words of a slab) what is found. entries: (n, 2) the word of `fresh` above the
            move, and the cells. count: (1,) of them; ends: of each word of `fresh`.

    Returns:
        The block to go on with when there is room for its entries, or -1.
    """
    rows, words, widest = moves.size
    total = rows * words
    while block < moves.block_class.size:
        k = moves.block_class[block]
        if _and_of_slabs(moves.lead, moves.block_at[block], moves.block_extent[block], won[k], news[k], line):
            first_job, last_job = moves.block_jobs[block], moves.block_jobs[block + 1]
            if count[0] + (moves.job_moves[last_job] - moves.job_moves[first_job]) * total > len(entries):
                return block
            number = _runs(line, made[block], rows, words, widest, runs)
            if number:
                for q in range(total):
                    made[block, q] = stage[0, words + q] = line[q]
            for i in range(number):
                _spread_run(
                    moves, todo, clear, stage, line, fresh, ends, entries, count, first_job,
                    last_job, runs[0, i], runs[1, i],
                )  # fmt: skip
        block += workers
    return -1


@njit(cache=True, nogil=True)
def _spread_run(  # type: ignore[no-untyped-def]
    moves, todo, clear, stage, line, fresh, ends, entries, count, first_job, last_job, low, high
):
    """The moves of some jobs from the rows low..high of their erosions of `stage[0]`."""
    rows, words, widest = moves.size
    far, along, bits, begin = min(rows, high + widest - 1), 0, -1, low
    for job in range(first_job, last_job):
        if moves.job_bits[job] != bits:
            bits = moves.job_bits[job]
            along = _eroded(stage, 0, 1, bits, True, max(0, begin), far, words)
        low = max(0, begin + widest - moves.job_rows[job])
        at = _eroded(stage, along, 3, moves.job_rows[job], False, low, far, words)
        if _empty(stage[at], (1 + low) * words, (1 + high) * words):
            continue
        for v in range(moves.job_moves[job], moves.job_moves[job + 1]):
            top, end = max(0, low - moves.rows[v]), min(rows, high - moves.rows[v])
            if top < end:
                _meet(
                    stage[at], v, moves.to[v], rows, words, top * words, end * words, moves.words[v], moves.bits[v],
                    todo, clear, moves.clear_at[v], moves.clear_rows[v], moves.clear_words[v], moves.clear_bits[v],
                    line, fresh, ends, entries, count,
                )  # fmt: skip


@njit(cache=True, nogil=True)
def _meet(  # type: ignore[no-untyped-def]
    source, v, to, rows, words, first, last, by, bits, todo, clear, clear_at, clear_rows, clear_by, clear_bits,
    line, fresh, ends, entries, count,
):  # fmt: skip
    """Keep what is left of the moved words of `source` among the words first..last of `todo`, chunk by chunk.

    That is where the swept box of the move is free of obstacles, too. (Numbers and not the moves are handed over: a
    tuple of arrays is copied at every call.)
    """
    left, clear_left, by = np.uint64(63) - bits, np.uint64(63) - clear_bits, by + words
    n = count[0]
    while first < last:
        stop = min(first + CHUNK, last)
        own, part, seen = todo[to, first:stop], source[first + by : stop + by + 1], np.uint64(0)
        for i in range(own.size):
            word = (part[i] >> bits | part[i + 1] << np.uint64(1) << left) & own[i]
            line[i] = word
            seen |= word
        if seen:
            for i in range(stop - first):
                word = line[i]
                if word and clear_at >= 0:
                    q = first + i
                    p = words + clear_at + q + clear_by
                    stays = 0 <= q // words + clear_rows < rows
                    word &= (
                        clear[p] >> clear_bits | clear[p + 1] << np.uint64(1) << clear_left if stays else np.uint64(0)
                    )
                if word:
                    fresh[to, first + i] |= word
                    at = to * fresh.shape[1] + first + i
                    entries[n, 0], entries[n, 1] = np.uint64(at) << np.uint64(32) | np.uint64(v), word
                    ends[at] += 1
                    n += 1
        first = stop
    count[0] = n


@njit(cache=True, nogil=True)
def place(entries, count, ends, placed):  # type: ignore[no-untyped-def]
    """The entries in the order of their words; `ends`, how many each word has, becomes where those of a word end."""
    total = 0
    for i in range(ends.size):
        number = ends[i]
        ends[i] = total
        total += number
    for n in range(count):
        to = np.int64(entries[n, 0] >> np.uint64(32))
        placed[ends[to], 0], placed[ends[to], 1] = entries[n, 0], entries[n, 1]
        ends[to] += 1


@njit(cache=True, nogil=True)
def settle(  # type: ignore[no-untyped-def]
    moves, fresh, ends, placed, won, todo, news, base, stride, level, order, value, mask, chosen, first, last
):
    """Win the fresh cells of the words first..last of every slab and class: level, inputs, sets, news; 0.

    fresh: (workers, classes * slabs, words of a slab), emptied. placed, ends: (workers, n, 2), (workers, words).
    value (cells, classes), mask (cells, classes, bytes); chosen (cells, classes), of the inputs in `order`, if any.
    """
    rows, words, _ = moves.size
    slabs, classes = base.size // rows, value.shape[1]
    inputs = np.zeros((max(8 * mask.shape[2], order.size) + 63) // 64 * 64, np.uint64)
    sets = np.zeros((64, inputs.size // 64), np.uint64)
    packed = sets.view(np.uint8)
    for q in range(first, last):
        for slab in range(slabs):  # cells that differ in it lie near each other in `mask`
            start = base[slab * rows + q // words] + 64 * (q % words) * stride
            for c in range(classes):
                to, new = c * slabs + slab, np.uint64(0)
                for worker in range(fresh.shape[0]):
                    new |= fresh[worker, to, q]
                    fresh[worker, to, q] = 0
                if new == 0:
                    continue
                news[c, slab] = 1
                won[c, slab, q] |= new
                todo[to, q] &= ~new
                for worker in range(fresh.shape[0]):
                    at = to * (rows * words) + q
                    _collect(moves.inputs_from, moves.inputs, placed[worker], ends[worker], at, inputs)
                if order.size:
                    _choose(inputs, order, new, c, start, stride, chosen)
                else:
                    _turn(inputs, sets)
                _write(new, c, start, stride, level, packed, value, mask)
    return 0


@njit(cache=True, nogil=True)
def _write(new, c, start, stride, level, sets, value, mask):  # type: ignore[no-untyped-def]
    """Give the cells of a word their level and their inputs (64, bytes)."""
    while new:
        j = lowest(new)
        new &= new - np.uint64(1)
        value[start + j * stride, c] = level
        for b in range(mask.shape[2]):
            mask[start + j * stride, c, b] = sets[j, b]


@njit(cache=True, nogil=True)
def _choose(inputs, order, left, c, start, stride, chosen):  # type: ignore[no-untyped-def]
    """Give each cell of a word the first of its inputs; inputs (M,), words of cells, are emptied."""
    for m in order:
        own = inputs[m] & left
        left &= ~own
        inputs[m] = 0
        while own:
            chosen[start + lowest(own) * stride, c] = m
            own &= own - np.uint64(1)


@njit(cache=True, nogil=True)
def _collect(inputs_from, input_of, placed, ends, at, cells):  # type: ignore[no-untyped-def]
    """Add what the entries of a word hold to the cells of their inputs (M,)."""
    for n in range(ends[at - 1] if at else 0, ends[at]):
        v = np.int64(placed[n, 0] & np.uint64(0xFFFFFFFF))
        for i in range(inputs_from[v], inputs_from[v + 1]):
            cells[input_of[i]] |= placed[n, 1]


@njit(cache=True, nogil=True)
def _turn(inputs, sets):  # type: ignore[no-untyped-def]
    """Words of cells, one an input (64 k,), into words of inputs, k a cell (64, k); the first are emptied."""
    for k in range(sets.shape[1]):
        square, seen = inputs[64 * k : 64 * k + 64], np.uint64(0)
        for i in range(64):
            seen |= square[i]
        if seen:
            _swap(square, 32, np.uint64(0x00000000FFFFFFFF))
            _swap(square, 16, np.uint64(0x0000FFFF0000FFFF))
            _swap(square, 8, np.uint64(0x00FF00FF00FF00FF))
            _swap(square, 4, np.uint64(0x0F0F0F0F0F0F0F0F))
            _swap(square, 2, np.uint64(0x3333333333333333))
            _swap(square, 1, np.uint64(0x5555555555555555))
        for i in range(64):
            sets[i, k] = square[i]
            square[i] = 0


@njit(cache=True, nogil=True, inline="always")
def _swap(square, by, lower):  # type: ignore[no-untyped-def]
    """One of six steps that transpose a square of bits (Warren, Hacker's Delight, section 7-3)."""
    for block in range(0, 64, 2 * by):
        for i in range(block, block + by):
            differ = (square[i] >> np.uint64(by) ^ square[i + by]) & lower
            square[i] ^= differ << np.uint64(by)
            square[i + by] ^= differ
