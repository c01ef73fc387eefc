"""Adjacency: every spring twice, in a fixed order, in slices of 16 vertices; long rows overflow."""

import numpy as np
import pytest

import tparticles as tp
from tparticles.systems.topology import LANES, LONGEST, Adjacency, Rows

RNG = np.random.default_rng(3)


def hub(spokes):
    return tp.Mesh(x=RNG.normal(size=(spokes + 1, 3)), springs=[[k, 5] if k < 5 else [5, k + 1] for k in range(spokes)])


def shuffled(mesh):
    order, sides = RNG.permutation(mesh.spring_count), RNG.integers(0, 2, (mesh.spring_count, 1))
    springs = np.where(sides, mesh.springs, mesh.springs[:, ::-1])[order]
    return tp.Mesh(x=mesh.x, springs=springs, rest=mesh.rest[order])


MESHES = {
    "one vertex": tp.Mesh(x=np.zeros((1, 3))),
    "box": tp.spring_box(),
    "16 alone": tp.Mesh(x=np.zeros((16, 3))),
    "cloth": shuffled(tp.cloth(counts=(13, 7))),
    "jelly": tp.lattice(counts=4),
    "hub": hub(200),
    "just fits": hub(LONGEST),
    "one too many": hub(LONGEST + 1),
}
CASES = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)


def neighbours(mesh):
    """Return for each vertex the sorted (neighbour, spring) pairs, the plain way."""
    lists = [[] for _ in range(mesh.vertex_count)]
    for s, (i, j) in enumerate(mesh.springs.tolist()):
        lists[i].append((j, s))
        lists[j].append((i, s))
    return [sorted(pairs) for pairs in lists]


def of_rows(rows, row):
    part = slice(rows.starts[row], rows.starts[row + 1])
    return list(zip(rows.column[part].tolist(), rows.spring[part].tolist(), strict=True))


@CASES
def test_rows_list_every_neighbour_in_order(mesh):
    rows = Rows.of(mesh)
    assert [of_rows(rows, i) for i in range(mesh.vertex_count)] == neighbours(mesh)


@CASES
def test_slices_and_overflow_list_the_same_in_the_same_order(mesh):
    near = Adjacency.of(mesh)
    beyond = Rows(near.overflow, near.column, near.spring)
    for i, pairs in enumerate(neighbours(mesh)):
        entries = np.arange(near.starts[i // LANES], near.starts[i // LANES + 1]) * LANES + i % LANES
        found = list(zip(near.column[entries].tolist(), near.spring[entries].tolist(), strict=True))
        assert [pair for pair in found if pair[1] >= 0] + of_rows(beyond, i) == pairs
        assert all(pair == (i, -1) for pair in found if pair[1] < 0)  # padding: the vertex itself
    assert near.overflows == any(len(pairs) > LONGEST for pairs in neighbours(mesh))


@CASES
def test_the_last_block_is_filled_and_no_block_is_much_wider_than_needed(mesh):
    near = Adjacency.of(mesh)
    blocks = -(-mesh.vertex_count // LANES)
    assert len(near.starts) == blocks + 1 and len(near.column) == len(near.spring) == near.overflow[-1]
    assert near.overflow[0] == near.starts[-1] * LANES and len(near.overflow) == blocks * LANES + 1
    assert near.column.max(initial=0) < blocks * LANES
    degree = [min(len(pairs), LONGEST) for pairs in neighbours(mesh)]
    needed = np.array([max(degree[b * LANES : (b + 1) * LANES]) for b in range(blocks)])
    width = np.diff(near.starts)
    assert (needed <= width).all() and (width <= 1.5 * needed).all()
    assert near.column.dtype == near.spring.dtype == near.starts.dtype == near.overflow.dtype == np.int32


def straight_rows(mesh):
    near = Adjacency.of(mesh)
    values = np.append(mesh.stiffness, 0.0)[near.spring][None]
    return near, *near.straight(values)


@CASES
def test_a_straight_row_says_what_its_entries_say(mesh):
    near, first, lanes, (stiffness,) = straight_rows(mesh)
    assert len(first) == len(lanes) == len(stiffness) == near.starts[-1]
    for row in np.flatnonzero(first >= 0):
        for lane in range(LANES):
            column, spring = near.column[row * LANES + lane], near.spring[row * LANES + lane]
            assert (lanes[row] >> lane & 1) == (spring >= 0)
            # a lane without a spring reads a vertex of the mesh, too
            assert 0 <= first[row] + lane < (len(near.starts) - 1) * LANES
            if spring >= 0:
                assert (column, mesh.stiffness[spring]) == (first[row] + lane, stiffness[row])


@pytest.mark.parametrize("mesh", [tp.cloth(counts=(40, 40)), tp.lattice(counts=12)], ids=["cloth", "jelly"])
def test_the_rows_of_a_grid_are_straight_but_at_its_ends(mesh):
    first = straight_rows(mesh)[1]
    assert (first >= 0).mean() > 0.96
    # not where the springs of a row differ
    mixed = tp.Mesh(x=mesh.x, springs=mesh.springs, stiffness=RNG.uniform(1.0, 2.0, mesh.spring_count))
    assert (straight_rows(mixed)[1] >= 0).mean() < 0.1


def test_a_hub_of_a_million_spokes_pads_nobody():
    n = 1_000_000
    spokes = np.stack([np.zeros(n, int), np.arange(1, n + 1)], axis=1)
    near = Adjacency.of(tp.Mesh(x=np.arange(3.0 * n + 3).reshape(-1, 3), springs=spokes))
    assert len(near.column) < 2 * n + 100 * LANES  # two ends of each spring, and little else
    assert (near.column[near.overflow[0] : near.overflow[1]] == np.arange(LONGEST + 1, n + 1)).all()
    assert (near.overflow[1:] == near.overflow[-1]).all()


def test_a_gather_over_slices_is_the_sum_over_springs():
    mesh = shuffled(tp.cloth(counts=(20, 11)))
    near = Adjacency.of(mesh)
    weights = RNG.normal(size=mesh.spring_count)
    padded = np.append(weights, 0.0)[near.spring].reshape(-1, LANES)
    sums = np.concatenate([padded[a:b].sum(axis=0) for a, b in zip(near.starts, near.starts[1:], strict=False)])
    plain = np.bincount(mesh.springs.ravel(), np.repeat(weights, 2))
    np.testing.assert_allclose(sums[: mesh.vertex_count], plain, atol=1e-12)
