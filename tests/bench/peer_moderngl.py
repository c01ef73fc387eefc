"""The peer of the film: additive point sprites with moderngl, on whatever OpenGL the machine has (llvmpipe without a GPU)."""

from __future__ import annotations

from collections.abc import Callable

import moderngl
import numpy as np

_VERTEX = """
#version 330
in vec2 position;
in vec3 energy;
out vec2 centre;
out vec3 color;
uniform vec2 size;
void main() {
    gl_Position = vec4(position / size * 2.0 - 1.0, 0.0, 1.0);
    gl_PointSize = 5.0;
    centre = position;
    color = energy;
}
"""
_FRAGMENT = """
#version 330
in vec2 centre;
in vec3 color;
out vec4 light;
uniform float sigma;
void main() {
    vec2 d = (gl_FragCoord.xy - centre) / sigma;
    light = vec4(color * (exp(-0.5 * dot(d, d)) / (6.2831853 * sigma * sigma)), 0.0);
}
"""


def point_sprites(
    u: np.ndarray, v: np.ndarray, energy: np.ndarray, *, sigma: float, size: tuple[int, int]
) -> tuple[str, Callable[[], None], Callable[[], np.ndarray]]:
    """Return the renderer's name, a function that draws all dots and waits, and one that reads the film, (h, w, 3).

    The vertex buffer is filled beforehand, like the fields of `Dots`. RGBA32F, blending ONE + ONE.
    """
    context = moderngl.create_context(standalone=True, backend="egl")
    context.enable(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
    context.blend_func = moderngl.ONE, moderngl.ONE
    program = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
    program["size"] = size
    program["sigma"] = sigma
    vertices = np.column_stack([u, v, energy]).astype(np.float32)
    array = context.vertex_array(program, [(context.buffer(vertices.tobytes()), "2f 3f", "position", "energy")])
    target = context.framebuffer([context.texture(size, 4, dtype="f4")])
    target.use()

    def draw() -> None:
        array.render(moderngl.POINTS)
        context.finish()

    def read() -> np.ndarray:
        data = np.frombuffer(target.read(components=3, dtype="f4"), dtype=np.float32)
        target.clear()
        return data.reshape(size[1], size[0], 3)

    read()
    return context.info["GL_RENDERER"], draw, read
