"""Edge samples where light makes turns: pixels at edges have all samples, other pixels one."""

import globule as gb
import numpy as np
import pytest
from quick import every
from test_mesh_layers import box
from test_surface import ball, smooth

SIZE = (64, 48)
CAMERA = gb.Camera((6, 9, 40), (0, 0, 0), fov=34)
SUN = gb.DirectionalLight((0.4, 1, 0.3))  # a soft light's samples at edges have places of their own
EDGES = 3


def scenes(name: str, backend: dict) -> tuple[list, dict]:
    """Layers, and settings but the samples."""
    fluid = gb.Layer(smooth(ball(1500), **backend))
    tank = box((-9, -9, -6), (9, -4, 6), **backend)
    shadows = {"lights": [SUN], "shadows": True, "ground": gb.Ground(-9, color=0.4)}
    glass = gb.Material(transmission=1.0, index=1.4, absorption=(0.1, 0.02, 0.01))
    layers = {
        "mirror": lambda: [gb.Layer(fluid.scene, gb.Material(reflection=0.6))],
        "glass": lambda: [gb.Layer(fluid.scene, glass)],
        "cut": lambda: [gb.Layer(fluid.scene, clips=[gb.ClipPlane((1, 0, 0.4), 1.0)])],
        "layers": lambda: [fluid, gb.Layer(smooth(ball(300) + 9, **backend), glass)],
        "mesh": lambda: [fluid, gb.Layer(tank, gb.Material(color=(0.7, 0.2, 0.1)))],
        "mesh alone": lambda: [gb.Layer(tank)],
    }.get(name, lambda: [fluid])()
    return layers, {
        "shadows": shadows,
        "soft ambient": {"ambient_rays": 3},
        "mirror": {"sky": gb.Sky()},
        "glass": shadows | {"sky": gb.Sky()},
        "mesh": shadows,
    }.get(name, {})


NAMES = (
    "plain", "shadows", "soft ambient", "mirror", "glass", "cut", "layers", "mesh", "mesh alone"
)  # fmt: skip


@pytest.mark.few_backends
@pytest.mark.parametrize("name", every(3, NAMES))
def test_edges_have_all_samples_and_other_pixels_one(backend, name):
    layers, fields = scenes(name, backend)

    def image(**more):
        return gb.render(layers, CAMERA, SIZE, settings=gb.RenderSettings(**fields, **more))

    one, edges, all_ = image(edge_samples=0), image(edge_samples=EDGES), image(samples=1 + EDGES)
    changed = (one.color != edges.color).any(axis=2)
    assert 0.005 < changed.mean() < 0.5
    # Rays side by side share their way through the octree: fewer of them round differently, and
    # each turn of a ray in glass widens that.
    turns = "glass" in name or name == "layers"
    assert np.abs(edges.color - all_.color)[changed].max() < (1e-4 if turns else 2e-5)
    assert np.abs(edges.image.astype(int) - all_.image)[changed].max() <= 1
    assert (edges.image[~changed] == one.image[~changed]).all()
    for values in ("distance", "normal", "albedo"):
        assert (getattr(one, values) == getattr(edges, values)).all(), values
    # No silhouette is left out: beside a pixel of the background, and beside another layer.
    what = np.where(one.mask, one._layer, 99).astype(int)
    jump = np.zeros(what.shape, bool)
    for axis in (0, 1):
        apart = np.diff(what, axis=axis) != 0
        jump |= np.insert(apart, 0, False, axis) | np.insert(apart, apart.shape[axis], False, axis)
    same = (all_.color == one.color).all(axis=2)
    assert (changed | same)[jump].all()
    smooth = any(isinstance(layer.scene, gb.Scene) for layer in layers)
    assert (image().color == (edges if smooth else one).color).all()


@pytest.mark.parametrize(("size", "samples"), [((97, 61), 2), ((61, 9), 5), ((41, 3), 64), ((3, 50), 7)])
def test_images_of_any_size_have_all_samples_at_edges(backend, size, samples):
    """Their rays are traced by bands of rows, which do not always divide the image."""
    scene = smooth(ball(1500), **backend)
    one, edges, all_ = (
        gb.render(scene, CAMERA, size, settings=gb.RenderSettings(**more))
        for more in ({"edge_samples": 0}, {"edge_samples": samples}, {"samples": 1 + samples})
    )
    changed = (one.color != edges.color).any(axis=2)
    assert changed.any()
    assert np.abs(edges.color - all_.color)[changed].max() < 2e-5
    assert np.abs(edges.image.astype(int) - all_.image)[changed].max() <= 1


@pytest.mark.few_backends
def test_a_frame_with_edges_is_refined_as_one_without(backend):
    layers, fields = scenes("mesh", backend)
    frame = gb.render(layers, CAMERA, SIZE, settings=gb.RenderSettings(**fields))
    frame.refine(2).refine(1)
    many = gb.render(layers, CAMERA, SIZE, settings=gb.RenderSettings(**fields, samples=4))
    assert frame.samples == 4
    assert (frame.color == many.color).all()
    assert (frame.image == many.image).all()
    shown = gb.render(layers, CAMERA, SIZE, settings={**fields, "samples": 4}, progress=lambda *_: None)
    assert (shown.image == many.image).all()


def test_alpha_of_edges_is_the_share_of_hits(backend):
    """A white surface on black: its light is the alpha."""
    layers, _ = scenes("cut", backend)
    white = gb.RenderSettings(
        lights=(), ambient=1.0, material=gb.Material(color=1.0), background=0.0, tone=False,
        specular=0.0, transparent=True,
    )  # fmt: skip
    frame = gb.render(layers, CAMERA, (96, 72), settings=white)
    assert ((frame.alpha > 0) & (frame.alpha < 1)).sum() > 50
    assert np.abs(frame.color[..., 0] - frame.alpha).max() < 1e-5


def test_the_same_bits_for_any_number_of_threads():
    images = []
    for threads in (1, 2):
        layers, fields = scenes("glass", {"device": "cpu", "threads": threads})
        images.append(gb.render(layers, CAMERA, SIZE, settings=fields).color)
    assert (images[0] == images[1]).all()
