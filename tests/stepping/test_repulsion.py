"""Vertices that push each other off: forces against all pairs, a head-on meeting against its closed form, a sheet on a sheet."""

import numpy as np
import pytest
import taichi as ti
from mesh_bench import FRAME, motion, run

import tparticles as tp
from tparticles import schemes
from tparticles.systems.hashed_grid import HashedGrid

pytestmark = pytest.mark.usefixtures("cpu64")

ACCURATE = [s for s in schemes.CATALOGUE.values() if not s.implicit and 2 in s.system_orders and s.order >= 4]


def test_forces_are_those_between_all_pairs():
    rng = np.random.default_rng(1)
    count, reach, stiffness, damping = 400, 0.07, 30.0, 0.3
    x, v = rng.random((count, 3)) * 0.5 - 0.25, rng.normal(size=(count, 3))
    z = tuple(ti.field(ti.f64, count) for _ in range(6))
    for field, column in zip(z, np.hstack([x, v]).T, strict=True):
        field.from_numpy(np.ascontiguousarray(column))
    grid = HashedGrid(tp.Repulsion(distance=reach, stiffness=stiffness, damping=damping), z, count)
    force = ti.Vector.field(3, ti.f64, count)
    grid.fill()

    @ti.kernel
    def gather():
        for _ in range(1):
            grid.sort(0)
        for i in range(count):
            force[i] = grid.force(i, 0)

    gather()
    d = x[None] - x[:, None]
    length = np.linalg.norm(d, axis=2)
    np.fill_diagonal(length, 1.0)
    along = np.einsum("ijk,ijk->ij", d / length[..., None], v[None] - v[:, None])
    pull = np.where(length < reach, np.minimum(stiffness * (length - reach) + damping * along, 0.0), 0.0)
    wanted = np.sum(pull[..., None] * d / length[..., None], axis=1)
    assert np.sum(length < reach) > 500
    assert force.to_numpy() == pytest.approx(wanted, abs=1e-12)


def pair(speed=1.0):
    """Return two masses that fly at each other, 0.3 m apart, without a spring between them."""
    x, v = [[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]], [[speed, 0.0, 0.0], [-speed, 0.0, 0.0]]
    return tp.Mesh(x=x, v=v, mass=[0.5, 0.5], springs=np.zeros((0, 2), int), stiffness=1.0)


@pytest.mark.parametrize("scheme", ACCURATE, ids=lambda s: s.name)
def test_two_masses_meet_as_on_half_a_swing(scheme):
    # r'' = -2 k / m (r - d) while r < d: in contact for half a period, then apart as fast as they came
    law = tp.Repulsion(distance=0.1, stiffness=400.0)
    bench = motion(pair(), scheme=scheme, dt=FRAME / 512, forces=(), repulsion=law)
    run(bench, 6)
    x, v = bench.system.read()
    frequency = np.sqrt(2 * law.stiffness / 0.5)
    left = 6 * FRAME - 0.2 / 2 - np.pi / frequency
    assert v[:, 0] == pytest.approx([-1.0, 1.0], abs=1e-5)
    assert x[1, 0] - x[0, 0] == pytest.approx(0.1 + 2 * left, abs=1e-5)
    assert np.abs(v.sum(axis=0)).max() < 1e-14


def falling(threads, *, serial=True, **options):
    """Return the heights [m] of a sheet that has fallen onto another one, above that, and the state of both."""
    tp.backend.stop()
    tp.backend.start(arch="cpu", threads=threads, precision="f64")
    sheet = tp.cloth(counts=(14, 14), size=0.52, mass=0.1, stiffness=60.0, damping=0.05)
    rim = np.flatnonzero(np.abs(sheet.x[:, :2]).max(axis=1) > 0.25)
    both = sheet.pin(rim).joined(sheet.scaled(0.8).moved((0.011, 0.007, 0.15)))
    bench = motion(both, dt=1 / 2000, forces=(tp.Gravity(), tp.Drag(time=0.5)), **options)
    bench.stepper.serial = serial
    run(bench, 12)
    x, v = bench.system.read()
    return x[sheet.vertex_count :, 2] - x[: sheet.vertex_count, 2].mean(), x, v


def test_a_sheet_does_not_fall_through_another_the_same_with_any_number_of_threads():
    law = tp.Repulsion(distance=0.032, stiffness=60.0, damping=0.02)
    through, on = falling(1)[0], falling(1, repulsion=law)
    assert through.max() < -0.1 and on[0].min() > 0.0
    for serial in (True, False):
        assert np.array_equal(falling(2, serial=serial, repulsion=law)[1:], on[1:])


def test_what_cannot_be_is_refused():
    sheet = tp.cloth(counts=(4, 4), size=0.3)
    with pytest.raises(tp.InputError, match=r"repulsion\.distance = 0\.2 m is more than the shortest spring, 0\.1 m"):
        tp.MeshGroup(name="m", mesh=sheet, repulsion=tp.Repulsion(distance=0.2, stiffness=1.0))
    with pytest.raises(tp.InputError, match="repulsion needs an explicit scheme"):
        tp.MeshGroup(name="m", mesh=sheet, repulsion=tp.Repulsion(distance=0.1, stiffness=1.0), scheme="bdf2")


def test_the_stable_step_knows_the_repulsion():
    sheet = tp.cloth(counts=(4, 4), size=0.3, mass=0.16, stiffness=10.0)
    group = tp.MeshGroup(name="m", mesh=sheet)
    hard = tp.MeshGroup(name="m", mesh=sheet, repulsion=tp.Repulsion(distance=0.1, stiffness=1000.0))
    scheme = schemes.get("velocity-verlet")
    assert hard.stable_step(scheme) == pytest.approx(2 / np.sqrt(24 * 1000.0 / 0.01), rel=0.02)
    assert hard.stable_step(scheme) < 0.2 * group.stable_step(scheme)
