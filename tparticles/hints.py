"""What a kernel tells LLVM about its loops: where vectors are safe, and where more copies of a loop gain nothing."""
# pyright: reportInvalidTypeForm=false

import taichi as ti

# A mask for an index that is below 2^30 anyhow: it tells LLVM that index + lane cannot wrap, without which there are no vectors.
NO_WRAP = (1 << 30) - 1


@ti.func
def rolled(counts: ti.template()):
    """Keep LLVM from unrolling the loops around this; `counts` is a field of i32 that are never negative.

    LLVM does not know that, and leaves loops alone in which a function may be called. Others it repeats up to eight times,
    for recent AMD processors until they have 4000 instructions, and all of it is compiled in each process.
    """
    if counts[0] < 0:
        counts[0] = ti.cast(ti.acos(ti.cast(counts[0], ti.f32)), ti.i32)
