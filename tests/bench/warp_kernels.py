"""Warp's kernels for the mesh bench: the gather and the move of symplectic Euler."""
# (Warp reads the annotations at run time: they are not strings)

import warp as wp


@wp.kernel
def kick(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    starts: wp.array(dtype=wp.int32),
    column: wp.array(dtype=wp.int32),
    stiffness: wp.array(dtype=wp.float32),
    rest: wp.array(dtype=wp.float32),
    inverse: wp.array(dtype=wp.float32),
    dt: wp.float32,
    g: wp.float32,
):
    i = wp.tid()
    f = wp.vec3()
    at = x[i]
    for e in range(starts[i], starts[i + 1]):
        d = x[column[e]] - at
        f += stiffness[e] * (1.0 - rest[e] / wp.length(d)) * d
    w = inverse[i]
    if w > 0.0:
        v[i] = v[i] + dt * (w * f + wp.vec3(0.0, 0.0, g))


@wp.kernel
def drift(x: wp.array(dtype=wp.vec3), v: wp.array(dtype=wp.vec3), dt: wp.float32):
    i = wp.tid()
    x[i] = x[i] + dt * v[i]
