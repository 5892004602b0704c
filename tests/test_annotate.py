"""What is drawn into an image, measured in its pixels: lengths, directions, edges, places."""

import dataclasses
import os
import tracemalloc
import warnings

import globule as gb
import numpy as np
import pytest
from cli_helpers import at_edge, cube, refused, refuses
from globule.cli import main
from globule.render import annotate, canvas
from globule.render.annotate import draw_view, scale_bar
from globule.render.box import round_values, visible_parts
from globule.render.canvas import Canvas, sizes
from globule.render.legend import POSITIONS
from globule.render.views import VIEWS, Grid, view_cameras
from PIL import Image

ALONG_X = gb.Camera((0, 0, 5), (0, 0, 0), fov=40)
CAMERAS = {
    "perspective": gb.Camera((1.6, 1.2, 3.0), (0.1, 0.4, -0.2), fov=42.0),
    "orthographic": gb.Camera((1.6, 1.2, 3.0), (0.1, 0.4, -0.2), height=2.6),
    "wide": gb.Camera((30, -8, 3.0), (0.1, 0.4, -0.2), (0, 0, 1), fov=95.0),
}


def gray(width: int = 320, height: int = 240, channels: int = 3) -> np.ndarray:
    image = np.full((height, width, channels), 235, np.uint8)
    image[..., 3:] = 0
    return image


def changed(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    return (after != before).any(axis=2)


# Places in the image


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_projected_points_are_where_the_rays_meet_them(camera):
    size = (64, 48)
    origins, directions = (v.reshape(-1, 3).astype(np.float64) for v in camera.rays(size))
    far = np.linspace(0.5, 9, len(origins))
    points = origins + far[:, None] * directions
    row, column = np.divmod(np.arange(len(points)), size[0])
    expected = np.stack([column + 0.5, row + 0.5], axis=1)
    assert np.abs(camera.project(points, size) - expected).max() < 1e-3
    assert np.abs(camera.along(points) - far).max() < 1e-4
    behind = np.asarray(camera.eye) * 2 - camera.look_at
    assert np.isnan(camera.project(behind[None], size)).all() == (camera.height is None)


@pytest.mark.parametrize("size", [(320, 240), (240, 320), (1024, 782)])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_scale_bar_is_as_long_as_it_says(camera, size):
    length, pixels = scale_bar(camera, size)
    mantissa = length / 10 ** np.floor(np.log10(length))
    assert min(abs(mantissa - m) for m in (1, 2, 5, 10)) < 1e-9
    assert 0.09 * size[0] < pixels <= 0.25 * size[0] + 1e-6
    # Two points at the distance of look_at, side by side.
    right = camera.frame(size)[2]
    right /= np.linalg.norm(right)
    places = [np.asarray(camera.look_at)]
    if camera.height is not None:  # true everywhere
        places += [places[0] + 0.7 * right + (0.3, -2.0, 1.0)]
    for place in places:
        ends = camera.project(np.stack([place, place + length * right]), size)
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(pixels, rel=1e-6)
    # And as long in the image.
    before = gray(*size)
    after = draw_view(before, gb.Annotation(scale_bar=True, unit="m"), camera)
    dark = (after < 100).all(axis=2)
    rows = np.flatnonzero(dark.sum(axis=1) > 0.9 * pixels)
    assert 1 <= len(rows) <= 6
    columns = np.flatnonzero(dark[rows[0]])
    assert np.ptp(columns) + 1 == pytest.approx(pixels, abs=3)


def test_round_values():
    assert round_values(-1.2, 1.2, 5) == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert round_values(0, 1, 5) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1])
    assert round_values(3, 3, 5) == [3]
    assert round_values(-1.515, 1.515, 2) == [-1, 0, 1]  # one value alone is no scale
    assert len(round_values(0.9, 3.1, 2)) >= 2
    for lo, hi in ((0.013, 7.3), (-1e9, 2e8), (1e-12, 3e-12)):
        values = round_values(lo, hi, 6)
        assert 2 <= len(values) <= 7
        assert lo - 1e-9 * abs(lo) <= min(values) <= max(values) <= hi + 1e-9 * abs(hi)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_axes_point_where_the_axes_point(camera):
    side = 1000
    before = gray(side, side)
    after = draw_view(before, gb.Annotation(axes=True), camera).astype(int)
    _, _, right, up = camera.frame((side, side))
    font, _, margin = sizes(side)
    long = max(1.8 * font, annotate._AXIS * side)
    start = np.array([margin + 1.4 * long, side - margin - 1.4 * long])
    for axis, color in enumerate(annotate._COLORS):
        pixels = np.argwhere(np.abs(after - color).sum(axis=2) < 40)[:, ::-1] + 0.5
        flat = long * np.array([right[axis], -up[axis]]) / np.linalg.norm(right)
        length = np.linalg.norm(flat)
        if length < 0.25 * long:
            continue
        ahead, away = flat / length, pixels - start
        along, aside = away @ ahead, away @ (-ahead[1], ahead[0])
        arrow = along < length + 1  # then comes the letter
        assert arrow.sum() > 40
        assert along.min() > -3
        assert along[arrow].max() == pytest.approx(length, abs=3)
        assert abs(np.median(aside[arrow])) < 0.7
        assert np.abs(aside[arrow]).max() < 0.13 * long
        assert along.max() > length + 0.3 * font
        assert along.max() < length + 1.5 * font


# The box


def test_edges_behind_the_surface_are_hidden(backend):
    scene = gb.Scene(gb.Particles(np.zeros((1, 3)), support=2.0), **backend)
    size = (200, 150)
    for camera in CAMERAS["perspective"], CAMERAS["orthographic"]:
        frame = gb.render(scene, camera, size)
        for z in (-1.5, 1.5):
            ends = np.array([[-2.0, 0.3, z], [2.0, 0.3, z]])
            parts = visible_parts(ends, camera, size, frame.distance)
            shares = np.linspace(0, 1, 400)
            points = ends[0] + shares[:, None] * (ends[1] - ends[0])
            far = camera.along(points)
            towards = camera.towards(points)
            distance = scene.intersect(points - far[:, None] * towards, towards).distance
            seen = far <= distance
            places = camera.project(points, size)
            drawn = np.zeros(len(points), bool)
            for a, b in parts:
                along = (places - a) @ (b - a) / ((b - a) @ (b - a))
                slack = 1.5 / np.linalg.norm(b - a)  # it ends within a pixel
                drawn |= (along >= -slack) & (along <= 1 + slack)
            edge = places[np.flatnonzero(np.diff(seen))]  # within a pixel or two of where it vanishes
            near = (np.linalg.norm(places[:, None] - edge, axis=2) < 2.5).any(axis=1)
            inside = (places > 2).all(axis=1) & (places < np.array(size) - 2).all(axis=1)
            judged = inside & ~near
            assert judged.sum() > 100
            assert (drawn[judged] == seen[judged]).all()
            if z < 0:
                assert (~seen[judged]).sum() > 20
        # Without an image nothing hides.
        assert len(visible_parts(ends, camera, size, None)) == 1


def test_the_box_goes_around_the_particles():
    particles = cube(5)
    scene = gb.Scene(particles)
    camera = gb.Camera.fit(particles, size=(400, 300), margin=0.6)
    plain = gb.render(scene, camera, (400, 300))
    noted = gb.render(scene, camera, (400, 300), annotate=gb.Annotation(box=True))
    new = changed(noted.image, plain.image)
    corners = np.array(np.meshgrid(*zip(*particles.bounds(), strict=True))).reshape(3, -1).T
    places = camera.project(corners, (400, 300))
    found = np.argwhere(new)[:, ::-1]
    far = np.linalg.norm(places[:, None] + 0.5 - found[None], axis=2).min(axis=1)
    order = np.argsort(camera.along(corners))
    assert far[order[:4]].max() < 3
    assert far[order[-1]] > 10  # behind the cube
    assert (plain.image == gb.render(scene, camera, (400, 300)).image).all()


def test_ticks_are_where_their_values_are():
    before = gray(500, 500)
    camera = gb.Camera((0, 0, 9), (0, 0, 0), height=6.0)
    after = draw_view(before, gb.Annotation(box=((-2, -2, -1), (2, 2, 1))), camera)
    dark = (after < 190).all(axis=2)
    bottom = round(float(camera.project([[0, -2, 1]], (500, 500))[0, 1]))
    row = dark[bottom + 4]
    ticks = np.flatnonzero(row)
    expected = camera.project([[x, -2, 1] for x in (-2, 0, 2)], (500, 500))[:, 0]
    for x in expected:
        assert np.abs(ticks + 0.5 - x).min() <= 1
    beside = camera.project([[-2.1, -2, 1]], (500, 500))[0, 0]
    assert (ticks > beside).sum() <= 2 * 5  # at -2, -1, 0, 1 and 2


def test_a_box_without_particles_and_lines_through_the_eye():
    assert annotate.bounds_of([gb.Scene(gb.Particles(np.full((2, 3), np.nan)))]) is None
    inside = gb.Camera((0.5, 0.5, 0.5), (0.5, 0.5, 0), fov=110)
    box = gb.Annotation(box=((0, 0, 0), (1, 1, 1)))
    new = changed(draw_view(gray(240, 240), box, inside), gray(240, 240))
    ends = inside.project([[0, 0, 0], [1, 1, 0]], (240, 240))
    assert (np.abs(np.flatnonzero(new.any(axis=1))[[0, -1]] - ends[::-1, 1]) < 130).all()
    assert 300 < new.sum() < 12000
    on_an_edge = gb.Camera((0.5, 0, 0), (0.5, 1, 1))
    with np.errstate(all="raise"):
        draw_view(gray(240, 240), box, on_an_edge)


# Text


def test_title_time_and_step_and_their_places():
    notes = gb.Annotation(title="A title", time=0.5, time_step=0.25, step=7)
    image = annotate.draw_sheet(gray(), notes)
    new = changed(image, gray())
    assert new[:40].sum() > 100
    assert not new[60:].any()
    assert new[:, :120].any()
    assert new[:, 130:190].any()
    third = notes.at(3)
    assert (third.time, third.step) == (1.25, 10)
    assert not gb.Annotation().draws
    assert gb.Annotation(step=0).draws


@pytest.mark.parametrize("position", POSITIONS)
def test_legends_stand_where_they_are_asked_for(position):
    before = gray(300, 200)
    after = gb.add_legend(before, "viridis", 0, 2, "speed", unit="m/s", position=position)
    if position == "outside":
        assert after.shape[0] == 200
        assert after.shape[1] > 340
        assert (after[:, :300] == before).all()
        assert changed(after[:, 300:], np.full_like(after[:, 300:], 255)).sum() > 400
        return
    rows, columns = np.nonzero(changed(after, before))
    vertical, horizontal = position.split("-")
    assert (columns.max() < 150, columns.min() > 150) == (horizontal == "left", horizontal == "right")
    assert (rows.max() < 140, rows.min() > 60) == (vertical == "upper", vertical == "lower")


def test_an_outside_legend_keeps_the_size():
    notes = gb.Annotation(legend="outside")
    for size in ((300, 200), (200, 300), (301, 199)):
        frame = gb.render(cube(4), size=size, color_by="x", annotate=notes)
        assert frame.image.shape == (size[1], size[0], 3)
        assert frame.size[0] < size[0] - 40
        assert frame.distance.shape == frame.size[::-1]


def test_letters_beyond_ascii(monkeypatch):
    """Units such as kg/m³ and µm: Pillow's own font draws one box for all such letters."""
    pytest.importorskip("matplotlib")  # brings a font
    blank = np.full((80, 200, 3), 255, np.uint8)

    def drawn(text):
        sheet = Canvas(blank)
        sheet.text((20, 40), text)
        return sheet.pixels

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.array_equal(drawn("m²"), drawn("m³"))
        assert not np.array_equal(drawn("µm"), drawn("Ωm"))
        assert Canvas(blank).text_width("ßßßß") > Canvas(blank).text_width("ß")
    monkeypatch.setattr(canvas, "_font_files", lambda: ["no-such-font.ttf"])
    canvas._font_file.cache_clear()
    with pytest.warns(UserWarning, match="m³: expected letters of a font of this machine, got ³"):
        drawn("m³")
    canvas._font_file.cache_clear()


def test_text_on_transparent_pixels():
    """Text and lines are opaque, and look the same as on a page of one color."""
    notes = gb.Annotation(title="Title", axes=True, scale_bar=True, box=((-1, -1, -1), (1, 1, 1)))
    clear = annotate.draw_sheet(draw_view(gray(channels=4), notes, ALONG_X), notes)
    assert clear.shape == (240, 320, 4)
    assert (clear[..., 3] == 255).sum() > 200
    assert (clear[0, 0] == (235, 235, 235, 0)).all()
    page = np.full((240, 320, 3), 255, np.uint8)
    opaque = annotate.draw_sheet(draw_view(page, notes, ALONG_X), notes)
    alpha = clear[..., 3:] / 255
    over = alpha * clear[..., :3] + (1 - alpha) * 255
    assert np.abs(over - opaque).max() <= 3


def test_a_label_stays_inside_of_the_image():
    blank = np.full((100, 120, 3), 255, np.uint8)
    drawn = {}
    for place in ((40.0, 50.0), (-30.0, 50.0), (200.0, 50.0), (60.0, -20.0), (60.0, 300.0)):
        canvas = Canvas(blank)
        canvas.text(place, "y, m", "mm", inks=((0, 0, 0), (255, 255, 255)), inside=True)
        drawn[place] = int((canvas.pixels < 128).sum())
    assert len(set(drawn.values())) == 1, drawn
    assert drawn[40.0, 50.0] > 20


def test_a_title_is_in_the_middle_of_image_and_legend():
    blank = np.full((200, 300, 3), 255, np.uint8)
    for strip in (0, 60):
        image = annotate.draw_sheet(blank, gb.Annotation(title="Title"), None, strip)
        columns = np.flatnonzero((image < 128).any(axis=(0, 2)))
        assert (columns[0] + columns[-1]) / 2 == pytest.approx((300 + strip) / 2, abs=3)


def test_wrong_annotations():
    for fields, what in (
        ({"title": 3}, "title: expected a text"),
        ({"scale_bar": 0.1}, "scale_bar: expected"),
        ({"box": 3}, "box: expected a bool or"),
        ({"box": ((0, 0, 0), (1, -1, 1))}, "box: expected lo <= hi"),
        ({"time": "now"}, "time: expected"),
        ({"step": 1.5}, "step: expected"),
        ({"legend": "above"}, "legend: expected a bool or one of"),
    ):
        refuses(what, gb.Annotation, **fields, error=(TypeError, ValueError))


def test_wrong_uses():
    with pytest.raises(ValueError, match="annotate: expected color_by beside a legend"):
        gb.render(cube(), size=(80, 80), annotate=gb.Annotation(legend=True))
    with pytest.raises(ValueError, match="size: expected at least 64 pixels"):
        gb.render(cube(), size=(80, 60), annotate=gb.Annotation(axes=True))
    notes = gb.Annotation(legend="outside")
    refuses("beside the legend", gb.render, cube(), size=(90, 90), color_by="x", annotate=notes)
    refuses("image: expected", Canvas, np.zeros((80, 80)))


def test_fitted_images_have_room_for_the_box():
    notes = gb.Annotation(box=True, title="T", scale_bar=True)
    frame = gb.render(cube(5), size=(320, 240), annotate=notes)
    new = changed(frame.image, np.broadcast_to(frame.image[120, 0], frame.image.shape))
    border = np.ones_like(new)
    border[3:-3, 3:-3] = False
    assert not (new & border).any()


# Several views


@pytest.mark.parametrize("n", range(1, 10))
@pytest.mark.parametrize("size", [(640, 480), (200, 900), (901, 77)])
def test_views_do_not_overlap(n, size):
    grid = Grid(n, size)
    width, height = grid.cell
    whole = grid.together([np.full((height, width, 3), i + 1, np.uint8) for i in range(n)])
    assert whole.shape == (size[1], size[0], 3)
    for i in range(n):
        assert (whole == i + 1).all(axis=2).sum() == width * height


def test_each_view_is_the_image_of_its_camera():
    scene = gb.Scene(cube(5, color=np.float32([0.2, 0.5, 0.8])))
    cameras = [CAMERAS["perspective"], CAMERAS["orthographic"]]
    found = gb.render_views(scene, cameras, (321, 200))
    assert found.image.shape == (200, 321, 3)
    width, height = found.frames[0].size
    for k, camera in enumerate(cameras):
        alone = gb.render(scene, camera, (width, height)).image
        x = k * (width + 1)
        assert (found.image[:height, x : x + width] == alone).all()


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (1, 0, 0)])
def test_views_by_name_look_along_their_axes_at_one_scale(up):
    rng = np.random.default_rng(3)
    scene = gb.Scene(rng.uniform(-1, 1, (200, 3)) * (3, 1, 0.5))
    cameras = dict(zip(VIEWS, view_cameras(scene, VIEWS, (200, 150), up), strict=True))
    flat = {c.height for name, c in cameras.items() if name != "iso"}
    assert len(flat) == 1
    assert cameras["iso"].height is None
    towards = {n: np.subtract(c.eye, c.look_at) for n, c in cameras.items()}
    towards = {n: v / np.linalg.norm(v) for n, v in towards.items()}
    assert np.allclose(towards["top"], np.asarray(up) / np.linalg.norm(up), atol=1e-9)
    assert np.allclose(towards["bottom"], -towards["top"], atol=1e-9)
    assert np.allclose(towards["front"], -towards["back"], atol=1e-9)
    assert np.allclose(towards["right"], towards["side"])
    assert np.allclose(towards["right"], np.cross(up, towards["front"]), atol=1e-6)
    for name, camera in cameras.items():  # nothing is cut off
        hits = gb.render(scene, camera, (200, 150)).mask
        assert hits.any(), name
        assert not at_edge(hits), name


def test_views_share_title_and_legend():
    notes = gb.Annotation(title="Four", legend=True, axes=True)
    found = gb.render_views(cube(4), size=(500, 400), color_by="x", annotate=notes)
    image = found.image
    assert image.shape == (400, 500, 3)
    assert len(found.frames) == 4
    assert (image[:, -3:] == 255).all()  # the legend's strip
    assert (image[2] == 255).all()  # the title's
    refuses("views: expected cameras or some of front, back", gb.render_views, cube(4), ["above"])
    refuses("views: expected at least one view", gb.render_views, cube(4), [])


# Sequences and commands


def test_a_sequence_has_the_time_of_each_frame_and_one_box(tmp_path):
    frames = [gb.Particles(cube(4).positions * (1 + 0.1 * i), support=0.5) for i in range(3)]
    notes = gb.Annotation(time=1.0, time_step=0.5, step=0, box=True, axes=True)
    name = str(tmp_path / "f_%d.png")
    files = gb.render_sequence(frames, name, size=(200, 150), annotate=notes)
    images = [np.asarray(Image.open(file)) for file in files]
    first, last = images[0], images[2]
    assert (first[:25, :90] != last[:25, :90]).any()
    still = notes.at(0)
    again = gb.render_sequence(frames[:1], name, size=(200, 150), annotate=still)
    assert (np.asarray(Image.open(again[0])) == first).all()
    settings = {"transparent": True}
    refuses("transparent", gb.render_sequence, frames, str(tmp_path / "m.mp4"), settings=settings)


@pytest.fixture
def files(folder):
    speed = np.linspace(0, 3, 64)
    for i in range(3):
        moved = cube(4).positions + 0.2 * i
        gb.write(f"frame_{i}.npz", gb.Particles(moved, support=0.5, attributes={"speed": speed}))


def opened(name: str) -> np.ndarray:
    with Image.open(name) as image:
        return np.asarray(image)


COMMON = ["--size", "200x150", "--device", "cpu"]


def test_the_command_draws_what_python_draws(files):
    words = ["render", "frame_0.npz", *COMMON, "--eye", "2,2,3", "--color-by", "speed"]
    notes = gb.Annotation(
        title="Title", scale_bar=True, axes=True, box=True, unit="mm", time=2.5, step=4,
        legend="outside", legend_title="v", legend_unit="m/s",
    )  # fmt: skip
    flags = ["--title", "Title", "--scale-bar", "--axes", "--box", "--unit", "mm", "--time",
             "2.5,0.5", "--step-number", "4", "--legend-at", "outside", "--legend-title", "v",
             "--legend-unit", "m/s"]  # fmt: skip
    assert main([*words, *flags, "-o", "a.png"]) == 0
    middle = tuple(np.mean(gb.read("frame_0.npz").bounds(), axis=0).tolist())
    camera = gb.Camera((2, 2, 3), middle)
    frame = gb.render("frame_0.npz", camera, (200, 150), color_by="speed", annotate=notes)
    assert (opened("a.png") == frame.image).all()


def test_a_turntable_shows_all_particles_from_all_sides(files):
    os.mkdir("turn")
    words = ["render", "frame_0.npz", *COMMON, "--turntable", "8"]
    assert main([*words, "-o", "turn/t_%d.png"]) == 0
    images = [opened(f"turn/t_{k}.png") for k in range(8)]
    sizes = []
    for image in images:
        seen = (image != image[0, 0]).any(axis=2)
        assert not at_edge(seen)
        sizes.append(seen.sum())
        assert abs(np.nonzero(seen)[1].mean() - 99.5) < 6  # it turns about itself
    assert (images[0] != images[2]).any()
    assert np.ptp(sizes) < 0.3 * np.mean(sizes)
    # With a camera it is gb.orbit.
    assert main([*words, "--eye", "3,1,2", "--look-at", "0,0,0", "-o", "turn/o_%d.png"]) == 0
    third = gb.orbit(gb.Camera((3, 1, 2), (0, 0, 0)), n=8)[2]
    expected = gb.render("frame_0.npz", third, (200, 150)).image
    assert np.abs(opened("turn/o_2.png").astype(int) - expected).mean() < 0.05


def test_transparent_and_flat_on_the_command_line(files):
    words = ["render", "frame_0.npz", *COMMON, "--color-by", "speed"]
    assert main([*words, "--flat", "--transparent", "--surface", "balls", "-o", "a.png"]) == 0
    flat = opened("a.png")
    assert flat.shape == (150, 200, 4)
    assert set(np.unique(flat[..., 3])) == {0, 255}
    scene = gb.Scene("frame_0.npz")
    settings = dataclasses.replace(gb.load_preset("flat", scene), transparent=True)
    frame = gb.render(scene, size=(200, 150), settings=settings, color_by="speed")
    assert (frame.image == flat).all()
    assert main([*words, "--transparent", "--samples", "4", "--axes", "-o", "b.png"]) == 0
    assert len(np.unique(opened("b.png")[..., 3])) > 3


def test_mistakes_on_the_command_line(files, capsys):
    for words, what in (
        (["--legend-at", "outside"], "--legend-at: expected --color-by beside it"),
        (["--views", "front", "--eye", "1,2,3"], "--views: expected no --eye"),
        (["--views", "front", "--pick", "1,2"], "--views: expected no --pick"),
        (["--views", "behind"], "--views: expected some of front"),
        (["--views", "front", "--size", "3x3"], "--size: expected at least 64"),
        (["--time", "1,2,3"], "--time: expected START or START,STEP"),
        (["--turntable", "1"], "--turntable: expected a whole number from 2"),
        (["--transparent", "-o", "a.mp4"], "--transparent: expected images"),
    ):
        assert what in refused(capsys, "render", "frame_0.npz", "-o", "a.png", *words)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_box_that_is_much_larger_than_the_image(orthographic):
    """Only what is in the image is drawn: before, ticks counted the pixels of a whole edge."""
    scene = gb.Scene(gb.Particles(np.random.default_rng(1).random((30, 3)), support=0.1), threads=1)
    lo, hi = scene.particles.bounds()
    middle = (lo + hi) / 2
    edge = np.array([lo[0], lo[1], middle[2]])
    for small in (1e-1, 1e-3, 1e-5, 1e-7):
        from_edge = tuple((edge - [small, small, 0]).tolist()), tuple((edge + [0, 0, 0.1]).tolist())
        from_outside = tuple((middle + [1.2, 1.0, 1.3]).tolist()), tuple(middle.tolist())
        cameras = [gb.Camera(*from_edge, fov=40.0), gb.Camera(*from_outside, fov=small)]
        if orthographic:
            cameras = [gb.Camera(*from_outside, height=small), gb.Camera(*from_edge, height=small)]
        for camera in cameras:
            tracemalloc.start()
            gb.render(scene, camera, (96, 72), annotate=gb.Annotation(box=True)).image  # noqa: B018
            assert tracemalloc.get_traced_memory()[1] < 50e6
            tracemalloc.stop()


def test_the_help_of_a_switch_names_no_values(capsys):
    assert main(["render", "--help"]) == 0
    assert "lower-right" not in capsys.readouterr().out
