"""Adams' PEC methods for steps of any sizes: what they integrate is the polynomial through the slopes of the steps before.

The polynomial is Newton's, so that each slope adds a term and leaves the others as they are. A particle that has one slope takes
a step of order one, and an order more with each step until it has them all. The corrector is one term more, the slope at the
step's end, and that term is what is known of the predictor's error.

Source: L. F. Shampine, M. K. Gordon, Computer Solution of Ordinary Differential Equations (1975), chapters 3-5;
Hairer, Norsett, Wanner, Solving ODEs I, section III.5.
"""

# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti


@ti.func
def predict(b: ti.template(), lasts: ti.template()):
    """z = z0 + the integral over the step of the polynomial through the slopes k_1, k_2, ... that a lane has, `b.filled` of them.

    k_1 is the slope where the step begins, k_(1+n) the one n steps before. `lasts`: sizes of the last steps [s], the latest first.
    """
    for lane in range(b.lanes):
        slopes = ti.static(len(lasts) + 1)
        nodes = _nodes(b, lane, lasts)
        weights = ti.Vector([0.0] * slopes)
        product = ti.Vector([1.0] + [0.0] * slopes)  # of (s - node), by powers of s
        for i in ti.static(range(slopes)):
            used = i < b.filled[lane]
            area = _area(product, i)
            for j in ti.static(range(i + 1)):
                apart = area * 0.0 + 1.0
                for other in ti.static(range(i + 1)):
                    if ti.static(other != j):
                        apart *= nodes[j] - nodes[other]
                weights[j] += ti.select(used, area / ti.select(used, apart, 1.0), 0.0)
            for power in ti.static(range(i + 1, 0, -1)):
                product[power] = product[power - 1] - nodes[i] * product[power]
            product[0] *= -nodes[i]
        for d in ti.static(range(len(b.k))):
            others = b.h[lane] * 0.0
            for j in ti.static(range(1, slopes)):
                others += weights[j] * b.k[d][(1 + j) * b.lanes + lane]
            # the latest slope last but z0, the largest of all: one rounding counts
            b.z[d][lane] = b.z0[d][lane] + b.h[lane] * (others + weights[0] * b.k[d][b.lanes + lane])


@ti.func
def correct(b: ti.template(), lasts: ti.template()):
    """z += `b.estimate`, which is the term of the slope k_0 at the step's end, after `predict`."""
    for lane in range(b.lanes):
        slopes = ti.static(len(lasts) + 1)
        nodes = _nodes(b, lane, lasts)
        product = ti.Vector([1.0] + [0.0] * slopes)
        end = b.h[lane] * 0.0 + 1.0
        for i in ti.static(range(slopes)):
            used = i < b.filled[lane]
            end *= ti.select(used, 1.0 - nodes[i], 1.0)
            for power in ti.static(range(i + 1, 0, -1)):
                product[power] = ti.select(used, product[power - 1] - nodes[i] * product[power], product[power])
            product[0] = ti.select(used, -nodes[i] * product[0], product[0])
        area = _area(product, slopes)
        weights = ti.Vector([0.0] * slopes)
        for j in ti.static(range(slopes)):
            apart = nodes[j] - 1.0
            for other in ti.static(range(slopes)):
                if ti.static(other != j):
                    apart *= ti.select(other < b.filled[lane], nodes[j] - nodes[other], 1.0)
            used = j < b.filled[lane]
            weights[j] = ti.select(used, area / ti.select(used, apart, 1.0), 0.0)
        for d in ti.static(range(len(b.k))):
            term = (area / end) * b.k[d][lane]
            for j in ti.static(range(slopes)):
                term += weights[j] * b.k[d][(1 + j) * b.lanes + lane]
            b.estimate[d][lane] = b.h[lane] * term
            b.z[d][lane] += b.estimate[d][lane]


@ti.func
def _nodes(b: ti.template(), lane, lasts: ti.template()):
    """Return when the slopes k_1, k_2, ... were, in steps from the beginning of this one: 0, and what is negative."""
    found = ti.Vector([0.0] * ti.static(len(lasts) + 1))
    size = ti.select(b.h[lane] > 0.0, b.h[lane], 1.0)
    back = size * 0.0
    for n in ti.static(range(len(lasts))):
        back -= lasts[n][lane] / size
        found[n + 1] = back
    return found


@ti.func
def _area(polynomial, degree: ti.template()):
    """Return the integral from 0 to 1 of a polynomial, given by powers."""
    total = polynomial[0] * 1.0
    for power in ti.static(range(1, degree + 1)):
        total += polynomial[power] * ti.static(1 / (power + 1))
    return total
