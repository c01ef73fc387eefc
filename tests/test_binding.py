"""Binding: numbers of a law are data of one compiled kernel; the rest is compiled in."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import taichi as ti

from tparticles import backend
from tparticles.binding import Parameters
from tparticles.errors import InputError
from tparticles.spec import Vec3, spec

pytestmark = pytest.mark.usefixtures("cpu32")


@dataclass(frozen=True)
class Inner:
    weight: float = 3.0

    @ti.func
    def value(self, x):
        return self.weight * x


@dataclass(frozen=True)
class Law:
    gain: float = 2.0
    offset: tuple = (1.0, 0, 0)
    steps: int = 3
    doubled: bool = False
    kinds: tuple = (1, 2)
    name: str = "law"
    inner: Inner = field(default_factory=Inner)
    several: tuple = (Inner(weight=10.0), Inner(weight=100.0))
    nothing: object = None

    def derived(self):
        return {"table": np.arange(self.steps) * 1000.0, "square": self.gain**2}

    @ti.func
    def value(self, x):
        v = self.gain * x + self.offset[0] + self.square + self.inner.value(x)
        for i in range(self.steps):
            v += self.table[i]
        for part in ti.static(self.several):
            v += part.value(x)
        if ti.static(self.doubled):
            v *= 2.0
        return v

    def expected(self, x):
        v = self.gain * x + self.offset[0] + self.gain**2 + self.inner.weight * x
        v += sum(range(self.steps)) * 1000.0 + sum(part.weight for part in self.several) * x
        return v * (2 if self.doubled else 1)


@ti.data_oriented
class Evaluator:
    def __init__(self, law):
        self.parameters = Parameters()
        self.law = self.parameters.bind(law)

    @ti.kernel
    def run(self, x: float, values: ti.types.ndarray(ndim=1)) -> float:
        ti.static(self.parameters.read_from(values))
        return self.law.value(x)

    @ti.kernel
    def run_hoisted(self, x: float, values: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
        ti.static(self.parameters.read_from(values))
        for i in range(out.shape[0]):
            scalars = ti.Vector([values[k] for k in ti.static(range(len(self.parameters.scalars) + 1))])
            ti.static(self.parameters.hoist(scalars))
            out[i] = self.law.value(x + i)

    def __call__(self, x, values=None):
        return self.run(x, self.parameters.array if values is None else values)


@pytest.mark.parametrize(
    "law",
    [Law(), Law(gain=-1.5, offset=(7.0, 1.0, 1.0), steps=5, doubled=True, inner=Inner(weight=0.5), several=())],
)
def test_a_bound_law_has_the_value_of_its_attributes(law):
    assert Evaluator(law)(2.0) == pytest.approx(law.expected(2.0))


def test_other_numbers_are_other_data_of_the_same_kernel():
    first, second = Law(), Law(gain=5.0, offset=(0.5, 1.0, 2.0), inner=Inner(weight=-1.0))
    evaluator = Evaluator(first)
    assert evaluator(1.0) == pytest.approx(first.expected(1.0))
    compiled = len(evaluator.run._primal.compiled_kernels)
    other = Parameters()
    other.bind(second)
    assert evaluator(1.0, other.array) == pytest.approx(second.expected(1.0))
    assert len(evaluator.run._primal.compiled_kernels) == compiled


def test_hoisted_scalars_give_the_same():
    evaluator, out = Evaluator(Law()), np.zeros(5, np.float32)
    evaluator.run_hoisted(2.0, evaluator.parameters.array, out)
    np.testing.assert_allclose(out, [Law().expected(2.0 + i) for i in range(5)], rtol=1e-6)


def test_constants_stay_constants():
    bound = Parameters().bind(Law())
    assert (bound.steps, bound.doubled, bound.kinds, bound.name, bound.nothing) == (3, False, (1, 2), "law", None)
    assert type(bound).__name__ == "Law" and isinstance(bound, Law)
    assert isinstance(bound.inner, Inner) and len(bound.several) == 2


def test_the_pool_holds_scalars_then_tables_in_the_precision_of_the_run():
    pool = Parameters()
    pool.bind(Law(several=()))
    assert pool.array.dtype == np.float32
    # gain, offset, inner.weight, square, a spare, and the table
    assert pool.array.tolist() == [2.0, 1.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0, 1000.0, 2000.0]
    assert backend.current().precision == "f32"


def test_binding_more_refreshes_the_array():
    pool = Parameters()
    assert pool.array.tolist() == [0.0]
    pool.bind(Inner(weight=4.0))
    assert pool.array.tolist() == [4.0, 0.0]


def test_attributes_can_be_left_out():
    pool = Parameters()
    bound = pool.bind(Law(), skip=("several", "inner", "table"))
    assert "several" not in vars(bound) and len(pool.scalars) == 5


def test_a_law_may_be_a_plain_object():
    class Plain:
        def __init__(self):
            self.rate = 2.5

        @ti.func
        def value(self, x):
            return self.rate * x

    law = Plain()
    evaluator = Evaluator(law)
    assert evaluator(2.0) == 5.0
    law.rate = -1.0
    pool = Parameters()
    pool.bind(law)
    assert evaluator(2.0, pool.array) == -2.0


def test_specs_bind_too():
    @spec
    class Thing:
        v: Vec3 = (1.0, 2.0, 3.0)

        @ti.func
        def value(self, x):
            return x * self.v.sum()

    assert Evaluator(Thing(v=(1, 1, 2)))(2.0) == 8.0


@pytest.mark.parametrize("array", [np.zeros((2, 2)), np.zeros(()), np.array(["a"]), np.array([1j])])
def test_arrays_that_kernels_cannot_index_are_refused(array):
    with pytest.raises(InputError, match=r"a law's array must be one-dimensional and real"):
        Parameters().table(array)
