"""Every block of Python and every command of the documentation runs, and the reference is complete."""

import argparse
import io
import os
import re
import runpy
import shlex
import signal
import subprocess
import sys
from contextlib import redirect_stdout, suppress
from itertools import takewhile
from pathlib import Path

import globule as gb
import pytest
from docs_blocks import Block, blocks
from globule._demo.data import dam_break_particles
from globule.cli import build_parser
from globule.cli.shared import UserError, join_negative
from waiting import PATIENCE

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))

import reference  # noqa: E402

BROWSERS = True  # conftest.py: what these tests wait for has a limit of its own
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
WITH_CODE = [path for path in PAGES if any(not block.reason for block in blocks(path))]
HELPER = str(Path(__file__).with_name("docs_blocks.py"))
OPERATORS = ("|", ">", "&&", "&", ";")
QUICK = ("render-on-a-gpu",)  # the others run in `make test-all`


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Files that pages may begin with, and `globule` as a program."""
    folder = tmp_path_factory.mktemp("data")
    splash, spacing = dam_break_particles()
    gb.write(folder / "splash.vtk", splash)
    gb.write(folder / "splash.npz", splash)
    for i in range(3):
        few = gb.Particles(splash.positions[i::3] + i * spacing, support=3 * spacing)
        gb.write(folder / f"frame_{i:04d}.vtk", few)
    (folder / "demo").mkdir()
    gb.write(folder / "demo" / "splash.npz", splash)
    sweep = gb.ultrasound.phantoms.cylinders(n_frames=24, size=(64, 60), spacing=0.8)
    gb.ultrasound.write_sweep(folder / "sweep.igs.mha", sweep)
    (folder / "config.xml").write_text(
        "<PlusConfiguration><VolumeReconstruction OutputSpacing='1 1 1'/></PlusConfiguration>"
    )
    return folder


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """The tests' own `globule` and `python` come first."""
    programs = tmp_path_factory.mktemp("programs")
    for program, run in (("globule", f' "{HELPER}" globule'), ("python", "")):
        path = programs / program
        path.write_text(f'#!/bin/sh\nexec "{sys.executable}"{run} "$@"\n')
        path.chmod(0o755)
    return {
        **os.environ,
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(Path(gb.__file__).parents[1]),
        "BROWSER": "true",
    }


@pytest.mark.parametrize(
    "path", [pytest.param(p, marks=() if p.stem in QUICK else pytest.mark.slow) for p in WITH_CODE], ids=name
)
def test_code(path, data, environment, tmp_path):
    for file in data.rglob("*"):
        if file.is_file():
            (tmp_path / file.relative_to(data)).parent.mkdir(exist_ok=True)
            os.link(file, tmp_path / file.relative_to(data))
    command = [sys.executable, HELPER, str(path)]
    options = {"cwd": tmp_path, "env": environment, "text": True, "start_new_session": True}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options) as process:
        try:
            out, _ = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            pytest.fail(f"{name(path)}: takes longer than {PATIENCE} s: {process.communicate()[0]}")
    assert process.returncode == 0, out[-3000:]


def mistake(block: Block, parser) -> str:
    """What is wrong with a block, as far as can be seen without running it; "" if nothing."""
    if block.reason and len(block.reason.split()) < 2:
        return "expected a reason"
    if block.language == "python":
        compile(block.code, f"line {block.line}", "exec")
        return ""
    for line in block.code.replace("\\\n", " ").splitlines():
        words = [*takewhile(lambda word: word not in OPERATORS, shlex.split(line, comments=True))]
        if words and words[0] == "globule":
            try:
                with redirect_stdout(io.StringIO()), suppress(SystemExit):  # --help
                    parser.parse_args(join_negative(words[1:]))
            except UserError as error:
                return f"{line}: {error}"
    return ""


def test_code_and_commands_are_right_as_far_as_can_be_seen():
    """Of all blocks, also of those that are never run."""
    parser = build_parser()
    found = [(f"{name(p)}:{b.line}", mistake(b, parser)) for p in PAGES for b in blocks(p)]
    assert len(found) > 200
    assert [(place, what) for place, what in found if what] == []


@pytest.mark.slow
def test_a_block_that_fails_is_named(environment, tmp_path):
    page = tmp_path / "page.md"
    for text, said in (
        ("# A\n\n```python\na = 1\n```\n\n```python\nassert a == 2\n```\n", 'page.md", line 8'),
        ("```sh\nglobule convert nothing.vtk | cat\n```\n", "page.md:2: exit status 2"),
    ):
        page.write_text(text)
        command = [sys.executable, HELPER, str(page)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode
        assert said in done.stderr


def test_journeys_of_the_architecture_name_files_that_exist():
    text = (DOCS / "understand" / "architecture.md").read_text(encoding="utf-8")
    text = text.partition("## Five journeys")[2].partition("\n## ")[0]
    journeys = [re.findall(r"^\d+\. `([^`]+)`: ", part, re.M) for part in text.split("\n### ")[1:]]
    assert len(journeys) == 5
    for files in journeys:
        assert 5 < len(files) <= 15
        assert len(set(files)) == len(files)
        assert [file for file in files if not (ROOT / file).is_file()] == []


def test_the_documentation_stays_small():
    assert len([*DOCS.rglob("*.md")]) <= 80
    assert len((ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()) <= 60


def test_tables_are_those_of_the_measured_numbers():
    """`python docs/make_measured.py` would change nothing: no page has a number of its own."""
    made = runpy.run_path(str(DOCS / "make_measured.py"))
    texts = [page.read_text(encoding="utf-8") for page in made["PAGES"]]
    assert sum(text.count("<!-- measured:") for text in texts) == len(made["BUILT"]) + len(made["TABLES"])
    assert [made["filled"](text, made["read"]()) for text in texts] == texts


# The reference


def test_every_public_name_is_on_one_page():
    pages = reference.python_pages()
    text = "\n".join(text for path, text in pages.items() if not path.endswith("index.md"))
    full = {path: name for name, path in reference.FULL.items()}
    found = re.findall(r"^\.\. auto\w+:: (globule\.[\w.]+)$", text, flags=re.M)
    names = [full.get(path, path.removeprefix("globule.")) for path in found]
    also = {path for paths in reference.ALSO.values() for path in paths}
    assert sorted(n for n in names if n not in also) == sorted(reference.public())


def test_every_command_has_a_page_with_every_flag():
    pages = reference.command_pages()
    commands = reference.parsers()
    assert {"render", "view", "convert", "info", "simulate", "reconstruct"} <= commands.keys()
    for words, parser in commands.items():
        text = pages[f"reference/commands/{words.replace(' ', '-')}.md"]
        for action in parser._actions:
            if action.dest == "help" or argparse.SUPPRESS in (action.dest, action.help):
                continue
            for flag in action.option_strings[-1:]:
                assert re.search(rf"^\| .*`{flag}[ `].* \|$", text, flags=re.M), flag


def test_every_declaration_of_the_headers_is_on_its_page():
    pages = reference.header_pages()
    for path in reference.HEADERS.glob("*.hpp"):
        text = pages[f"reference/headers/{path.stem}.md"]
        code = path.read_text(encoding="utf-8")
        declared = re.findall(r"^(?:class|struct|enum class) (?:GLOBULE_API )?(\w+)\b[^;]*$", code, flags=re.M)
        declared += re.findall(r"^(?:GLOBULE_API|inline|constexpr) [^=;{]*?(\w+)\(", code, flags=re.M)
        for name in declared:
            assert f"## {name}\n" in text, f"{path.name}: {name}"
        assert "private:" not in text
