"""The footprint of a particle on the film: a Gaussian dot, or the streak that a moving dot leaves.

A dot is a separable Gaussian of standard deviation sigma [px], cut off R = max(2, ceil(3 sigma)) pixels from the pixel
that holds its centre; with k = -R..R the offset in pixels and d the distance from the dot to that pixel's centre,

    w_k = exp(-k (k + 2 d) / (2 sigma^2)) / sum of the same over k

so the weights add up to 1 at every sub-pixel position and every sigma, and the largest term is near 1 (no underflow).

A streak is the time average of its dot along a straight segment. It is drawn as a sum of dots at the nodes of a
composite two-point Gauss-Legendre rule (Abramowitz & Stegun 1964, 25.4.30 with n = 2): panels of at most 1.75 sigma,
two equal dots in each. The rule is exact for cubics, so the ends of the streak are right to 4th order, and on a
Gaussian its ripple between panels is below 1e-3. Energy is conserved because every dot conserves it, all directions are
alike, and a streak of length zero is the dot itself. tests/render/test_film.py states the error.

Rows of the film are padded by `PAD` pixels on both sides, so that a block of pixels never has to be clipped in x.
"""
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti

from tparticles.hints import NO_WRAP, rolled

QUANTUM = 2.0**-24  # film white in one step of the fixed-point film
SIGMA_MIN = 0.3  # [px]; a narrower dot would fall between the pixel centres
SIGMA_MAX = 1024.0  # [px]
REACH = 2.0**24  # [px]; beyond it f32 no longer resolves a pixel
ENERGY_MAX = 2.0**26  # [film white px]; 2^26 / QUANTUM leaves 13 bits of headroom in an i64, see `rounded`

BLOCK = 5  # pixels in a block: a dot with R = 2 is one block wide
LANES = 16  # i64 in a block: 5 pixels of 3 channels and a zero, whole vector registers
WIDE = 8  # pixels in a block of a wider dot
PAD = 8  # [px]; at least BLOCK + 1 and WIDE

# A band is owned by one thread at a time. It consists of tiles, which begin at the padding.
BAND_BITS, TILE_BITS = 4, 5
BAND = 1 << BAND_BITS  # rows
TILE = 1 << TILE_BITS  # [px]

# Width of a quadrature panel and length up to which one dot in the middle is good, both in sigma.
_PANEL = 1.75
_POINT = 0.25
_NODE = 0.28867513459481287  # 1 / (2 sqrt 3): distance of the two nodes from the middle of a panel of width 1


@ti.pyfunc
def stride(width):
    """Return how many values a padded row of `width` pixels has."""
    return (width + 2 * PAD) * 3


@ti.pyfunc
def tiles(width):
    """Return how many tiles a padded row of `width` pixels has."""
    return (width + 2 * PAD + TILE - 1) >> TILE_BITS


@ti.func
def exponential(x):
    """Return exp(x) for x <= 0 to 2e-7, 0 < result <= 1: arithmetic only, so it vectorises (libm's does not)."""
    # exp(x) = 2^n 2^f, n + f = x / ln 2, |f| <= 1/2; Taylor series of 2^f
    y = ti.max(ti.cast(x, ti.f32) * ti.f32(1.4426950408889634), ti.f32(-126.0))
    n = ti.floor(y + ti.f32(0.5))
    f = y - n
    p = ti.f32(0.0)
    for c in ti.static(
        (1.540353039e-4, 1.333355815e-3, 9.618129108e-3, 5.550410866e-2, 0.2402265070, 0.6931471806, 1.0)
    ):
        p = p * f + ti.f32(c)
    return p * ti.bit_cast((ti.cast(n, ti.i32) + 127) << 23, ti.f32)


@ti.func
def finite(x):
    """Whether x is a number; in integers, because fast-math takes every float for one."""
    return (ti.bit_cast(ti.cast(x, ti.f32), ti.i32) & 0x7FFFFFFF) < 0x7F800000


@ti.func
def reachable(x):
    """Whether |x| < REACH [px]; false for NaN and infinity."""
    return (ti.bit_cast(ti.cast(x, ti.f32), ti.i32) & 0x7FFFFFFF) < ti.bit_cast(ti.f32(REACH), ti.i32)


@ti.func
def limited(sigma):
    """Return sigma [px] within SIGMA_MIN..SIGMA_MAX."""
    return ti.min(ti.max(ti.cast(sigma, ti.f32), ti.f32(SIGMA_MIN)), ti.f32(SIGMA_MAX))


@ti.func
def radius(sigma):
    """Return R [px] of a dot, see above."""
    return ti.max(2, ti.cast(ti.ceil(ti.f32(3.0) * sigma), ti.i32))


@ti.func
def five_weights(a, q, d):
    """Return the weights for k = -2..2; a = 1 / (2 sigma^2), q = exp(-2 a)."""
    # r = w_1 / w_0 = exp(-a (1 + 2 d)), w_-1 / w_0 = q / r, w_2 / w_0 = r^2 q; all of them times r^2:
    r = exponential(-a * (ti.f32(1.0) + ti.f32(2.0) * d))
    r2 = r * r
    w = ti.Vector([q * q * q, q * r, r2, r2 * r, r2 * r2 * q])
    return w / ((w[0] + w[4]) + (w[1] + w[3]) + w[2])


@ti.func
def gauss(a, d, k):
    """Return exp(-a k (k + 2 d)): weight at offset k, relative to the pixel that holds the centre."""
    x = ti.cast(k, ti.f32)
    return exponential(-a * x * (x + ti.f32(2.0) * d))


@ti.func
def gauss_sum(a, d, R):
    """Return the sum of `gauss` over k = -R..R, term by term: for a thread of a GPU."""
    total = ti.f32(1.0)
    for k in range(1, R + 1):
        total += gauss(a, d, k) + gauss(a, d, -k)
    return total


@ti.func
def gauss_sums(marks: ti.template(), a, dx, dy, R):
    """Return the product of the sums for two distances, WIDE terms at a time: for vectors."""
    x, y = ti.Vector([ti.f32(0.0)] * WIDE), ti.Vector([ti.f32(0.0)] * WIDE)
    for i in range((R + WIDE - 1) // WIDE):
        rolled(marks)
        for lane in range(WIDE):
            k = WIDE * i + lane + 1
            x[lane] += ti.select(k <= R, gauss(a, dx, k) + gauss(a, dx, -k), ti.f32(0.0))
            y[lane] += ti.select(k <= R, gauss(a, dy, k) + gauss(a, dy, -k), ti.f32(0.0))
    return (ti.f32(1.0) + x.sum()) * (ti.f32(1.0) + y.sum())


@ti.func
def block_row(w, energy):
    """Spread 5 weights times 3 energies over the lanes of a block."""
    return ti.Vector([w[lane // 3] * energy[lane % 3] if lane < 3 * BLOCK else ti.f32(0.0) for lane in range(LANES)])


@ti.func
def rounded(x):
    """Return floor(x + 1/2) as i64, |x| < 2^51; CPUs before AVX-512 have no vector instruction that converts.

    A whole number plus 1.5 * 2^52 is exact in f64, and its lowest bits are that number.
    """
    y = ti.cast(ti.floor(x + ti.f32(0.5)), ti.f64) + ti.f64(1.5 * 2.0**52)
    return ti.bit_cast(y, ti.i64) - ti.i64(0x4338000000000000)


@ti.func
def add_row(film: ti.template(), base, row, weight):
    """Add round(row * weight) to the film from index `base` on, not atomically: the caller must own these pixels."""
    start = base & NO_WRAP
    for lane in range(LANES):
        film[start + lane] = film[start + lane] + rounded(row[lane] * weight)


@ti.func
def wide_row(a, d, k0, R, energy):
    """Return the weights of pixels k0..k0+7 relative to pixel 0, zero beyond R, times 3 energies, pixel by pixel."""
    w = ti.Vector([ti.f32(0.0)] * WIDE)
    for k in range(WIDE):
        w[k] = ti.select(k0 + k <= R, gauss(a, d, k0 + k), ti.f32(0.0))
    return ti.Vector([w[lane // 3] * energy[lane % 3] for lane in range(3 * WIDE)])


@ti.func
def add_wide_row(film: ti.template(), base, row, weight):
    """Do as `add_row` for a row of WIDE pixels."""
    start = base & NO_WRAP
    for lane in range(3 * WIDE):
        film[start + lane] = film[start + lane] + rounded(row[lane] * weight)


@ti.func
def across_block(a, d, k0, R):
    """Return the weights of pixels k0..k0+4 relative to pixel 0, zero beyond R."""
    w = ti.Vector([ti.f32(0.0)] * BLOCK)
    for k in ti.static(range(BLOCK)):
        if k0 + k <= R:
            w[k] = gauss(a, d, k0 + k)
    return w


@ti.func
def mark(marks: ti.template(), width, top, first, last):
    """Mark the tiles of pixels `first` and `last`, padding included, in the band that begins at row `top`."""
    row = (top >> BAND_BITS) * tiles(width)
    for pixel in ti.static((first, last)):
        tile = row + ((pixel + PAD) >> TILE_BITS)
        if marks[tile] == 0:  # written once: other threads look at marks beside it, see `rolled`
            marks[tile] = 1


@ti.func
def draw_dot(film: ti.template(), marks: ti.template(), width, top, bottom, u, v, sigma, energy):
    """Add one dot to the rows top <= y < bottom, of one band, of a film of `width` pixels.

    `energy` is in quanta, a 3-vector; `marks` holds whether a tile may hold light.
    """
    x, y, R = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32), radius(sigma)
    dx, dy = ti.floor(u) + ti.f32(0.5) - u, ti.floor(v) + ti.f32(0.5) - v
    a = ti.f32(0.5) / (sigma * sigma)
    first, last = ti.max(top, y - R), ti.min(bottom, y + R + 1)
    if first < last and x + R >= 0 and x - R < width:
        if R == 2:
            mark(marks, width, top, x - 2, x + 2)
            q = exponential(ti.f32(-2.0) * a)
            down = five_weights(a, q, dy)
            row = block_row(five_weights(a, q, dx), energy)
            base = (x - 2 + PAD) * 3
            for j in range(first, last):
                rolled(marks)
                add_row(film, j * stride(width) + base, row, down[j - y + 2])
        else:
            scaled = energy / gauss_sums(marks, a, dx, dy, R)
            # The weights of the rows are worked out once, all together, and not again in each block.
            down = ti.Vector([ti.f32(0.0)] * BAND)
            for j in range(BAND):
                down[j] = gauss(a, dy, first - y + j)
            # Blocks k0..k0+7 with k0 = 8 i - R; those that touch a pixel 0 <= x + k < width.
            for i in range(ti.max(0, R - x) // WIDE, ti.min(2 * R, width - 1 - x + R) // WIDE + 1):
                rolled(marks)
                k0 = WIDE * i - R
                mark(marks, width, top, x + k0, x + k0 + WIDE - 1)
                row = wide_row(a, dx, k0, R, scaled)
                base = first * stride(width) + (x + k0 + PAD) * 3
                for j in range(last - first):
                    rolled(marks)
                    add_wide_row(film, j * stride(width) + base, row, down[j])


@ti.func
def piece_count(sigma):
    """Return how many pieces, each one block wide and one row high, a dot consists of."""
    rows = 2 * radius(sigma) + 1
    return rows * ((rows + BLOCK - 1) // BLOCK)


@ti.func
def draw_piece(film: ti.template(), size, piece, u, v, sigma, energy):
    """Add one piece of a dot, atomically: `draw_dot` for a GPU, no loop around the additions."""
    x, y, R = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32), radius(sigma)
    dx, dy = ti.floor(u) + ti.f32(0.5) - u, ti.floor(v) + ti.f32(0.5) - v
    a = ti.f32(0.5) / (sigma * sigma)
    k0, j = piece // (2 * R + 1) * BLOCK - R, piece % (2 * R + 1) - R
    if y + j >= 0 and y + j < size[1] and x + k0 + BLOCK > 0 and x + k0 < size[0]:
        row = ti.Vector([ti.f32(0.0)] * LANES)
        weight = ti.f32(0.0)
        if R == 2:
            q = exponential(ti.f32(-2.0) * a)
            row = block_row(five_weights(a, q, dx), energy)
            weight = five_weights(a, q, dy)[j + 2]
        else:
            row = block_row(across_block(a, dx, k0, R), energy / (gauss_sum(a, dx, R) * gauss_sum(a, dy, R)))
            weight = gauss(a, dy, j)
        base = ((y + j) * (size[0] + 2 * PAD) + x + k0 + PAD) * 3
        for lane in ti.static(range(3 * BLOCK)):
            film[base + lane] += ti.cast(ti.floor(row[lane] * weight + ti.f32(0.5)), ti.i64)


@ti.func
def node_count(du, dv, sigma):
    """Return the number of dots that stand for a streak: 1, or 2 in each panel."""
    square, point = du * du + dv * dv, ti.f32(_POINT) * sigma
    n = 1
    if square > point * point:
        n = 2 * ti.cast(ti.ceil(ti.sqrt(square) / (ti.f32(_PANEL) * sigma)), ti.i32)
    return n


@ti.func
def clip(low, high, p, dp, first, last):
    """Return the part of 0 <= low <= s <= high <= 1 where first <= p + s dp <= last; empty if low > high."""
    if ti.abs(dp) > ti.f32(1e-3):
        s, t = (first - p) / dp, (last - p) / dp
        low, high = ti.max(low, ti.min(s, t)), ti.min(high, ti.max(s, t))
    return low, high


@ti.func
def visible_nodes(n, sigma, u, du, width, v, dv, top, bottom):
    """Return first, last: only nodes first <= i < last of n can touch columns 0..width and rows top..bottom."""
    first, last = 0, n
    if n > 2:
        reach = ti.cast(radius(sigma) + 2, ti.f32)
        low, high = ti.f32(0.0), ti.f32(1.0)
        low, high = clip(low, high, u, du, -reach, ti.cast(width, ti.f32) + reach)
        low, high = clip(low, high, v, dv, ti.cast(top, ti.f32) - reach, ti.cast(bottom, ti.f32) + reach)
        first = ti.max(0, ti.cast(ti.floor(low * ti.cast(n, ti.f32)), ti.i32) - 2)
        last = ti.min(n, ti.cast(ti.ceil(high * ti.cast(n, ti.f32)), ti.i32) + 2)
    return first, last


@ti.func
def anchor(n, size, u, v, du, dv, sigma):
    """Return (u, v, origin): where to count the panels of a streak from, and the number of the panel that begins there.

    A giant streak has millions of nodes, of which few are on the film. Counting from the first of these lets f32 resolve
    the distances; it must not depend on the rows that are being drawn, or the bands would not fit together.
    """
    origin = 0
    if n > 2:
        origin = visible_nodes(n, sigma, u, du, size[0], v, dv, 0, size[1])[0] >> 1
        if origin > 0:
            s = ti.cast(origin, ti.f32) * ti.f32(2.0) / ti.cast(n, ti.f32)
            # Rounding to 1/64 px keeps fast-math from merging this sum with the one for the node.
            u = ti.floor((u + s * du) * ti.f32(64.0)) * ti.f32(1.0 / 64.0)
            v = ti.floor((v + s * dv) * ti.f32(64.0)) * ti.f32(1.0 / 64.0)
    return u, v, origin


@ti.func
def node(i, n, origin):
    """Return how far node i of n is from the start of panel `origin`; 1 is the length of the streak."""
    s = ti.f32(0.5)
    if n > 1:
        # The nodes of panel p: (p + 1/2 -+ 1 / (2 sqrt 3)) / panels
        p, side = ti.cast((i >> 1) - origin, ti.f32), ti.cast(2 * (i & 1) - 1, ti.f32)
        s = (p + (ti.f32(0.5) + ti.f32(_NODE) * side)) * (ti.f32(2.0) / ti.cast(n, ti.f32))
    return s


@ti.func
def draw_streak(film: ti.template(), marks: ti.template(), size, top, bottom, u, v, du, dv, sigma, energy):
    """Add the dot at (u, v), or its streak towards (u + du, v + dv), to the rows top <= y < bottom, of one band.

    `size` is the (width, height) of the film.
    """
    n = node_count(du, dv, sigma)
    u0, v0, origin = anchor(n, size, u, v, du, dv, sigma)
    first, last = visible_nodes(n, sigma, u, du, size[0], v, dv, top, bottom)
    share = energy / ti.cast(n, ti.f32)
    for i in range(first, last):
        s = node(i, n, origin)
        draw_dot(film, marks, size[0], top, bottom, u0 + s * du, v0 + s * dv, sigma, share)


@ti.func
def streak_pieces(size, u, v, du, dv, sigma):
    """Return how many pieces the part of a streak has that may be on the film, i64."""
    first, last = visible_nodes(node_count(du, dv, sigma), sigma, u, du, size[0], v, dv, 0, size[1])
    return ti.cast(ti.max(last - first, 0), ti.i64) * ti.cast(piece_count(sigma), ti.i64)


@ti.func
def draw_streak_piece(film: ti.template(), size, piece, u, v, du, dv, sigma, energy):
    """Add one piece of those that `streak_pieces` counted, atomically."""
    n = node_count(du, dv, sigma)
    u0, v0, origin = anchor(n, size, u, v, du, dv, sigma)
    first, _ = visible_nodes(n, sigma, u, du, size[0], v, dv, 0, size[1])
    pieces = ti.cast(piece_count(sigma), ti.i64)
    s = node(first + ti.cast(piece // pieces, ti.i32), n, origin)
    draw_piece(
        film, size, ti.cast(piece % pieces, ti.i32), u0 + s * du, v0 + s * dv, sigma, energy / ti.cast(n, ti.f32)
    )
