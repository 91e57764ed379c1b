"""Runs a command with a disk that fails, or in a process that dies, at the n-th write, sync or rename.

python crash_points.py KIND N COMMAND...: dies (KIND kill, tear) or fails (KIND full) there; prints how many there were.
"""

import errno
import os
import sys
from pathlib import Path

KILLED = 77
"""Exit code of a process that died at its crash point."""


class CrashPoint:
    """Counts what reaches the disk; the n-th of these does not. Only a write can tear."""

    def __init__(self, kind, n):
        self.kind, self.n, self.count = kind, n, 0

    def reached(self):
        self.count += 1
        return self.count == self.n

    def strike(self):
        if self.kind == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os._exit(KILLED)

    def guarded(self, call):
        def guard(*arguments, **options):
            if self.reached():
                self.strike()
            return call(*arguments, **options)

        return guard

    def writing(self, write):
        def guard(descriptor, content):
            if self.reached():
                if self.kind == "tear":
                    write(descriptor, bytes(content)[: len(content) // 2])
                self.strike()
            return write(descriptor, content)

        return guard

    def install(self):
        os.write = self.writing(os.write)
        if self.kind == "tear":
            return
        os.fsync, os.ftruncate = self.guarded(os.fsync), self.guarded(os.ftruncate)
        Path.replace, Path.unlink = self.guarded(Path.replace), self.guarded(Path.unlink)


def main():
    kind, n, *command = sys.argv[1:]
    from gaitopt.cli.main import main as gaitopt

    point = CrashPoint(kind, int(n))
    point.install()
    code = gaitopt([*command, "--quiet"])
    sys.stderr.write(f"\npoints {point.count}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
