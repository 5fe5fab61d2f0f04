"""The page of a report in a browser: plots, tables, widths, colour schemes, and no scripts."""

import re

import pytest
from report_results import comparison, explanation, friction, joint_names, page, step

JOINTS = joint_names(10)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return the path of a report on three effects at ten joints."""
    folder = tmp_path_factory.mktemp("pages")
    first = comparison(JOINTS, 0.5).series
    steps = (
        step("payload", ("hand",), {"hand": {"mass": 3.0}}, {}, joints=JOINTS, series=first),
        friction(JOINTS),
    )
    path = folder / "page.html"
    html = page(explanation(JOINTS, steps), links={"Replay": "replay.html"})
    path.write_text(html, encoding="utf-8")
    return path


@pytest.fixture
def opened(browser, file):
    """Return a function that opens a page, which may write to no console and load nothing."""
    contexts, said = [], []

    def open_page(path=file, **context):
        contexts.append(
            browser.new_context(**{"viewport": {"width": 1200, "height": 900}, **context})
        )
        page = contexts[-1].new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: request.url == path.as_uri() or said.append(request.url))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not said


def drawn(page):
    """Return the first joint's plots once they are drawn."""
    page.locator(".panel .place").first.scroll_into_view_if_needed()
    page.wait_for_selector(".panel .uplot")
    return page.locator(".panel").first


def ends(page):
    """Return the first and last instant of the plots."""
    return [float(end) for end in page.locator("#chart-efforts").get_attribute("data-view").split()]


def shown_width(page):
    low, high = ends(page)
    return high - low


def drag(page, area, start, end, keys=()):
    box = area.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + start * box["width"], y)
    for key in keys:
        page.keyboard.down(key)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], y, steps=4)
    page.mouse.up()
    for key in keys:
        page.keyboard.up(key)


def test_plots_zoom_pan_and_reset(opened):
    page = opened()
    area = drawn(page).locator(".u-over").first
    low, high = ends(page)
    drag(page, area, 0.25, 0.5)
    left, right = ends(page)
    assert right - left == pytest.approx(0.25 * (high - low), rel=0.05)
    assert left == pytest.approx(low + 0.25 * (high - low), rel=0.05)
    drag(page, area, 0.2, 0.6, keys=["Shift"])
    panned = ends(page)
    assert panned[1] - panned[0] == pytest.approx(right - left)
    assert panned[0] == pytest.approx(left - 0.4 * (right - left), rel=0.05)
    area.dblclick()
    assert ends(page) == pytest.approx([low, high])
    page.get_by_role("button", name="Zoom in").first.click()
    assert shown_width(page) == pytest.approx(0.5 * (high - low))


def test_joints_share_their_time_and_show_values_under_the_cursor(opened):
    page = opened()
    area = drawn(page).locator(".u-over").first
    area.hover(position={"x": 200, "y": 40})
    said = [text for text in page.locator(".readout").all_inner_texts() if text]
    assert len(said) >= 3  # the residual and another joint, too
    assert re.match(r"\d+\.\d{3} s", said[0])
    assert "measured" in said[0] and "as it stands" in said[0] and "final model" in said[0]
    assert len({text.split(" s")[0] for text in said}) == 1


def test_models_are_shown_and_hidden(opened):
    page = opened()
    area = drawn(page).locator(".u-over").first
    page.locator(".chip[data-stage='as it stands (line)']").click()
    page.locator(".chip[data-stage^='after 1: ']").click()
    area.hover(position={"x": 200, "y": 40})
    said = page.locator(".readout").first.inner_text()
    assert "as it stands" not in said
    assert "after 1: + payload" in said


def test_the_worst_stretch_is_a_click_away(opened):
    page = opened()
    drawn(page)
    whole = shown_width(page)
    item = page.locator(".windows li").first
    length = float(item.get_attribute("data-end")) - float(item.get_attribute("data-start"))
    item.get_by_role("button").click()
    assert shown_width(page) == pytest.approx(3 * length) and 3 * length < whole


def test_all_joints_can_be_chosen_and_the_worst_is_always_there(opened):
    page = opened()
    panels = page.locator("#chart-efforts .panel")
    assert panels.count() == len(JOINTS)
    seen = page.locator("#chart-efforts .panel:visible")
    assert seen.count() == 8
    assert page.locator(".badge:visible").count() >= 1
    page.locator("#chart-efforts .chip[data-joint][aria-pressed=false]").first.click()
    assert seen.count() == 9
    page.locator("#chart-efforts .chip[data-joint=joint_0]").click()
    assert not page.locator("#chart-efforts .panel[data-title=joint_0]").is_visible()


def test_tables_sort_and_filter(opened):
    page = opened()
    section = page.locator("section", has=page.get_by_role("heading", name="Joint by joint"))
    table = section.locator("table")
    head = table.get_by_role("columnheader", name="std")
    column = "rows => rows.map((row) => [...row.cells].at(-4).textContent)"

    def values():
        texts = table.locator("tbody tr").evaluate_all(column)
        assert texts[-1] == ""  # the total stays below
        return [float(text) for text in texts[:-1]]

    head.click()
    assert values() == sorted(values())
    head.click()
    assert values() == sorted(values(), reverse=True)
    assert head.get_attribute("aria-sort") == "descending"
    section.get_by_role("searchbox").fill("joint_7")
    assert table.locator("tbody tr:visible").count() == 2


def test_residuals_are_drawn_with_their_means(opened):
    residuals = opened().locator("#chart-residuals")
    residuals.locator(".panel:visible .place").first.scroll_into_view_if_needed()
    residuals.locator(".uplot").first.wait_for()
    chips = residuals.locator(".chip[data-stage]")
    pressed = chips.evaluate_all("all => all.map((one) => one.getAttribute('aria-pressed'))")
    assert pressed == ["false", "true"]
    assert residuals.locator(".panel:visible").first.locator(".uplot").count() == 3


@pytest.mark.parametrize(("width", "scripts"), [(400, True), (1200, False)])
def test_nothing_is_wider_than_the_window(opened, width, scripts):
    page = opened(viewport={"width": width, "height": 800}, java_script_enabled=scripts)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    sides = page.evaluate(
        "[...document.querySelectorAll('section, header, .chart, .place, .uplot, h1')]"
        ".map((part) => part.getBoundingClientRect()).map((box) => [box.left, box.right])"
    )
    assert len(sides) > 50
    assert all(0 <= left <= right <= width + 0.5 for left, right in sides)


def test_tables_of_long_names_need_no_scrolling(opened, tmp_path):
    joints = tuple(f"lbr_iiwa_shoulder_joint_{k}" for k in range(7))
    first = comparison(joints, 0.5).series
    where = ("lbr_iiwa_tool_flange",)
    payload = step("payload", where, {where[0]: {"mass": 3.0}}, {}, joints=joints, series=first)
    html = page(explanation(joints, (payload, friction(joints[:3]))))
    path = tmp_path / "long.html"
    path.write_text(html, encoding="utf-8")
    shown = opened(path, viewport={"width": 900, "height": 900})
    tables = shown.locator(".wide")
    sizes = tables.evaluate_all("all => all.map((one) => [one.scrollWidth, one.clientWidth])")
    assert len(sizes) >= 4
    assert all(needed <= shown for needed, shown in sizes)
    assert tables.first.get_by_text(" and ".join((", ".join(joints[:2]), joints[2]))).count() == 1


def luminance(page, selector, name):
    color = page.locator(selector).first.evaluate(f"part => getComputedStyle(part).{name}")
    return sum(map(float, re.findall(r"[\d.]+", color)[:3])) / 3


def test_schemes(opened):
    page = opened(color_scheme="dark")
    is_dark = lambda: luminance(page, "section", "backgroundColor") < 100  # noqa: E731
    assert is_dark()
    assert (luminance(page, "h1", "color") > 100) == is_dark()
    page.locator(".scheme").click()
    assert not is_dark()
    page.emulate_media(media="print")
    assert not is_dark()


def test_without_scripts_all_but_the_plots_is_there(opened):
    page = opened(java_script_enabled=False)
    assert page.get_by_text("Plots are drawn where scripts are allowed.").count() == 2
    assert page.locator("#chart-efforts .windows li").count() > 5
    assert not page.locator("button").count()
    assert page.locator("nav.links a").get_attribute("href") == "replay.html"
    page.locator("summary").first.click()
    assert page.get_by_text("by chance is the probability").is_visible()


def test_names_run_nothing(opened, tmp_path):
    evil = "</script><script>alert('1')</script>"
    path = tmp_path / "evil.html"
    path.write_text(page(comparison((evil, "b"), 1.0)), encoding="utf-8")
    shown = opened(path)
    drawn(shown)
    assert shown.locator(".chart h3").first.inner_text() == evil
    shown.locator(".chip[data-joint]").first.click()
    assert not shown.locator(".chart .panel").first.is_visible()
