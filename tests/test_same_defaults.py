"""Python and C++ have the same defaults and limits, the stub of the core is the core's."""

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import globule as gb
import pytest
from globule.render import layers, lights, settings
from globule.scene import scene

PACKAGE, ROOT = Path(gb.__file__).parent, Path(__file__).resolve().parents[1]
STRUCTS = {"render_settings": (gb.Headlight, gb.DirectionalLight, gb.PointLight, gb.Sky,
                               gb.Environment, gb.Ground, gb.Material, gb.ClipPlane, gb.ClipBox,
                               gb.ClipSphere, gb.RenderSettings),
           "camera": (gb.Camera,)}  # fmt: skip
NOT_COMPARED = {"lights", "material", "sky", "ground"}  # of another kind in C++
NOT_COMPARED |= {"tone", "transparent"}  # of Python alone: how an image is made of light


def defaults(header: str, name: str) -> dict[str, object]:
    """Members of a C++ struct with their initial values: None, a bool, a number or a tuple."""
    text = re.sub(r"//.*", "", (ROOT / f"include/globule/{header}.hpp").read_text())
    body = re.search(rf"(?:struct|class)(?: GLOBULE_API)? {name} {{(.*?)(?:\n| )}};", text, re.S)[1]
    found: dict[str, object] = {}
    for member, assigned, braced in re.findall(r"(\w+)(?: = (?:\w+(?=\{))?([^,;{}]*))?(\{[^{}]*\})?(?=[,;])", body):
        words = (braced or assigned).strip("{} ")
        if words in ("true", "false"):
            found[member] = words == "true"
        elif re.fullmatch(r"[-\d., /]+", words):
            value = tuple(eval(word) for word in words.split(","))
            found[member] = value if braced else value[0]
        elif braced == "{}":
            found[member] = None
    return found


def test_defaults():
    different = []
    for header, kind in ((header, kind) for header, kinds in STRUCTS.items() for kind in kinds):
        there = defaults(header, kind.__name__)
        here = {f.name: f.default for f in dataclasses.fields(kind) if f.name not in NOT_COMPARED}
        shared = {n for n in here.keys() & there.keys() if here[n] is not dataclasses.MISSING}
        plain = {n for n, v in here.items() if isinstance(v, (float, int, tuple))}
        assert kind is gb.ClipBox or shared >= plain, kind
        different += [(kind, n, here[n], there[n]) for n in shared if here[n] != there[n]]
    assert different == []


def test_kernels_and_limits():
    text = (ROOT / "src/api/scene.cpp").read_text()
    table = re.search(r"KernelDefaults table\[\] = {(.*?)};", text, re.S)[1]
    rows = re.findall(r"{([\d.]+), ([\d.]+), ([\d.]+)},\s*// (\w+)", table)
    assert tuple(name for *_, name in rows) == scene.KERNELS
    for spacings, threshold, reach, name in rows:
        assert (scene.DEFAULTS[name], float(reach)) == ((float(spacings), float(threshold)), scene.REACH[name])
    limits = dict(re.findall(r"constexpr (?:double|int) (k\w+) = ([\w.]+);", text))
    assert (float(limits["kMaxSupport"]), float(limits["kMaxRatio"])) == (scene.MAX_SUPPORT, scene.MAX_RATIO)
    assert int(limits["kMaxSamples"]) == settings.MAX_SAMPLES
    assert "kMaxParticles = (std::size_t(1) << 31) - 64" in text
    assert scene.MAX_PARTICLES == 2**31 - 64
    core = "".join(path.read_text() for path in (ROOT / "src").rglob("*.hpp"))
    assert int(re.search(r"kMaxLights = (\d+)", core)[1]) == lights.MAX_LIGHTS
    assert int(re.search(r"kMaxLayers = (\d+)", core)[1]) == layers.MAX_LAYERS


def declarations(text: str) -> str:
    """What a stub declares, whatever its layout."""
    return re.sub(r"""#.*|[\s(),'"]|\.\.\.""", "", text)


def test_marker_and_stub_of_the_core(tmp_path):
    assert (PACKAGE / "py.typed").is_file()
    pytest.importorskip("nanobind")
    made = tmp_path / "_core.pyi"
    words = ["nanobind.stubgen", "-q", "-m", "globule._core", "--exclude-values", "-o", made]
    subprocess.run([sys.executable, "-m", *words], check=True)
    assert declarations(made.read_text()) == declarations((PACKAGE / "_core.pyi").read_text())
