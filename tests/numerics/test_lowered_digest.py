"""A lowered program is known by what it computes, not by its functions' names."""

import jax
import jax.numpy as jnp
import pytest

from ziegler_jax.numerics.lowered_digest import lowered_digest


def square():
    """A function that JAX traces as one of its own."""
    return jax.jit(lambda x: x * x)


def cube():
    return jax.jit(lambda x: x * x * x)


def text(function):
    return jax.jit(function).lower(jnp.float32(2)).as_text()


def test_two_functions_that_are_alike_are_as_one():
    one, a, b = square(), square(), square()
    shared, apart = text(lambda x: one(one(x))), text(lambda x: b(a(x)))
    assert shared != apart
    assert lowered_digest(shared) == lowered_digest(apart)


def test_so_they_are_within_others():
    one, a, b = square(), square(), square()
    inner = jax.jit(lambda x: one(x) + 1)
    first, second = jax.jit(lambda x: a(x) + 1), jax.jit(lambda x: b(x) + 1)
    shared, apart = text(lambda x: inner(inner(x))), text(lambda x: second(first(x)))
    assert shared != apart
    assert lowered_digest(shared) == lowered_digest(apart)


@pytest.mark.parametrize(
    "other",
    [
        lambda x: square()(cube()(x)),  # in the other order
        lambda x: cube()(cube()(x)),
        lambda x: cube()(square()(x)) + 1,
        lambda x: cube()(x),
    ],
)
def test_what_computes_something_else_is_another_program(other):
    """All of them call functions that bear the same names."""
    program = text(lambda x: cube()(square()(x)))
    assert lowered_digest(program) != lowered_digest(text(other))


def test_a_constant_within_a_function_counts():
    a, b = jax.jit(lambda x: x + 1.5), jax.jit(lambda x: x + 1.25)
    assert lowered_digest(text(lambda x: a(x))) != lowered_digest(text(lambda x: b(x)))


def test_a_text_of_another_form_is_known_by_every_letter():
    assert lowered_digest("module {}") == lowered_digest("module {}")
    assert lowered_digest("module {}") != lowered_digest("module { }")


def foreign(target, **attributes):
    """A call of a function of another library; it is lowered, not compiled."""
    like = jax.ShapeDtypeStruct((), jnp.float32)
    return lambda x: jax.ffi.ffi_call(target, like)(x, **attributes)


def named_square():
    def square(x):
        return x * x

    return jax.jit(square)


def squared_twice(outer):
    """Two functions that are alike, `square` and `square_0`, and what calls them."""
    a, b = named_square(), named_square()
    return text(lambda x: outer(b(a(x))))


@pytest.mark.parametrize(
    "one, other",
    [
        (foreign("square"), foreign("square_0")),
        (foreign("f", says="@square"), foreign("f", says="@square_0")),
        (foreign("f", says="call @square("), foreign("f", says="call @square_0(")),
    ],
)
def test_a_name_that_is_no_call_of_a_function_is_kept(one, other):
    programs = squared_twice(one), squared_twice(other)
    for program in programs:
        assert "@square(" in program and "@square_0(" in program
    assert lowered_digest(programs[0]) != lowered_digest(programs[1])


def test_a_function_may_bear_the_name_of_the_foreign_one_that_it_calls():
    @jax.jit
    def my_op(x):
        return foreign("my_op")(x)

    program = text(lambda x: my_op(x))
    assert "call @my_op(" in program and "custom_call @my_op(" in program
    assert lowered_digest(program) != lowered_digest(program.replace("my_op", "other"))
