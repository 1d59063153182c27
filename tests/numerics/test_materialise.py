"""Numbers that many need are computed once, whoever needs them."""

import jax
import jax.numpy as jnp
import numpy as np

from ziegler_jax.numerics.materialise import materialise

X = np.linspace(0.1, 1.0, 64)


def compiled(function):
    return jax.jit(jax.vmap(function)).lower(X).compile().as_text()


def test_what_is_materialised_is_evaluated_once():
    """Two results need a sine: XLA puts it into the loop of each, unless told not to.

    Each loop is a computation of its own in the program's text.
    """

    def shared(kept):
        def point(x):
            s = materialise(x, jnp.sin, x) if kept else jnp.sin(x)
            return s * x, jnp.sqrt(s + x)

        return compiled(point).count(" sine(")

    assert shared(kept=True) == 1 < shared(kept=False)


def test_derivatives_pass_and_what_is_handed_through_is_the_input():
    def point(x):
        same, s = materialise(x, lambda x, y: (x, jnp.sin(x * y)), x, 2.0 * x)
        assert same is x
        return s * same

    def plain(x):
        return jnp.sin(x * 2.0 * x) * x

    for derive in (jax.grad, jax.jacfwd, lambda f: jax.grad(jax.grad(f))):
        ours, theirs = jax.vmap(derive(point))(X), jax.vmap(derive(plain))(X)
        # measured equal
        np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=1e-14)
