"""Products of matrices are asked for in full float32: a GPU would otherwise round their entries to 10 bits.

And JAX's 64-bit mode ends in one clear error, unless a call switches it off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sonarjax as sj
from sonarjax.exact import full_precision
from sonarjax.scene.objects import brick
from sonarjax.sensor import observe_scene

SONAR = sj.Sonar.preset("didson-hf", tilt=math.radians(20.0), height=0.9, range_min=1.5, range_max=4.0)
POSE = sj.Pose(2.3, 0.05, 0.7)
FULL = {(jax.lax.Precision.HIGHEST,) * 2, jax.lax.Precision.HIGHEST}


def products(jaxpr: Any) -> Iterator[Any]:
    """Every product of float matrices in a program, those of its loops and inner programs too."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general" and jnp.issubdtype(equation.invars[0].aval.dtype, jnp.floating):
            yield equation
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                yield from products(inner)


def rounded(function: Callable[..., Any], *args: Any) -> tuple[int, list[Any]]:
    """How many products of matrices `function` takes, and those that a GPU would round."""
    found = list(products(jax.make_jaxpr(function)(*args).jaxpr))
    return len(found), [equation for equation in found if equation.params["precision"] not in FULL]


def refined(pose: sj.Pose) -> Any:
    return sj.refine_yaw(jnp.full(SONAR.shape, 0.5), brick(), SONAR, pose).yaw


def in_all_directions(pose: sj.Pose) -> Any:
    return jax.jacfwd(lambda p: sj.render(brick(), p, SONAR).semantic())(pose)


def loss(pose: sj.Pose) -> Any:
    return (sj.render(brick(), pose, SONAR).semantic() ** 2).sum()


WORK: dict[str, Callable[[sj.Pose], Any]] = {
    "pose": lambda pose: pose.to_ground(brick().vertices),
    "render": lambda pose: sj.render(brick(), pose, SONAR).semantic(),
    "gradient": jax.grad(loss),
    "jacobian": in_all_directions,
    "observe": lambda pose: observe_scene(brick(), pose, SONAR, sj.SensorModel.nominal(), key=jax.random.key(0)),
    "refine_yaw": refined,
}


IN_64_BITS: dict[str, Callable[[], Any]] = {
    "render": lambda: sj.render(brick(), POSE, SONAR),
    "observe": lambda: observe_scene(brick(), POSE, SONAR, sj.SensorModel.nominal(), key=jax.random.key(0)),
    "template_bank": lambda: sj.template_bank(brick(), SONAR, np.array([0.0, 0.5]), x=2.3),
    "refine_yaw": lambda: refined(POSE),
    "segment": lambda: sj.segment(np.full(SONAR.shape, 0.5), sj.load_segmenter().weights),
    "recognize": lambda: sj.recognize(np.full(SONAR.shape, 0.5), brick(), SONAR),
}


@pytest.mark.parametrize("name", WORK)
def test_no_product_of_matrices_is_rounded(name: str) -> None:
    count, bad = rounded(WORK[name], POSE)
    assert count and not bad, bad[:3]


def test_the_search_finds_a_product_that_is_rounded() -> None:
    square = np.ones((3, 3), np.float32)
    assert rounded(jax.jit(lambda a: jax.lax.map(lambda b: b @ b, a[None])), square)[1]
    assert rounded(full_precision(lambda a: a @ a), square) == (1, [])


def test_the_callers_choice_holds_outside() -> None:
    def both(a: jax.Array) -> jax.Array:
        return full_precision(lambda b: b @ b)(a) + a @ a

    count, bad = rounded(both, jnp.ones((2, 2)))
    assert (count, len(bad)) == (2, 1)


@pytest.mark.parametrize("name", IN_64_BITS)
def test_64_bit_mode_is_refused(name: str) -> None:
    with jax.enable_x64(True), pytest.raises(sj.SonarjaxError, match=r"JAX_ENABLE_X64: .*jax\.enable_x64\(False\)"):
        IN_64_BITS[name]()


def test_64_bit_mode_can_be_switched_off_for_a_call() -> None:
    with jax.enable_x64(True):
        yaw = jnp.asarray(POSE.yaw, jnp.float64)
        with jax.enable_x64(False):
            slope = jax.grad(loss)(sj.Pose(POSE.x, POSE.y, yaw)).yaw
    assert slope.dtype == jnp.float32
    assert float(slope) == float(jax.grad(loss)(POSE).yaw) != 0.0
