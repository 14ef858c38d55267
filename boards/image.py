"""What is in a firmware's image (ELF for 32-bit ARM): how much memory it needs, and where it can panic."""

import os
import re
import struct
from collections import Counter

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
WRITE, ALLOC = 1, 2  # flags of a section
NOBITS = 8  # type of a section that is not in the file


class Image:
    def __init__(self, path, package):
        """`package` is the folder of the board, in which its own source files are."""
        self.package = package
        with open(path, "rb") as file:
            self.bytes = file.read()
        assert self.bytes[:6] == b"\x7fELF\x01\x01", f"{path}: no 32-bit little-endian ELF"
        start, = struct.unpack_from("<I", self.bytes, 32)
        size, count, _ = struct.unpack_from("<3H", self.bytes, 46)
        heads = [struct.unpack_from("<10I", self.bytes, start + i * size) for i in range(count)]
        # Name, type, flags, address, offset, size.
        self.sections = [head[1:6] for head in heads if head[2] & ALLOC and head[5]]

    def flash(self):
        """Bytes that are flashed: code, constants, what statics start with."""
        return sum(size for kind, _, _, _, size in self.sections if kind != NOBITS)

    def ram(self, origin, length):
        """Bytes of statics between two addresses."""
        return sum(
            size for _, flags, address, _, size in self.sections
            if flags & WRITE and origin <= address < origin + length
        )

    def read(self, address, length):
        """What the file holds for an address; empty where it holds nothing."""
        for kind, _, first, offset, size in self.sections:
            if kind != NOBITS and first <= address and address + length <= first + size:
                return self.bytes[offset + address - first:][:length]
        return b""

    def panics(self):
        """How often each place in a source file may panic: every panic tells its `core::panic::Location`, that is file,
        line and column, and the linker throws away the locations that no code uses."""
        places = Counter()
        for kind, _, first, offset, size in self.sections:
            if kind == NOBITS:
                continue
            for at in range(offset, offset + size - 15, 4):
                name, length, line, column = struct.unpack_from("<4I", self.bytes, at)
                if not (4 <= length < 300 and 0 < line < 100_000 and 0 < column < 1000):
                    continue
                # The name may have a zero behind it that its length counts or not.
                file = self.read(name, length).rstrip(b"\0")
                if re.fullmatch(rb"[ -~]+\.rs", file):
                    places[place(self.package, file.decode(), line)] += 1
        return places


def place(package, file, line):
    """A place that stays the same when lines are added elsewhere: ours by what the line says, others by their file."""
    full = os.path.realpath(os.path.join(package, file))
    if full.startswith(ROOT + os.sep) and os.path.exists(full):
        with open(full) as source:
            return f"{os.path.relpath(full, ROOT)}: {source.read().splitlines()[line - 1].strip()}"
    for before in ("/library/", "/registry/src/"):
        if before in file:
            file = file.split(before, 1)[1]
            return file.split("/", 1)[1] if before == "/registry/src/" else file
    return file
