"""The page for everyone: any size of window, keyboard only, screen readers, contrast."""

import pytest
from viewer_helpers import PATIENCE, Watched, blob, open_section, until

BROWSERS = True  # see hang_guard
pytestmark = [pytest.mark.browser, pytest.mark.slow]
SECTIONS = ("Pick", "Layer", "Time", "Cut", "Camera", "Light", "Image", "Save", "Help", "Statistics")
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]
BOXES = """() => Object.fromEntries(['.tools', '.layers', '.time'].map(name => {
    const box = document.querySelector('#globule-desk ' + name).getBoundingClientRect();
    return [name, [box.left, box.top, box.right, box.bottom]];
}))"""


@pytest.fixture
def watched(chromium):
    with Watched([blob(100), blob(100, 2)], chromium) as made:
        made.viewer.state.set(color__by="speed")
        yield made


def opened(watched, width, height, **more):
    context = watched.opened.new_context(viewport={"width": width, "height": height}, **more)
    watched.pages.append(context)
    page = context.new_page()
    page.set_default_timeout(1000 * PATIENCE)
    page.goto(watched.viewer.address)
    desk = page.locator("#globule-desk")
    desk.get_by_role("button", name="Layers", exact=True).wait_for()
    if desk.locator(".layers").is_hidden():
        desk.get_by_role("button", name="Layers", exact=True).click()
    desk.get_by_role("img", name="Histogram of speed").wait_for()
    return page, desk


@pytest.mark.parametrize("size", [(390, 844), (3840, 2160)])
def test_a_phone_and_a_4k_window(watched, size):
    page, desk = opened(watched, *size)
    boxes = page.evaluate(BOXES)
    for left, top, right, bottom in boxes.values():
        assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1]  # noqa: PT018
    for one, other in ((".tools", ".layers"), (".layers", ".time")):
        assert boxes[one][3] <= boxes[other][1]
    inspector, button = desk.locator(".inspector"), desk.get_by_role("button", name="Inspector")
    letters = desk.evaluate("desk => parseFloat(getComputedStyle(desk).fontSize)")
    if size[0] > 1000:
        assert letters > 20
        assert inspector.bounding_box()["width"] > 450
        return
    assert not inspector.is_visible()  # the image has the window
    button.click()
    inspector.wait_for()
    assert not desk.locator(".layers").is_visible()
    button.click()
    until(lambda: not inspector.is_visible())
    for made in desk.locator(".tools button").all():
        if made.is_visible():
            assert made.bounding_box()["width"] >= 40  # a finger


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_finding_of_axe(watched, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page, _ = opened(watched, 1000, 640, color_scheme=scheme)
    watched.viewer.state.set(cuts__plane=True, cuts__box=True, look__lights="own")
    page.locator("[data-handle=hi]").wait_for()
    found = {}
    for title in SECTIONS:
        open_section(page, title)
        violations = axe.Axe().run(page, options={"runOnly": RULES}).response["violations"]
        found |= {f"{v['impact']} {v['id']}: {v['nodes'][0]['html'][:200]}": title for v in violations}
    assert not found


def test_with_the_keyboard_alone(watched):
    page, _ = opened(watched, 1000, 640)
    state, order = watched.viewer.state, []
    page.evaluate("() => document.activeElement.blur()")
    name = """() => {
        const at = document.activeElement;
        return at.getAttribute('aria-label') || at.labels?.[0]?.innerText || at.innerText;
    }"""

    def go_to(wanted):
        for _ in range(200):
            page.keyboard.press("Tab")
            order.append(page.evaluate(name) or "")
            if order[-1].startswith(wanted):
                return
        raise AssertionError(f"{wanted} is not among {order}")

    go_to("Cutting plane")
    style = "() => getComputedStyle(document.activeElement).outlineStyle"
    assert page.evaluate(style) == "solid"  # it is seen where the focus is
    page.keyboard.press("Enter")
    until(lambda: state.cuts.plane)
    go_to("Color by")
    page.keyboard.press("Home")
    until(lambda: state.color.by == "")
    go_to("Next frame")
    page.keyboard.press("Enter")
    until(lambda: state.time.frame == 1)
