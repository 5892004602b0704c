"""Mutated files of every kind, each opened in a process of its own with limits: `make fuzz`.

    python tests/fuzz.py [-n 20000] [--seed 0] [--only KIND] [--keep FOLDER] [--jobs 2]
    python tests/fuzz.py --open tests/corpus
    python tests/fuzz.py --damage [N] [--numbers [N]] [--together]

A mutant is refused in one line that names the file, or loads. Everything else is a fault: another
error, a crash, more than SECONDS of the processor's time, more memory than the limit. The file of
each fault is kept in the folder, as KIND@NUMBER@NAME; once mended, it belongs to tests/corpus.
`--open` opens such files again; `--damage` damages every array of a checkpoint in every way;
`--numbers` puts every extreme value in the place of every number of scenes, states, camera paths
and configurations. All open mutants too where -n says how many. The same seed makes the same
mutants for any number of jobs. `--together` takes one process for all files instead of one for
each: quicker, but what ends it is not told apart. The exit status is 1 if there was a fault.
"""

import argparse
import collections
import contextlib
import gc
import importlib
import io
import json
import os
import pkgutil
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from random import Random

os.environ["OMP_NUM_THREADS"] = "1"

sys.path.append(str(Path(__file__).parents[1]))  # the package bench

import globule as gb
from fuzz_files import KINDS
from fuzz_forks import lend, take_back
from fuzz_mutations import damaged_arrays, mutate, replaced_numbers
from globule import cli, formats
from globule.formats import guarded

SECONDS = 10  # of the processor, for one file
PATIENCE = 300  # s, until a process that does nothing is ended
MEMORY = 1 << 29  # bytes, which readers may take
SLACK = 1 << 28  # bytes, of libraries that are loaded and of what is done with a file
SHARE_OF_COMMANDS = 0.25
TEXTS = (".toml", ".xml", "path.json")  # that people write
THREADED = ("tables",)  # whose libraries start threads, which a fork does not have


def judge(kind: str, path: str, by_command: bool) -> str:
    """Open a file: "loaded", "refused", or what is wrong, in one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _by_command(kind, path) if by_command else _by_python(kind, path)


def _by_python(kind: str, path: str) -> str:
    try:
        KINDS[kind].read(path)
    except (ValueError, gb.MissingPackageError, OSError) as error:
        if isinstance(error, UnicodeError):
            return _fault(error)
        command = KINDS[kind].command
        return _wrong_line(str(error), path, *(command(path) if command else ())) or "refused"
    except BaseException as error:
        return _fault(error)
    return "loaded"


def _by_command(kind: str, path: str) -> str:
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = cli.main(KINDS[kind].command(path))
    except BaseException as error:
        return _fault(error)
    lines = [line for line in err.getvalue().splitlines() if "warning: " not in line]
    if status == 0:
        return "loaded"
    said = lines[-1] if lines else "nothing"
    if status != 2 or not said.startswith("globule: error: "):
        return f"command: status {status}: {said[:200]}"
    return _wrong_line(said, path, *KINDS[kind].command(path)) or "refused"


def _fault(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{os.path.basename(where.filename)}:{where.lineno}"
    return f"{type(error).__name__} at {place}: {' '.join(str(error).split())[:150]}"


def _wrong_line(text: str, *names: str) -> str:
    """What is wrong with an error's message; "" if nothing is. It names one of the files."""
    if "\n" in text:
        return f"several lines: {text[:150]!r}"
    if not any(os.path.basename(name) in text for name in names if "." in name):
        return f"no name of the file: {text[:200]}"
    return f"a long line: {text[:150]}" if len(text) > 700 else ""


def opened(kind: str, path: str, by_command: bool) -> str:
    """`judge` in a process of its own, with limits of time and memory."""
    mine, its = os.pipe()
    child = os.fork()
    if child == 0:
        _be_judge(kind, path, by_command, its)
    os.close(its)
    end, said = time.monotonic() + PATIENCE, b""
    try:
        while select.select([mine], [], [], max(0.0, end - time.monotonic()))[0]:
            piece = os.read(mine, 65536)
            if not piece:
                break
            said += piece
        else:
            os.kill(child, signal.SIGKILL)
            said = b"hang"
    finally:
        os.close(mine)
        _, status, used = os.wait4(child, 0)
    if said == b"hang":
        return f"hang: more than {PATIENCE} s"
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        if number == signal.SIGXCPU:
            return f"hang: more than {SECONDS} s of the processor"
        return f"crash: {signal.Signals(number).name}"
    text = said.decode()
    grown = 1024 * used.ru_maxrss - int(text.partition(" ")[0] or 0)
    verdict = text.partition(" ")[2] or "crash: nothing said"
    if grown > MEMORY + SLACK:
        return f"memory: {grown / 2**20:.0f} MiB ({verdict})"
    return verdict


def _be_judge(kind: str, path: str, by_command: bool, out: int) -> None:
    try:
        os.setpgid(0, 0)
        before = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with open("/proc/self/statm", encoding="utf-8") as file:
            space = int(file.read().split()[0]) * resource.getpagesize() + 4 * MEMORY + SLACK
        resource.setrlimit(resource.RLIMIT_AS, (space, space))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        verdict = judge(kind, path, by_command)
        os.write(out, f"{before} {verdict}".encode())
    finally:
        os._exit(0)


Case = tuple[str, str, str, bytes, bool]  # kind, number, path, content, whether a command opens it


def doors(kind: str) -> tuple[bool, ...]:
    """Whether by a command: both where there is one."""
    return (False, True) if KINDS[kind].command else (False,)


class Fuzzer:
    """The files of each kind, in a folder of its kind, and what became of their mutants."""

    def __init__(self, folder: str, only: str = "", together: bool = False):
        preload()
        self.together = together
        words = [sys.executable, __file__, "--make", folder, only]
        made = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True)
        names: dict[str, list[str]] = json.loads(made.stdout.splitlines()[-1])
        self.places = {kind: Path(folder, kind.replace(" ", "_")) for kind in names}
        self.files = {
            kind: [(name, (self.places[kind] / name).read_bytes()) for name in of] for kind, of in names.items()
        }
        self.kinds = list(self.files)
        self.weights = [KINDS[kind].weight for kind in self.kinds]

    def check(self) -> None:
        """Open the files as they are."""
        for kind, files in self.files.items():
            for name, content in files:
                if (verdict := self.open(kind, name, content, False)) != "loaded":
                    raise SystemExit(f"{kind}: {name}: expected a good file, got: {verdict}")

    def move(self, folder: Path) -> None:
        """Work in a copy of the files: two processes may not damage the same ones."""
        for kind, place in self.places.items():
            self.places[kind] = Path(shutil.copytree(place, folder / place.name))

    def mutant(self, seed: int, number: int) -> Case:
        """A damaged file, which a command opens or Python."""
        random = Random(f"{seed} {number}")
        kind = random.choices(self.kinds, self.weights)[0]
        path, content = random.choice(self.files[kind])
        content = mutate(random, content, [other for _, other in self.files[kind]])
        by_command = bool(KINDS[kind].command) and random.random() < SHARE_OF_COMMANDS
        return kind, f"{seed}.{number}", path, content, by_command

    def corpus(self, folder: str) -> Iterator[Case]:
        """Files KIND@NUMBER@NAME that this machine has the originals of, by both doors."""
        for file in sorted(Path(folder).glob("*@*@*")):
            kind, number, name = file.name.split("@")
            kind = kind.replace("_", " ")
            paths = [path for path, _ in self.files.get(kind, ()) if os.path.basename(path) == name]
            for by_command in doors(kind) if paths else ():
                yield kind, number, paths[0], file.read_bytes(), by_command

    def damaged(self) -> Iterator[Case]:
        """A checkpoint with each of its arrays damaged in each way."""
        for what, content in damaged_arrays(dict(self.files["checkpoints"])["all.npz"]):
            yield "checkpoints", what, "all.npz", content, False

    def numbers(self) -> Iterator[Case]:
        """Each number of the text files that people write replaced by every extreme value."""
        for kind, files in self.files.items():
            for path, original in files:
                for what, content in replaced_numbers(original) if path.endswith(TEXTS) else ():
                    for by_command in doors(kind):
                        yield kind, what, path, content, by_command

    def open(self, kind: str, path: str, content: bytes, by_command: bool) -> str:
        """What becomes of a mutant."""
        os.chdir(self.places[kind])
        old = Path(path).read_bytes()
        try:
            Path(path).write_bytes(content)
            if self.together and kind not in THREADED:
                return judge(kind, path, by_command)
            return opened(kind, path, by_command)
        finally:
            Path(path).write_bytes(old)
            for left in Path().glob("out*"):
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def run(fuzzer: Fuzzer, what: str, cases: Sequence[Case | Callable[[], Case]], options: argparse.Namespace) -> int:
    """Open files; prints the counts of each kind and the faults. Returns how many faults."""
    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    begin = time.monotonic()
    os.makedirs(options.keep, exist_ok=True)

    def share(some: Sequence[Case | Callable[[], Case]]) -> Iterator[tuple[str, str, str]]:
        """Kind, name and verdict of each."""
        for case in some:
            kind, number, path, content, by_command = case() if callable(case) else case
            verdict = fuzzer.open(kind, path, content, by_command)
            name = re.sub(r"[^\w.@-]", "_", f"{kind}@{number}@{os.path.basename(path)}")
            if verdict not in ("loaded", "refused"):
                Path(options.keep, name).write_bytes(content)
            yield kind, name, verdict

    shares = [cases[k :: options.jobs] for k in range(options.jobs)]
    verdicts = share(cases) if options.together else in_forks(fuzzer, shares, share)
    with contextlib.suppress(KeyboardInterrupt):  # the counts so far
        for done, (kind, name, verdict) in enumerate(verdicts, 1):
            good = verdict in ("loaded", "refused")
            counts[kind, verdict if good else "fault"] += 1
            if not good:
                print(f"{name}: {verdict}", flush=True)
            if done % 100 == 0:
                print(f"{done} in {time.monotonic() - begin:.0f} s", flush=True)
    total = dict.fromkeys(("refused", "loaded", "fault"), 0)
    for kind in dict.fromkeys(kind for kind, _ in counts):
        print(f"{kind:24}", "  ".join(f"{found} {counts[kind, found]}" for found in total))
        total = {found: n + counts[kind, found] for found, n in total.items()}
    print(f"{total['refused']} refused and {total['loaded']} loaded in {time.monotonic() - begin:.0f} s")
    print(f"{sum(total.values())} {what}, {total['fault']} faults", flush=True)
    return total["fault"]


def in_forks(fuzzer: Fuzzer, shares: list, work: Callable[..., Iterator]) -> Iterator[tuple[str, str, str]]:
    """What `work` yields, each share in a process of its own."""
    mine, theirs = os.pipe()
    children = []
    for some in shares:
        child = os.fork()
        if child == 0:
            status = 1
            try:
                with tempfile.TemporaryDirectory() as folder:
                    fuzzer.move(Path(folder))
                    for found in work(some):
                        os.write(theirs, (json.dumps(found) + "\n").encode())  # whole: it is short
                    os.chdir("/")
                status = 0
            except KeyboardInterrupt:
                pass
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(status)
        children.append(child)
    os.close(theirs)
    with open(mine, encoding="utf-8") as lines:
        for line in lines:
            yield tuple(json.loads(line))
    for child in children:
        if os.waitpid(child, 0)[1] != 0:
            raise SystemExit("a process that opens mutants failed")


def preload() -> None:
    """Import what readers import when they are first used: here once, not in each process."""
    guarded.lend, guarded.take_back = lend, take_back
    own = [m.name for m in pkgutil.walk_packages(formats.__path__, "globule.formats.")]
    for name in (
        "h5py", "pyarrow.feather", "pyarrow.parquet", "pxr.UsdGeom", "nibabel", "networkx",
        "PIL.Image", "scipy.sparse", "scipy.spatial", "trimesh", "trimesh.exchange.load",
        "trimesh.path", "globule.sim.simulation", "globule.viewer.state", *own,
    ):  # fmt: skip
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    formats.registry.formats()  # looks through all installed packages
    gc.collect()
    gc.freeze()  # a collection would copy what forks share


def make(folder: str, only: str) -> None:
    """Write the files of each kind, and print their names; a process of its own, since no thread
    may be there at a fork. A kind whose package is not installed is left out."""
    names = {}
    for kind in [only] if only else KINDS:
        place = Path(folder, kind.replace(" ", "_"))
        place.mkdir()
        os.chdir(place)
        try:
            names[kind] = KINDS[kind].make()
        except ImportError as error:
            print(f"{kind}: left out: {error}", file=sys.stderr)
    print("\n" + json.dumps(names))


def main() -> int:
    """Run the command line of this file."""
    parser = argparse.ArgumentParser(
        description="Damage files of every kind, and open each in a process with limits.",
        epilog='example: make fuzz FUZZ="-n 1000 --seed 7 --only volumes"',
    )
    add = parser.add_argument
    add("-n", type=int, help="damaged files (default: 20000; 0 with --open or --damage)")
    add("--jobs", type=int, default=2, help="processes at a time (default: %(default)s)")
    add("--seed", type=int, default=0, help="of the damage; the same files again (default: 0)")
    add("--first", type=int, default=0, metavar="N", help="start with damaged file N (default: 0)")
    add("--only", default="", choices=KINDS, metavar="KIND", help="one of " + ", ".join(KINDS))
    add("--keep", default="build/fuzz", metavar="FOLDER",
        help="what is found is kept there (default: %(default)s)")  # fmt: skip
    add("--open", metavar="FOLDER", help="open the files of a folder, such as tests/corpus")
    add("--together", action="store_true",
        help="open all in one process, without limits for each file")  # fmt: skip
    add("--damage", type=int, nargs="?", const=1, metavar="N",
        help="damage every array of a checkpoint, and open each Nth of these files")  # fmt: skip
    add("--numbers", type=int, nargs="?", const=1, metavar="N",
        help="put extreme values in the place of numbers; open each Nth file")  # fmt: skip
    parser.add_argument("--make", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.make:
        make(*options.make)
        return 0
    gb.set_limits(memory=MEMORY)
    n, faults = options.n, 0
    if n is None:
        n = 0 if options.open or options.damage or options.numbers else 20_000
    if options.open:
        options.open = os.path.abspath(options.open)
    options.keep = os.path.abspath(options.keep)
    with tempfile.TemporaryDirectory() as folder:
        fuzzer = Fuzzer(folder, options.only, options.together)
        if not options.together:
            fuzzer.check()
        if options.open:
            faults += run(fuzzer, "kept files", [*fuzzer.corpus(options.open)], options)
        if options.damage:
            faults += run(fuzzer, "damaged arrays", [*fuzzer.damaged()][:: options.damage], options)
        if options.numbers:
            faults += run(fuzzer, "extreme numbers", [*fuzzer.numbers()][:: options.numbers], options)
        if n:
            numbers = range(options.first, options.first + n)
            faults += run(fuzzer, "mutants", [partial(fuzzer.mutant, options.seed, k) for k in numbers], options)
        os.chdir("/")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
