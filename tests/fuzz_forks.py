"""The workers of `globule.formats.workers` as forks, for the fuzzer: libraries are loaded once.

The questions and answers are as ever, and the limits, to which comes what this process holds.
"""

import contextlib
import json
import os
import resource
import signal
import sys

from globule.formats import decoder


class Forked:
    """What `guarded` needs of `subprocess.Popen`."""

    def __init__(self) -> None:
        asked, ask = os.pipe()
        answer, answered = os.pipe()
        self.returncode: int | None = None
        with open("/proc/self/statm", encoding="utf-8") as file:
            held = int(file.read().split()[5]) * resource.getpagesize()
        self.pid = os.fork()
        if self.pid == 0:
            try:
                for number in (ask, answer):
                    os.close(number)
                os.dup2(asked, 0)
                os.dup2(answered, 1)
                sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
                task, path, header, memory, seconds = json.loads(sys.stdin.readline())
                decoder.main(task, path, header + held, memory and memory + held, seconds)
            finally:
                os._exit(0)
        os.close(asked)
        os.close(answered)
        self.stdin, self.stdout = os.fdopen(ask, "wb"), os.fdopen(answer, "rb")

    def wait(self) -> int:
        """The exit status; a signal's number, negative."""
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def end(self) -> None:
        """End it, if it has not ended."""
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)
        for pipe in (self.stdout, self.stdin):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        self.wait()


def lend(_: str) -> Forked:
    """In the place of `workers.lend`."""
    return Forked()


def take_back(_: str, process: Forked, answered: bool) -> None:
    """In the place of `workers.take_back`."""
    process.end()
