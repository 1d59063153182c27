"""What can happen to files: a process that is stopped, a disk that errs."""

import os
import sys
from contextlib import contextmanager
from pathlib import Path

# Python tells of these before it does them, whoever asks: the package, Zarr, shutil.
OPERATIONS = {
    "open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate",
    "os.listdir", "os.scandir", "shutil.rmtree",
}  # fmt: skip


class Killed(BaseException):
    """The process is no more: nothing that it does from here on has an effect."""


class _Watch:
    """Counts the file operations within a folder, and stops before one of them."""

    def __init__(self):
        self.folder, self.count, self.last = None, 0, None

    def __call__(self, event, arguments):
        if self.folder is None or event not in OPERATIONS or not arguments:
            return
        path = arguments[0]
        if not isinstance(path, str | bytes | os.PathLike):
            return
        if not os.fsdecode(path).startswith(self.folder):
            return
        self.count += 1
        if self.last is not None and self.count > self.last:
            raise Killed


_WATCH = _Watch()
sys.addaudithook(_WATCH)  # for good: there is no way to take one away


@contextmanager
def stopped_before(operation, folder: Path):
    """Let a process die before its n-th file operation in `folder`, counted from 1.

    None only counts them: the count is that of the object that this gives.
    """
    _WATCH.count = 0
    _WATCH.last = None if operation is None else operation - 1
    _WATCH.folder = str(folder)
    try:
        yield _WATCH
    finally:
        _WATCH.folder = None


def flip(path: Path, bit: int) -> None:
    """Turn one bit of a file over."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(bytes(content))


def cut(path: Path, length: int) -> None:
    """Leave only the first bytes of a file."""
    path.write_bytes(path.read_bytes()[:length])
