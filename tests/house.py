"""The plan of the package: which rooms there are, and what each may import.

    python tests/house.py [FOLDER]

counts it, of this checkout or of another's package: lines, lines of code without
docstrings, comments and blank lines, files in the longest folder, rooms, imports
against the rule, circles, calls of diffrax, laws asked for by their class.
"""

import ast
import collections
import graphlib
import io
import re
import sys
import tokenize
from pathlib import Path

# A room imports from those before it; rooms that share a place do not know each other.
ROOMS = [{"results", "runtime"}, {"context"}, {"numerics"}, {"model"}]
ROOMS += [{"linear", "solvers"}, {"motion"}, {"analysis", "sweep"}, {"units"}, {"plot"}]
ROOMS += [{"__init__"}, {"__main__"}]
PLACE = {room: i for i, rooms in enumerate(ROOMS) for room in rooms}


def plan(package):
    """The files that each file of a package imports, all as paths below it."""
    files = sorted(package.rglob("*.py"))
    return {_parts(package, path): _imports(package, path) for path in files}


def against_the_rule(file, imported):
    """Those of a file's imports that stand in no room before its own."""
    here, nowhere = PLACE.get(file[0], -1), len(ROOMS)
    return [
        other
        for other in imported
        if other[0] != file[0] and PLACE.get(other[0], nowhere) >= here
    ]


def in_a_circle(files):
    """Files that import themselves through others; None if none does."""
    try:
        list(graphlib.TopologicalSorter(files).static_order())
    except graphlib.CycleError as error:
        return error.args[1]
    return None


def code_lines(text):
    """Lines of code without docstrings, comments and blank lines."""
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.string.strip() and token.type != tokenize.COMMENT:
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        holds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        if isinstance(node, holds) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            lines -= set(range(docstring.lineno, docstring.end_lineno + 1))
    return len(lines)


def calls(package, name):
    """The files that call `name`, each as often as it does, with the calls."""
    for file in plan(package):
        tree = ast.parse(package.joinpath(*file).with_suffix(".py").read_text())
        for node in ast.walk(tree):
            called = getattr(node, "func", None)
            if name in (getattr(called, "id", None), getattr(called, "attr", None)):
                yield file, node


def asked_for_laws(package):
    """Where `isinstance` asks for a final law outside of the law's own file."""
    home = {}
    for file in plan(package):
        tree = ast.parse(package.joinpath(*file).with_suffix(".py").read_text())
        for node in ast.walk(tree):
            bases = [getattr(b, "id", "") for b in getattr(node, "bases", [])]
            if any(
                re.fullmatch(r"Abstract\w*(Damping|Friction|Load)", b) for b in bases
            ):
                home[node.name] = file
    return [
        (file, law)
        for file, node in calls(package, "isinstance")
        for law in (getattr(x, "id", None) for x in ast.walk(node.args[1]))
        if not str(law).startswith("Abstract") and home.get(law, file) != file
    ]


def count(package):
    """What `python tests/house.py` prints."""
    files = plan(package)
    texts = [path.read_text() for path in package.rglob("*.py")]
    folders = collections.Counter(file[:-1] for file in files)
    return {
        "lines": sum(text.count("\n") for text in texts),
        "lines of code": sum(map(code_lines, texts)),
        "files": len(files),
        "files in the longest folder": max(folders.values()),
        "folders": len(folders),
        "imports against the rule": sum(
            len(against_the_rule(file, other)) for file, other in files.items()
        ),
        "a circle": in_a_circle(files) is not None,
        "calls of diffeqsolve": len(list(calls(package, "diffeqsolve"))),
        "laws asked for by isinstance": len(asked_for_laws(package)),
    }


def _parts(package, path):
    return path.relative_to(package).with_suffix("").parts


def _imports(package, path):
    parents, found = _parts(package, path), set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            found |= {tuple(n[1:]) for n in names if n[0] == package.name}
        elif isinstance(node, ast.ImportFrom):
            module = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                base = parents[: len(parents) - node.level] + module
            elif module[:1] == (package.name,):
                base = module[1:]
            else:
                continue
            files = [(*base, alias.name) for alias in node.names]
            known = [package.joinpath(*f).with_suffix(".py").exists() for f in files]
            found |= {f if is_ else base for f, is_ in zip(files, known, strict=True)}
    folders = {f for f in found if package.joinpath(*f).is_dir()}
    return found - folders | {(*f, "__init__") for f in folders}


if __name__ == "__main__":
    here = Path(__file__).parents[1] / "ziegler_jax"
    for what, number in count(Path(*sys.argv[1:]) if sys.argv[1:] else here).items():
        print(f"{what:28s} {number}")
