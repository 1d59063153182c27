"""What annotations call numbers, and which of them are known now.

A number is concrete (Python, NumPy) or belongs to JAX (an array, a tracer). Concrete
numbers stay NumPy float64 in a module, so that a scene built in a 32-bit session loses
no digits in a 64-bit sweep.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import or_

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

# A number: of JAX (an array of shape (), a tracer), or concrete (Python's or NumPy's
# float64, which is one).
Scalar = Float[Array, ""] | float
Flag = Bool[Array, ""] | bool  # yes or no, known now or traced
Count = Int[Array, ""] | int  # a whole number, known now or traced
Pair = tuple[Scalar, Scalar]  # one number a joint, or one a rod
Flags = tuple[Flag, Flag]  # the same of yes and no
Numbers = tuple[Scalar, ...]  # any number of them, e.g. a state and differences
OneOrEach = Scalar | Numbers  # one number for all joints, or one a joint
Two = Sequence[Scalar] | Float[Array, " 2"]  # a pair, as it may be given
Several = Sequence[Scalar] | Float[Array, " n"]  # one a rod, as they may be given
Joints = Scalar | Several
Option = Scalar | str | None  # an option, as the record of a result has it


def is_concrete(x: object) -> bool:
    """Whether the value of `x` is known now, without JAX."""
    return not isinstance(x, jax.Array)


def equals(x: Scalar | None, value: float) -> bool:
    """Whether `x` is known now to be `value`: then a term can be left out."""
    if x is None or not is_concrete(x) or np.ndim(x):
        return False
    return float(x) == value


def any_of(flags: Iterable[Flag]) -> Flag:
    """Whether one of them is set."""
    return reduce(or_, flags)


def each(x: OneOrEach, n: int) -> Numbers:
    """One number for each of n joints or rods."""
    return x if isinstance(x, tuple) else (x,) * n


def is_real_scalar(x: object) -> bool:
    """Whether it is one real number, of those that `jax.eval_shape` gives."""
    if not isinstance(x, jax.ShapeDtypeStruct):
        return False
    return x.shape == () and not jnp.issubdtype(x.dtype, jnp.complexfloating)
