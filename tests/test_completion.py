"""`globule --print-completion`: scripts for shells, and what bash completes with its script."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from cli_helpers import refused
from globule.cli import main
from waiting import PATIENCE

pytest.importorskip("shtab")
pytestmark = pytest.mark.usefixtures("folder")


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_script_for_each_shell(shell, capsys):
    assert main(["--print-completion", shell]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "globule" in out
    assert "reconstruct" in out
    if shutil.which(shell):
        done = subprocess.run([shell, "-n"], input=out, text=True, capture_output=True)
        assert done.returncode == 0, done.stderr


def test_an_unknown_shell(capsys):
    assert "bash" in refused(capsys, "--print-completion", "fish")


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("typed", "expected", "absent"),
    [
        (["globule", "re"], {"render", "reconstruct"}, {"view"}),
        (["globule", "render", "--oct"], {"--octree", "--octree-level"}, {"--device"}),
        (["globule", "render", "spl"], {"splash.npz"}, {"other.npz"}),
        (["globule", "render", "splash.npz", "--state", "v"], {"view.toml"}, set()),
        (["globule", "render", "splash.npz", "--root", ""], {"exact", "march", "bezier"}, set()),
        (["globule", "reconstruct", "--vox"], {"--voxel-size", "--voxels"}, set()),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_bash(typed, expected, absent, folder, capsys):
    for name in ("splash.npz", "other.npz", "view.toml"):
        (folder / name).write_text("")
    assert main(["--print-completion", "bash"]) == 0
    (folder / "completion.bash").write_text(capsys.readouterr().out)
    words = " ".join(f"'{word}'" for word in typed)
    script = f"""
source completion.bash
COMP_WORDS=({words})
COMP_CWORD={len(typed) - 1}
"$(complete -p globule | sed 's/.*-F \\([^ ]*\\).*/\\1/')"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "--norc", "-c", script], capture_output=True, text=True, timeout=PATIENCE)
    assert done.stderr == ""
    assert done.returncode == 0
    found = {word.strip() for word in done.stdout.splitlines()}
    assert expected <= found
    assert not absent & found
