"""A lowered program, known by what it computes.

JAX gives each function that it traced a name, and a number where the name is taken.
Two that are alike may be one function or two, as its caches still had the first or not
when the second was asked for. The text of a program therefore tells of this process's
history, too. What follows does not: it is the same in a process that has swept all
day, in a worker, and in one that goes on with a store.
"""

import hashlib
import re

_FUNCTION = re.compile(r"^  func\.func .*?^  \}$", re.MULTILINE | re.DOTALL)
_SYMBOL = re.compile(r'@("[^"]*"|[\w.$-]+)')


def lowered_digest(text: str) -> str:
    """A hash of a program in StableHLO, each function by its own hash, not its name."""
    functions = {_symbol(each): each for each in _FUNCTION.findall(text)}
    digests: dict[str, str] = {}

    def named(symbol: re.Match[str]) -> str:
        name = symbol[1]
        return digest(name) if name in functions else symbol[0]

    def digest(name: str) -> str:
        if name not in digests:  # none calls itself: it would never end
            own = _SYMBOL.sub("", functions[name], count=1)
            digests[name] = _hash(_SYMBOL.sub(named, own))
        return digests[name]

    around = _FUNCTION.sub("", text).split()
    return _hash(" ".join([*around, digest("main")]) if "main" in functions else text)


def _symbol(function: str) -> str:
    """The name that a function has in its first line."""
    symbol = _SYMBOL.search(function)
    return "" if symbol is None else symbol[1]


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
