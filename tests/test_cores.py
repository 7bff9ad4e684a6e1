"""`quick_jit`: compiler options for the outermost function only, whatever is around it."""

from functools import partial

import jax
import jax.numpy as jnp
import pytest

from sonarjax._cores import quick_jit

REFUSED = {"no_such_option_of_xla": True}


def powers(x, count):
    return jnp.stack([x**k for k in range(count)])


def test_is_jit_with_options():
    quick = quick_jit(powers, static_argnames="count")
    x = jnp.arange(3.0)
    assert (quick(x, 4) == powers(x, 4)).all()
    assert (quick(x, count=4) == powers(x, 4)).all()


def test_options_are_given_where_it_is_outermost():
    refused = quick_jit(powers, REFUSED, static_argnames="count")
    with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option_of_xla"):
        refused(jnp.arange(3.0), 4)


@pytest.mark.parametrize("around", [jax.jit, jax.vmap, jax.jacfwd, jax.jacrev])
def test_options_are_left_out_inside_of_another(around):
    refused = quick_jit(powers, REFUSED, static_argnames="count")
    x = jnp.arange(3.0)
    assert (around(partial(refused, count=4))(x) == around(partial(powers, count=4))(x)).all()
