"""What the type checker must refuse: a flat tuple where a state is meant.

`test_package.py` has it checked; nothing runs it.
"""

from ziegler_jax.model.state import PhasePoint
from ziegler_jax.model.system import System


def flat(system: System) -> None:
    """Angles and rates that nobody has said to be a state."""
    system.field(0.0, (0.1, 0.2, 0.0, 0.0))
    system.energy((0.1, 0.2, 0.0, 0.0))


def right(system: System) -> None:
    """The same, said to be one."""
    system.field(0.0, PhasePoint((0.1, 0.2, 0.0, 0.0)))
