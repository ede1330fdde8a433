"""Pages in a browser: what the canvas shows, what a click finds, what is copied."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import accuracy_viewer
import numpy as np
import pytest
from accuracy_viewer import LIGHT_FIELDS, STATES, decoded, differences, open_page
from click.testing import CliRunner

import clplen
from clplen.cli.app import main
from clplen.io import read_picture
from clplen.io.page.html_page import content_of, script, style, write_page
from clplen.io.page.samples import Content
from clplen.io.page.volume_item import volume_item

pytestmark = pytest.mark.browser

# Light fields that CI opens; the others are opened at night.
DAILY = ("odd, grey", "16 bits, colour", "weights 0", "2209 views", "half floats")

RNG = np.random.default_rng(11)
FLOWER = ["--pattern", "IMG_0001_{n}_{u}_{v}.png"]


def planes(disparities: tuple[float, ...], views: int = 7, size: int = 64) -> np.ndarray:
    """Views of textured stripes, each on a plane of its own disparity."""
    width = size // len(disparities)
    a = np.zeros((views, views, size, size), np.float32)
    waves = RNG.uniform(0.3, 1.6, (12, 2)) * RNG.choice([-1, 1], (12, 2))
    phases = RNG.uniform(0, 6, 12)
    y, x = np.indices((size, size)).astype(float)
    for n, d in enumerate(disparities):
        stripe = slice(n * width, (n + 1) * width)
        for v in range(views):
            for u in range(views):
                at = (y + (v - (views - 1) / 2) * d, x + (u - (views - 1) / 2) * d)
                texture = sum(
                    np.cos(w[0] * at[0] + w[1] * at[1] + p)
                    for w, p in zip(waves, phases, strict=True)
                )
                a[v, u, :, stripe] = 0.5 + 0.06 * texture[:, stripe]
    return np.rint(255 * np.clip(a, 0, 1)).astype(np.uint8)


def evaluate(page: Any, code: str, *words: Any) -> Any:
    return page.evaluate(code, *words)


def failure_of(page: Any) -> str:
    """The sentence of a page that shows nothing."""
    page.evaluate(accuracy_viewer.READY)
    return str(page.locator("#clplen-viewer").inner_text())


@pytest.mark.parametrize(
    "name",
    [name if name in DAILY else pytest.param(name, marks=pytest.mark.nightly)
     for name in LIGHT_FIELDS],
)  # fmt: skip
def test_the_canvas_is_what_clplen_computes(browser, tmp_path, name):
    found = differences(browser, tmp_path, name)
    assert set(found) == set(STATES)
    assert max(max(pair) for pair in found.values()) <= 1, found


def test_a_page_asks_no_network(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.5, -0.5)))
    page = browser.new_context().new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    page.evaluate(accuracy_viewer.READY)
    assert [url for url in asked if not url.startswith(("blob:", "data:"))] == [path.as_uri()]
    page.context.close()


@pytest.mark.parametrize("by_map", [False, True])
def test_a_click_finds_the_plane(browser, tmp_path, by_map):
    true = (-1.1, 0.4, 1.3)
    lf = clplen.LightField.from_array(planes(true, size=96))
    path = tmp_path / "page.html"
    clplen.io.write_html(path, lf, depth=clplen.depth_map(lf) if by_map else None)
    page = open_page(browser, path)
    for n, d in enumerate(true):
        for y in (30, 62):
            found = evaluate(page, f"clplen.view.focusAt({y}, {16 + 32 * n})")
            assert abs(found - d) < 0.05, (n, y)
    assert evaluate(page, "clplen.view.state.shape") == "all"
    page.context.close()


def test_a_mouse_click_lands_on_its_pixel(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.8), size=80))
    page = open_page(browser, path, viewport={"width": 1000, "height": 700})
    evaluate(page, "window.said = []; clplen.view.stage.onClick = (y, x) => said.push([y, x])")
    box = page.locator(".stage canvas").first.bounding_box()
    scale = min(box["width"], box["height"]) / 80
    left, top = (box[s] / 2 - 40 * scale for s in ("width", "height"))
    for y, x in ((3, 5), (70, 11), (41, 79)):
        at = (box["x"] + left + (x + 0.5) * scale, box["y"] + top + (y + 0.5) * scale)
        page.mouse.click(*at)
        assert evaluate(page, "said.at(-1)") == [y, x]
    page.mouse.move(box["x"] + left + 20.5 * scale, box["y"] + top + 60.5 * scale)
    page.mouse.wheel(0, -600)  # what is under the mouse stays there
    page.mouse.down()
    page.mouse.up()
    assert evaluate(page, "said.at(-1)") == [60, 20]
    assert evaluate(page, "clplen.view.stage.link.zoom") > 2
    page.context.close()


def test_a_drag_moves_the_viewpoint_and_keys_do_too(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.8)))
    page = open_page(browser, path)
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(380, 300, steps=4)
    page.mouse.up()
    state = evaluate(page, "clplen.view.state")
    assert state["v"] == 3
    assert state["u"] < 3  # the scene follows the hand
    page.locator(".stage").first.focus()
    page.keyboard.press("ArrowDown")
    assert evaluate(page, "clplen.view.state.v") == 3.5
    page.keyboard.press("]")
    assert evaluate(page, "clplen.view.state.d") > state["d"]
    page.keyboard.press("g")
    assert evaluate(page, "clplen.view.state.show") == "views"
    page.context.close()


def test_keys_work_wherever_the_focus_is_but_in_a_field(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.8)))
    page = open_page(browser, path)
    state = "clplen.view.state"
    page.keyboard.press("g")
    assert evaluate(page, f"{state}.show") == "views"
    page.keyboard.press("e")  # the stage has gone, and its focus
    assert evaluate(page, f"{state}.show") == "slices"
    page.get_by_role("button", name="Copy as Python").focus()
    page.keyboard.press("p")
    assert evaluate(page, f"{state}.show") == "picture"
    before = evaluate(page, f"{state}.d")
    page.get_by_role("radio", name="All").focus()
    page.keyboard.press("]")
    assert evaluate(page, f"{state}.d") > before
    field = page.locator("input[type=number]").first
    field.focus()
    page.keyboard.press("g")
    assert evaluate(page, f"{state}.show") == "picture"
    page.context.close()


def test_the_slider_of_focus_opens_one_view(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.8)))
    page = open_page(browser, path)
    assert evaluate(page, "clplen.view.state.shape") == "one"
    slider = page.locator("input[type=range]").first
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert evaluate(page, "clplen.view.state.shape") == "all"
    page.context.close()


def test_every_control_is_reached_by_the_tab_key(browser, tmp_path):
    path = tmp_path / "page.html"
    lf = clplen.LightField.from_array(planes((0.8, -0.8)), spacing=(-1e-3, -1e-3, 2e-5, 2e-5))
    clplen.io.write_html(path, lf, depth=clplen.depth_map(lf))
    page = open_page(browser, path)
    evaluate(page, "clplen.view.change({shape: 'disc', curve: 'gamma'})")
    wanted = evaluate(
        page,
        "[...document.querySelectorAll('button, input, select, .stage')].filter("
        "(n) => n.checkVisibility() && !(n.type === 'radio' && !n.checked)).length",
    )
    reached = set()
    for _ in range(wanted + 5):
        page.keyboard.press("Tab")
        reached.add(
            evaluate(
                page,
                "[...document.querySelectorAll('*')].indexOf(document.activeElement)",
            )
        )
    names = evaluate(
        page,
        "[...document.querySelectorAll('button, input, select, canvas[role], .stage')].filter("
        "(n) => n.checkVisibility()).map((n) => n.ariaLabel ?? n.labels?.[0]?.textContent ?? "
        "n.textContent)",
    )
    assert len(reached) >= wanted
    assert all(names)
    page.context.close()


@pytest.mark.parametrize(
    "state",
    [
        pytest.param({"shape": "all", "d": -0.37}, marks=pytest.mark.nightly),
        {"shape": "disc", "diameter": 0.45, "d": 0.8},
        {"shape": "disc", "diameter": 0.5, "v": 1.5, "u": 4.25, "d": 0.8},
        pytest.param({"shape": "square", "across": 3, "d": 0.8}, marks=pytest.mark.nightly),
        pytest.param({"shape": "one", "v": 2, "u": 5, "d": 0.8}, marks=pytest.mark.nightly),
        {"shape": "one", "v": 2.3, "u": 4.75, "d": -0.6},
        {"shape": "all", "sharp": True, "curve": "srgb", "black": 20, "white": 231.5},
        pytest.param(
            {"shape": "disc", "diameter": 0.7, "sharp": True, "curve": "gamma", "gamma": 1.8},
            marks=pytest.mark.nightly,
        ),
        {"shape": "one", "v": 2.3, "u": 4.75, "sharp": True, "curve": "log"},
    ],
)
def test_copied_command_and_python_make_the_same_picture(browser, tmp_path, monkeypatch, state):
    monkeypatch.chdir(tmp_path)
    clplen.write_lightfield("a field.h5", clplen.LightField.from_array(planes((0.8, -0.6))))
    run("view", "a field.h5", "-o", "page.html")
    page = open_page(browser, tmp_path / "page.html")
    saved = decoded(page.evaluate(accuracy_viewer._CANVAS, state)[1])
    lines = evaluate(page, "clplen.view.command()").split("\n")
    for line in lines:
        run(*shlex.split(line)[1:])
    made = read_picture("picture.png").astype(float)
    assert np.abs(made.reshape(*made.shape[:2], -1) - saved).max() <= 1
    python = evaluate(page, "clplen.view.python()")
    exec(compile(python, "copied", "exec"), {})
    values = clplen.io.read_image("picture.tif").to_numpy()
    shown = accuracy_viewer.levels(values, evaluate(page, "clplen.view.state"))
    assert np.abs(shown - saved).max() <= 1
    page.context.close()


def run(*words: str) -> str:
    done = CliRunner().invoke(main, list(words), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return str(done.output)


def test_copied_commands_protect_the_names_of_files(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.5, -0.5)))
    page = open_page(browser, path)
    for name, word in {
        "-rf.h5": "./-rf.h5",
        "a 'b'.h5": "'a '\\''b'\\''.h5'",
        "a\n\x1b[1m\\.h5": r"$'a\x0a\x1b[1m\\.h5'",
    }.items():
        evaluate(page, "input => (clplen.view.item.command = { input, options: [] })", name)
        command = str(evaluate(page, "clplen.view.command()"))
        assert f" {word} -o picture.png " in command
        words = subprocess.run(
            ["bash", "-c", f"printf '%s\\0' {command}"], capture_output=True, text=True, check=True
        ).stdout.split("\0")
        assert words[2].removeprefix("./") == name
    page.context.close()


def test_a_hint_stays_until_its_actions_were_done_once(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.8), size=80))
    page = open_page(browser, path)
    hint = page.locator(".hint")
    assert hint.inner_text() == "Drag to look around. Click to focus. Press ? for all keys."
    assert (
        page.locator(".status").inner_text().startswith("View (v, u) = (3, 3) of 7 x 7; focus at")
    )
    page.locator(".stage").first.focus()
    page.keyboard.press("ArrowLeft")
    assert hint.inner_text() == "Click to focus. Press ? for all keys."
    page.locator(".stage canvas").first.click()
    assert hint.is_hidden()
    assert "All 7 x 7 views; focus at disparity" in page.locator(".status").inner_text()
    page.reload()
    page.evaluate(accuracy_viewer.READY)
    assert hint.is_hidden()
    page.context.close()


def test_the_link_brings_the_view_back(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.6)))
    page = open_page(browser, path)
    evaluate(page, "clplen.view.change({shape: 'disc', diameter: 0.31, d: 0.77, v: 1.25})")
    evaluate(page, "clplen.view.stage.look({zoom: 3, y: 0.4, x: 0.7})")
    page.wait_for_url("**cx=**")
    other = open_page(browser, page.url)
    assert evaluate(other, "clplen.view.state") == evaluate(page, "clplen.view.state")
    assert evaluate(other, "clplen.view.stage.link.zoom") == 3
    for bad in ("v=NaN&u=1e99&d=x&shape=toString&show=<b>", "item=7", "zoom=-1&cy=2", "%%%"):
        broken = open_page(browser, f"{path.as_uri()}#{bad}")
        state = evaluate(broken, "clplen.view.state")
        assert 0 <= state["u"] <= 6
        assert state["shape"] == "one"
        broken.context.close()
    other.context.close()
    page.context.close()


@pytest.mark.parametrize("channels", [1, 3])
def test_slices_and_projections_of_a_volume(browser, tmp_path, channels):
    volume = RNG.random((5, 7, 11, 3)[: 3 + (channels == 3)]).astype(np.float32)
    volume[2, 3, 4] = np.nan
    path, content = tmp_path / "page.html", Content()
    content.about = {"title": "", "items": [volume_item(volume[None], content, name="volume")]}
    write_page(path, content)
    page = open_page(browser, path)
    for projection, axis, wanted in [
        ("slice", "z", volume[1]),
        ("slice", "y", volume[:, 6]),
        ("slice", "x", volume[:, :, 9].swapaxes(0, 1)),
        ("maximum", "z", np.nanmax(volume, axis=0)),
        ("maximum", "x", np.nanmax(volume, axis=2).swapaxes(0, 1)),
    ]:
        found = evaluate(
            page,
            "([projection, axis]) => { clplen.view.change({projection, z: 1, y: 6, x: 9});"
            " return [...clplen.view.section(axis).values].map((x) => x ?? null); }",
            [projection, axis],
        )
        values = np.array([np.nan if x is None else x for x in found], float)
        assert np.allclose(values, wanted.ravel(), atol=2e-5, equal_nan=True), (projection, axis)
    page.context.close()


@pytest.mark.parametrize("share", [0.3, 0.6, 0.999])
def test_a_page_that_was_cut_off_says_so(browser, tmp_path, share):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.6)))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    page = browser.new_context(offline=True).new_page()
    page.goto(path.as_uri())
    said = failure_of(page)
    assert re.search("incomplete|cut off", said), said
    assert len(said) < 300
    page.context.close()


def test_no_webgl_is_a_sentence(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.6)))
    page = browser.new_context(offline=True).new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(path.as_uri())
    assert "has no WebGL 2" in failure_of(page)
    page.context.close()


def test_views_larger_than_a_texture_are_a_sentence(browser, tmp_path):
    path = tmp_path / "page.html"
    clplen.io.write_html(path, planes((0.8, -0.6)))
    page = browser.new_context(offline=True).new_page()
    page.add_init_script(
        "const ask = WebGL2RenderingContext.prototype.getParameter;"
        "WebGL2RenderingContext.prototype.getParameter = function (name) {"
        " return name === this.MAX_TEXTURE_SIZE ? 50 : ask.call(this, name); }"
    )
    page.goto(path.as_uri())
    assert "--downscale" in failure_of(page)
    page.context.close()


@pytest.mark.nightly  # half a minute
def test_the_flower(browser, tmp_path, data_folder):
    """A click finds the disparities that matching views finds, with a map and without."""
    folder = data_folder / "lytro_f01_flower"
    pattern = FLOWER[1]
    lf = clplen.read_lightfield(folder, pattern=pattern)
    known = clplen.depth_map(lf, disparities=np.linspace(-1, -0.3, 71), cue="correspondence")
    places = ((122, 160), (66, 110), (200, 150), (40, 180), (215, 60))
    for depth in (None, clplen.depth_map(lf)):
        path = tmp_path / "flower.html"
        clplen.io.write_html(path, lf, depth=depth)
        page = open_page(browser, path)
        for y, x in places:
            window = known.disparity[y - 6 : y + 7, x - 6 : x + 7]
            found = evaluate(page, f"clplen.view.focusAt({y}, {x})")
            assert abs(found - np.median(window)) < 0.05, (y, x, depth is None)
        page.context.close()


@pytest.fixture
def served(browser, tmp_path):
    """A function that serves a file by a command of its own and opens it; all are ended."""
    running = []

    def serve(*words: str) -> Any:
        command = [sys.executable, "-m", "clplen", "view", *words, "--no-browser"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        running.append(process)
        line = process.stdout.readline()
        assert line.startswith("Open http://127.0.0.1:"), line
        page = browser.new_page()
        page.goto(line.split()[1])
        page.evaluate(accuracy_viewer.READY)
        return page, process

    yield serve
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


PICTURE = """
async ([state, interpolation, finer]) => {
  const view = clplen.view;
  view.change({sharp: false, ...state});
  Object.assign(view.device, {interpolation, finer});
  const made = await view.device.compute();
  return made.canvas.toDataURL();
}
"""


def test_the_device_computes_what_a_browser_cannot(served, tmp_path):
    lf = clplen.LightField.from_array(planes((0.8, -0.6)))
    clplen.write_lightfield(tmp_path / "lf.h5", lf)
    page, process = served("lf.h5", "--no-depth")
    cases = [
        ({"shape": "all", "d": 0.37}, "cubic", 1),
        ({"shape": "all", "d": 0.37}, "fourier", 1),
        ({"shape": "all", "d": 0.37}, "linear", 3),
        ({"shape": "disc", "diameter": 0.6, "v": 2.0, "u": 3.5, "d": -0.6}, "linear", 1),
        ({"shape": "one", "v": 2.25, "u": 3.5, "d": -0.6}, "cubic", 1),
    ]
    for state, interpolation, finer in cases:
        shown = decoded(evaluate(page, PICTURE, [state, interpolation, finer]))
        if state["shape"] == "all":
            words = {"interpolation": interpolation, "upsample": finer}
            wanted = clplen.refocus(lf, disparity=state["d"], **words).to_numpy()
        else:
            now = evaluate(page, "clplen.view.state")
            wanted = accuracy_viewer.computed(lf, now)
        levels = accuracy_viewer.levels(wanted, evaluate(page, "clplen.view.state"))
        assert shown.shape == levels.shape
        assert np.abs(shown - levels).max() <= 1, (state, interpolation)
    evaluate(page, "clplen.view.device.depth()")
    assert evaluate(page, "clplen.view.renderer.hasMap && clplen.view.state.depth")
    found = evaluate(page, "clplen.view.focusAt(30, 12)")
    assert abs(found - 0.8) < 0.05
    page.close()
    assert process.wait(10) == 0  # it ends with its page


def test_a_light_field_larger_than_memory_is_seen_in_full_detail(served, tmp_path):
    views = planes((0.8, -0.6), views=5, size=96)
    np.save(tmp_path / "large.npy", views)
    page, _ = served("large.npy", "--memory", "200MB", "--downscale", "3")
    assert evaluate(page, "clplen.view.item.shape") == [5, 5, 32, 32]
    evaluate(page, "clplen.view.change({shape: 'all', d: 0.2})")
    evaluate(page, "clplen.view.stage.look({zoom: 3, y: 0.4, x: 0.6})")
    url, region, state = evaluate(
        page,
        "clplen.view.device.compute().then((made) => [made.canvas.toDataURL(), made.region,"
        " clplen.view.state])",
    )
    y0, y1, x0, x1 = region
    assert 25 < y1 - y0 < 60  # what is in sight, not all
    whole = clplen.refocus(clplen.LightField.from_array(views), disparity=0.6).to_numpy()
    wanted = accuracy_viewer.levels(whole[y0:y1, x0:x1], state)
    assert np.abs(decoded(url) - wanted).max() <= 1


def test_a_file_that_was_removed_and_a_server_that_was_killed(served, tmp_path):
    np.save(tmp_path / "lf.npy", planes((0.8, -0.6), size=40))
    page, process = served("lf.npy", "--no-depth", "--keep")
    page.reload()
    page.evaluate(accuracy_viewer.READY)
    process.kill()
    process.wait()
    evaluate(page, "clplen.view.device.depth()")
    assert "clplen view has ended" in page.locator("footer").inner_text()
    evaluate(page, "clplen.view.focusAt(10, 10)")  # what the page has goes on
    assert evaluate(page, "clplen.view.state.shape") == "all"


FAKE_NOTEBOOK = """
const model = {
  get: (name) => window.fake[name],
  on: (_, receive) => (window.receive = receive),
  send: (message) => (window.sent = message),
};
window.done = widget_js.render({ model, el: document.getElementById("cell") });
"""


def test_the_widget_in_a_notebook(browser):
    content = content_of(planes((0.8, -0.6), size=40))
    page = browser.new_page(viewport={"width": 900, "height": 700})
    failures: list[str] = []
    page.on("pageerror", lambda error: failures.append(str(error)))
    page.set_content("<div id=cell></div>")
    blobs = [list(blob) for blob in content.encoded()]
    page.evaluate(
        "([content, blobs]) => { window.fake = {content, computes: true, height: 500,"
        " blobs: blobs.map((b) => new DataView(Uint8Array.from(b).buffer))}; }",
        [content.about, blobs],
    )
    page.add_style_tag(content=style())
    page.add_script_tag(type="module", content=script("widget") + FAKE_NOTEBOOK)
    page.wait_for_selector("#cell .stage canvas")
    page.wait_for_timeout(300)
    assert page.evaluate("location.hash") == ""  # the notebook's address is not the viewer's
    page.get_by_role("button", name="Compute depth").click()
    page.wait_for_timeout(100)
    asked = page.evaluate("window.sent")
    assert asked["request"]["kind"] == "depth"
    page.evaluate(
        "window.receive({id: sent.id, channel: 'depth', error: 'Too dark.'}, [])",
    )
    page.wait_for_timeout(50)
    assert "Too dark." in page.locator("footer").inner_text()
    page.evaluate("window.done()")
    assert page.locator("#cell .stage").count() == 0
    assert failures == []
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 375])
def test_contrast_and_labels_by_axe(browser, tmp_path, scheme, width):
    axe = Path(os.environ.get("CLPLEN_AXE", ""))
    if not axe.is_file():
        pytest.skip("axe-core is judged where CLPLEN_AXE names axe.min.js: npm install axe-core")
    lf = clplen.LightField.from_array(planes((0.8, -0.6)), spacing=(-1e-3, -1e-3, 2e-5, 2e-5))
    depth = clplen.depth_map(lf)
    volume = RNG.random((5, 20, 30))
    one, two = tmp_path / "one.html", tmp_path / "two.html"
    clplen.io.write_html(one, {"field": lf, "volume": volume}, depth=depth)
    clplen.io.write_html(two, {"map": depth, "other": depth}, compare=True)
    options = {"viewport": {"width": width, "height": 760}, "color_scheme": scheme}
    found: list[str] = []
    for path, state in (
        (one, "{shape: 'disc', curve: 'gamma', depth: true}"),
        (one, "{show: 'slices'}"),
        (one, "{show: 'views'}"),
        (one, "item"),
        (two, ""),
    ):
        page = open_page(browser, path, bypass_csp=True, **options)
        if state == "item":
            page.get_by_role("tab", name="volume").click()
        elif state:
            evaluate(page, f"clplen.view.change({state})")
        page.wait_for_timeout(100)
        found += violations_of(page, axe)
        page.context.close()
    assert found == []


def violations_of(page: Any, axe: Path) -> list[str]:
    """What axe-core finds against WCAG 2.1 AA."""
    page.add_script_tag(path=str(axe))
    tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]
    violations = page.evaluate(f"axe.run({{runOnly: {tags}}}).then((r) => r.violations)")
    return [f"{v['id']}: {node['html'][:80]}" for v in violations for node in v["nodes"]]
