"""The code of the documentation: what a page says, in order, and how it is run.

As a program, `python docs_blocks.py PAGE.md`, it runs the page's blocks in the present folder: the
Python ones in one namespace, the shell's with `globule` on the path. An HTML comment before a block
that begins with "not run:" and gives a reason leaves it out; one that begins with "before:" holds
Python that runs before the next block and that readers do not see.
"""

import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>[\w+-]*)[^\n]*\n(?P<code>.*?)^(?P=indent)```"
    r"|<!-- *(?P<word>not run|before):\s*(?P<text>.*?)-->",
    re.M | re.S,
)
SHELLS = ("sh", "bash", "console", "shell")
# What sets the machine up; the tests of the build and of the package run it.
SET_UP = re.compile(r"(?:\.venv/bin/)?(?:pip|make|sudo|git|python3 -m venv)\b")
LIVE = ("view", "--view")
# What readers' images and simulations take is too long for a test: command, what is added, and the
# options beside which it is not.
CAPS = (
    ("render", ("--size", "200x152"), ("--size",)),
    ("simulate", ("--seconds", "0.1"), ("--seconds", "--resume", "--view")),
    ("simulate", ("--size", "64x48"), ("--size", "--view")),
)


class Block(NamedTuple):
    """A block of code; `reason` says why it is not run."""

    line: int
    language: str
    code: str
    reason: str = ""


def blocks(path: Path) -> list[Block]:
    """The Python and shell blocks of a Markdown file, and the Python that readers do not see."""
    text, found, reason = path.read_text(encoding="utf-8"), [], ""
    for match in FENCE.finditer(text):
        line = text.count("\n", 0, match.start()) + 2
        if match["word"] == "not run":
            reason = match["text"].strip()
        elif match["word"]:
            found.append(Block(line - 1, "python", textwrap.dedent(match["text"])))
        else:
            code = textwrap.dedent(match["code"])
            if match["language"] == "python":
                found.append(Block(line, "python", code, reason))
            elif match["language"] in SHELLS:
                found.append(Block(line, "sh", commands(code), reason))
            reason = ""
    return found


def commands(code: str) -> str:
    """What of a shell block is run: without prompts, outputs and what sets the machine up."""
    if re.search(r"^\$ ", code, re.M):
        code = "\n".join(line[2:] for line in code.splitlines() if line.startswith("$ "))
    kept = [line for line in code.splitlines() if not SET_UP.match(line)]
    return "\n".join(kept).replace(".venv/bin/", "") + "\n"


def run(path: Path) -> None:
    """Run a page's blocks; raises at the first that fails."""
    space: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(path):
        if block.reason:
            continue
        print(f"{path.name}:{block.line}", flush=True)
        if block.language == "python":
            code = "\n" * (block.line - 1) + block.code
            exec(compile(code, str(path), "exec"), space)
        else:
            done = subprocess.run(["bash", "-euo", "pipefail", "-c", block.code])
            if done.returncode:
                raise SystemExit(f"{path.name}:{block.line}: exit status {done.returncode}")


def command(words: list[str]) -> int:
    """`globule` as the blocks see it. What is live is stopped as soon as it says where it is."""
    for name, cap, unless in CAPS:
        if words[:1] == [name] and not {"--help", "--help-all", *unless} & set(words):
            words = [*words, *cap]
    program = [sys.executable, "-m", "globule", *words]
    if not any(word in LIVE for word in words) or "--help" in words:
        return subprocess.run(program).returncode
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        seen = any("http://" in line for line in process.stdout or ())
        process.terminate()
    return 0 if seen else 1


if __name__ == "__main__":
    if sys.argv[1] == "globule":
        sys.exit(command(sys.argv[2:]))
    sys.path[0] = os.getcwd()
    run(Path(sys.argv[1]))
