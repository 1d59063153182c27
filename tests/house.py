"""The plan of the package: which rooms there are, and what each may import.

    python tests/house.py [FOLDER]

counts it, of this checkout or of another's package. A row a room: lines of code, casts,
comments that silence a linter or the type checker, asserts, `raise`s, and public names
by the room that they come from (`house.md` has those of 0.2.0). Then the whole: lines,
lines of code without docstrings, comments and blank lines, files in the longest folder,
rooms, imports against the rule, circles, calls of diffrax, laws asked for by their
class; the most arguments of a function (axes and constructors of values apart) and its
longest body, without its docstring; how often `Any` stands, or an alias of it; words
that are no names; and lines of docstrings and comments.
"""

import ast
import collections
import functools
import graphlib
import io
import re
import sys
import tokenize
from pathlib import Path

# A room imports from those before it; rooms that share a place do not know each other.
ROOMS = [{"results", "runtime"}, {"numerics"}, {"model"}]
ROOMS += [{"linear", "solvers"}, {"motion"}, {"steady"}]
ROOMS += [
    {"analysis", "sweep"},
    {"curves", "maps"},
    {"units"},
    {"plot"},
    {"__init__", "_main_both"},
    {"_main_picture"},
    {"__main__"},
]
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
    return len(_code_rows(text))


@functools.cache
def parsed(text):
    """The tree of a file's text."""
    return ast.parse(text)


@functools.cache
def tokens_of(text):
    """Its tokens."""
    return [*tokenize.generate_tokens(io.StringIO(text).readline)]


@functools.cache
def _code_rows(text):
    lines = set()
    for token in tokens_of(text):
        if token.string.strip() and token.type != tokenize.COMMENT:
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(parsed(text)):
        holds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        if isinstance(node, holds) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            lines -= set(range(docstring.lineno, docstring.end_lineno + 1))
    return lines


def calls(package, name):
    """The files that call `name`, each as often as it does, with the calls."""
    for file in plan(package):
        tree = parsed(package.joinpath(*file).with_suffix(".py").read_text())
        for node in ast.walk(tree):
            called = getattr(node, "func", None)
            if name in (getattr(called, "id", None), getattr(called, "attr", None)):
                yield file, node


def asked_for_laws(package):
    """Where `isinstance` asks for a final law outside of the law's own file."""
    home = {}
    for file in plan(package):
        tree = parsed(package.joinpath(*file).with_suffix(".py").read_text())
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


def functions(package):
    """All functions, each with the file that it is in."""
    for path in package.rglob("*.py"):
        for node in ast.walk(parsed(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield path, node


def arguments(function):
    """How many arguments a function takes, `self` and axes apart."""
    given = function.args.posonlyargs + function.args.args + function.args.kwonlyargs
    return len([a for a in given if a.arg not in ("self", "cls", "axes")])


def body_lines(function):
    """Lines of a function without its docstring and its signature."""
    body = function.body
    if ast.get_docstring(function) is not None:
        body = body[1:]
    return function.end_lineno - body[0].lineno + 1 if body else 0


def anys(texts):
    """How often `Any` stands in annotations, or an alias that is no more than it."""
    names, aliases = collections.Counter(), {"Any", "PyTree"}
    trees = [parsed(text) for text in texts]
    for tree in trees:
        for node in tree.body:
            if isinstance(node, ast.Assign) and getattr(node.value, "id", "") == "Any":
                aliases |= {target.id for target in node.targets}
    for tree in trees:
        names.update(n.id for n in ast.walk(tree) if isinstance(n, ast.Name))
    return sum(names[alias] for alias in aliases)


# Household words in place of a noun of the field.
PARTICIPLES = {"found", "seen", "kept", "heard", "held", "told"}
# The enumeration whose members may be called so: they are public and stay.
CODES = {"CODE"}


def participles(texts):
    """How often such a word is the name of something."""
    count = 0
    for text in texts:
        codes = _codes(text)
        for token in tokens_of(text):
            counts = token.type == tokenize.NAME and token.string in PARTICIPLES
            count += counts and token.start not in codes
    return count


def _codes(text):
    """Where members of the code tables are defined and used: `CODE.found` is public.

    Places are those of `tokenize`.
    """
    places = set()
    for node in ast.walk(parsed(text)):
        if isinstance(node, ast.ClassDef) and node.name in CODES:
            for line in node.body:
                targets = line.targets if isinstance(line, ast.Assign) else []
                places |= {(target.lineno, target.col_offset) for target in targets}
        elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") in CODES:
            places.add((node.end_lineno, node.end_col_offset - len(node.attr)))
    return places


def prose_lines(text):
    """Lines of docstrings and comments."""
    comments = {
        token.start[0] for token in tokens_of(text) if token.type == tokenize.COMMENT
    }
    filled = sum(bool(line.strip()) for line in text.split("\n"))
    return filled - code_lines(text) + len(comments & _code_rows(text))


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
        "most arguments": max(
            arguments(f) for _, f in functions(package) if f.name != "__init__"
        ),
        "longest function": max(body_lines(f) for _, f in functions(package)),
        "Any and its aliases": anys(texts),
        "participles for names": participles(texts),
        "lines of prose": sum(map(prose_lines, texts)),
    }


IGNORE = re.compile(r"# ?(type: ?ignore|pyright: ?ignore|noqa)")


def rooms(package):
    """A row a room: what its files hold, and how many public names come from it."""
    rows = collections.defaultdict(collections.Counter)
    for path in package.rglob("*.py"):
        text, room = path.read_text(), _parts(package, path)[0]
        nodes = [*ast.walk(parsed(text))]
        called = [getattr(n.func, "id", "") for n in nodes if isinstance(n, ast.Call)]
        rows[room].update({
            "code": code_lines(text),
            "casts": called.count("cast"),
            "ignores": len(IGNORE.findall(text)),
            "asserts": sum(isinstance(n, ast.Assert) for n in nodes),
            "raises": sum(isinstance(n, ast.Raise) for n in nodes),
        })  # fmt: skip
    for room in _public(package):
        rows[room]["names"] += 1
    return dict(sorted(rows.items(), key=lambda row: -row[1]["code"]))


def _public(package):
    """Of each public name the room that it is imported from."""
    tree = ast.parse((package / "__init__.py").read_text())
    home, names = {}, []
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.level:
            room = (node.module or "").split(".")[0]
            home |= {(a.asname or a.name): room or a.name for a in node.names}
        elif isinstance(node, ast.Assign) and node.targets[0].id == "__all__":
            names = [x.value for x in node.value.elts]
    return [home.get(name, "__init__") for name in names]


def table(package):
    """The rows as text, with their sums."""
    columns = ["code", "casts", "ignores", "asserts", "raises", "names"]
    found = rooms(package)
    found["all"] = sum(found.values(), collections.Counter())
    lines = [f"| room | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for room, row in found.items():
        lines.append(f"| {room} | {' | '.join(str(row[c]) for c in columns)} |")
    return "\n".join(lines)


def _parts(package, path):
    return path.relative_to(package).with_suffix("").parts


def _imports(package, path):
    parents, imported = _parts(package, path), set()
    for node in ast.walk(parsed(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            imported |= {tuple(n[1:]) for n in names if n[0] == package.name}
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
            imported |= {
                f if is_ else base for f, is_ in zip(files, known, strict=True)
            }
    folders = {f for f in imported if package.joinpath(*f).is_dir()}
    return imported - folders | {(*f, "__init__") for f in folders}


if __name__ == "__main__":
    here = Path(__file__).parents[1] / "ziegler_jax"
    chosen = Path(*sys.argv[1:]) if sys.argv[1:] else here
    print(table(chosen), end="\n\n")
    for what, number in count(chosen).items():
        print(f"{what:28s} {number}")
