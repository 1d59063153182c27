"""Ctrl-C while JAX traces and compiles: held until that is done."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def held_interrupts() -> Iterator[None]:
    """Raise a Ctrl-C at the end of this block, not within it; a second one at once.

    Python drops a `KeyboardInterrupt` that meets a finaliser or a collector's callback
    ("Exception ignored in ..."), and tracing is full of them: the sweep then went on to
    its end. One that meets a function called from compiled code can leave the tables of
    JAX half-written. A compilation does not stop for it anyway.

    A handler that is not Python's own is left alone, and so are other threads than the
    main one, which get no signals.
    """
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    pressed = []

    def hold(*_: Any) -> None:
        pressed.append(True)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    signal.signal(signal.SIGINT, hold)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if pressed:
            raise KeyboardInterrupt
