"""The largest frequency and damping rate of a mesh against the eigenvalues of its matrices."""

import dataclasses
import math

import numpy as np
import pytest

import tparticles as tp
from tparticles.physics.mesh_rates import Rates, estimated_rates, largest_rates

RNG = np.random.default_rng(2)
STAR = tp.Mesh(x=RNG.normal(size=(40, 3)), springs=[[0, k] for k in range(1, 40)], mass=RNG.uniform(0.5, 2, 40))
MESHES = {
    "box": tp.spring_box(),
    "rope": tp.rope(count=30, bend=300, damping=0.2),
    "cloth": tp.cloth(counts=(10, 9), damping=0.01),
    "pinned cloth": tp.cloth(counts=(10, 9), shear=100, bend=1e5).pin([0, 9]),
    "jelly": tp.lattice(counts=4, damping=0.1),
    "ball": tp.sphere_shell(subdivisions=1),
    "star": STAR,
    "two": tp.rope(count=9).joined(tp.rope(count=5, stiffness=1100)),
}


def largest(mesh, x, weights, across):
    """Return the largest eigenvalue of M^-1/2 K M^-1/2, the matrix written out."""
    K = np.zeros((len(x), 3, len(x), 3))
    for (i, j), k, side in zip(mesh.springs, weights, across, strict=True):
        n = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        block = k * np.outer(n, n) + side * (np.eye(3) - np.outer(n, n))
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            K[a, :, b] += sign * block
    w = np.repeat(np.where(mesh.pinned, 0, mesh.mass**-0.5), 3)
    return np.linalg.eigvalsh(w[:, None] * K.reshape(len(w), -1) * w)[-1]


def exact(mesh, x):
    length = np.linalg.norm(x[mesh.springs[:, 1]] - x[mesh.springs[:, 0]], axis=1)
    stiffness = largest(mesh, x, mesh.stiffness, mesh.stiffness * (1 - mesh.rest / length))
    return Rates(stiffness=stiffness, damping=largest(mesh, x, mesh.damping, np.zeros(len(length))))


def places(mesh):
    """Return positions: at rest, disturbed, stretched to ten times the size, and all folded onto a line."""
    noise = RNG.normal(size=mesh.x.shape)
    line = 1e-9 * noise + RNG.permutation(mesh.vertex_count)[:, None] * [1.0, 0.0, 0.0]
    return mesh.x, mesh.x + 0.2 * mesh.rest.mean() * noise, 10 * mesh.x, line


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_bounds_hold_wherever_the_vertices_are(mesh):
    bound = largest_rates(mesh)
    anywhere = estimated_rates(mesh)
    for x in places(mesh):
        here = exact(mesh, x)
        assert here.stiffness <= bound.stiffness * (1 + 1e-9) and here.damping <= bound.damping * (1 + 1e-9)
        assert here.stiffness <= anywhere.stiffness * (1 + 1e-9)
    folded = exact(mesh, places(mesh)[-1])
    # folded onto a line with l > l0 everywhere or not, nothing is stiffer along the line
    assert anywhere.stiffness == pytest.approx(folded.stiffness, rel=0.01)
    assert bound.stiffness <= 2 * anywhere.stiffness


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_estimates_agree_with_the_eigenvalues(mesh):
    for x in places(mesh)[:3]:
        found, here = estimated_rates(mesh, x), exact(mesh, x)
        assert found.stiffness == pytest.approx(here.stiffness, rel=0.01)
        assert found.damping == pytest.approx(here.damping, rel=0.01, abs=1e-12)
        # too low by nothing that a safety factor in the step would notice
        assert found.stiffness > 0.999 * here.stiffness


def test_the_box_swings_at_8_k_over_m():
    # m w^2 = 8 k, and 6 k without body diagonals
    box = tp.spring_box(stiffness=250.0)
    assert estimated_rates(box, box.x).stiffness == pytest.approx(8 * 250, rel=1e-12)
    light = tp.spring_box(stiffness=250.0, body_diagonal=0, mass=4.0)
    assert estimated_rates(light, light.x).stiffness == pytest.approx(6 * 250 / 0.5, rel=1e-12)
    assert largest_rates(box).stiffness == pytest.approx(14 * 250, rel=1e-12)  # Gershgorin: twice seven springs
    assert estimated_rates(box, box.x).damping == pytest.approx(8 * 0.1, rel=1e-12)


def test_a_chain_swings_as_the_textbook_says():
    # free chain of n masses: w^2 = 4 k / m sin^2(pi (n - 1) / (2 n)); no odd cycle, so the bound is sharp
    n, k, m = 12, 50.0, 0.1
    chain = tp.rope(count=n, stiffness=k, mass=n * m)
    textbook = 4 * k / m * math.sin(math.pi * (n - 1) / (2 * n)) ** 2
    assert estimated_rates(chain).stiffness == pytest.approx(textbook, rel=0.003)
    assert textbook < largest_rates(chain).stiffness < 1.02 * textbook
    assert largest_rates(chain).frequency == largest_rates(chain).stiffness ** 0.5


def test_a_hub_does_not_count_its_spokes_twice():
    n = 500
    hub = tp.Mesh(x=RNG.normal(size=(n + 1, 3)), springs=[[0, k] for k in range(1, n + 1)], stiffness=2.0, mass=0.5)
    # a star's Laplacian: n + 1
    assert largest_rates(hub).stiffness == pytest.approx((n + 1) * 4, rel=0.01)


def test_what_cannot_swing_has_no_rate():
    alone = tp.Mesh(x=np.zeros((2, 3)))
    held = tp.rope(count=3).pin([0, 1, 2])
    for mesh in (alone, held, dataclasses.replace(tp.rope(), stiffness=0.0)):
        for rates in (largest_rates(mesh), estimated_rates(mesh), estimated_rates(mesh, mesh.x)):
            assert rates == Rates(stiffness=0.0, damping=0.0)


def test_stiffness_over_nine_decades_is_found():
    chain = tp.rope(count=60, stiffness=1.0).with_springs([[10, 12]], stiffness=1e9)
    assert estimated_rates(chain, chain.x).stiffness == pytest.approx(exact(chain, chain.x).stiffness, rel=1e-6)
    assert largest_rates(chain).stiffness == pytest.approx(estimated_rates(chain).stiffness, rel=1e-6)
