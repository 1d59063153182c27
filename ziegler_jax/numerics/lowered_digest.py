"""A lowered program, known by what it computes.

JAX gives each function that it traced a name, and a number where the name is taken.
Two that are alike may be one function or two, as its caches still had the first or not
when the second was asked for. The text of a program therefore tells of this process's
history, too. What follows does not: it is the same in a process that has swept all
day, in a worker, and in one that goes on with a store.
"""

import hashlib
import re

_NAME = r'@("[^"]*"|[\w.$-]+)'
_SYMBOL = re.compile(_NAME)
_FUNCTION = re.compile(
    rf"^  func\.func [^@\n]*{_NAME}[^\n]*\{{\n.*?^  \}}$", re.M | re.S
)
_CALL = re.compile(rf"^( *(?:%[\w:]+ = )?(?:func\.)?call ){_NAME}(?=\()", re.M)


def lowered_digest(text: str) -> str:
    """A hash of a program in StableHLO, each function by its own hash, not its name.

    Where the name of a function stands for anything but a call of it, be it a foreign
    function that bears the same one, the hash is that of the text as it is.
    """
    functions = {each[1]: each[0] for each in _FUNCTION.finditer(text)}
    names = sum(each[1] in functions for each in _SYMBOL.finditer(text))
    calls = sum(each[2] in functions for each in _CALL.finditer(text))
    if "main" not in functions or names != len(functions) + calls:
        return _hash(text)
    digests: dict[str, str] = {}

    def called(call: re.Match[str]) -> str:
        name = call[2]
        return call[1] + (digest(name) if name in functions else f"@{name}")

    def digest(name: str) -> str:
        if name not in digests:  # no function calls itself, or it would never end
            own = functions[name].replace(f"@{name}", "", 1)
            digests[name] = _hash(_CALL.sub(called, own))
        return digests[name]

    around = _FUNCTION.sub("", text).split()
    return _hash(" ".join([*around, digest("main")]))


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
