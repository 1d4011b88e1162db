"""The page with dimmers in a browser, against `mix`."""

import base64
import io
import json
import shlex
import tomllib

import numpy as np
import pytest
from PIL import Image

import lumitree
from lumitree.cli import main
from support.browser import CHROMIUM, evaluate
from support.mixed_layers import write_wall

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no program chromium"),
]

# Sets controls, by selector or by number of the lamp, and returns what is shown then.
SCRIPT = """
await (async () => {
  await lumitree.ready;
  const found = [], frame = () => new Promise(done => requestAnimationFrame(done));
  for (const changes of STATES) {
    document.getElementById("reset").click();
    for (const [selector, value] of Object.entries(changes)) {
      const control = document.querySelector(selector);
      control.value = value;
      control.dispatchEvent(new Event("input", { bubbles: true }));
    }
    await frame();
    await frame();
    const value = id => document.getElementById(id).value;
    const png = document.getElementById("view").toDataURL();
    found.push({ png, command: value("command"), placements: value("placements") });
  }
  return found;
})()"""
DIMMER, COLOUR = "#lamps section:nth-child({}) input", "#lamps section:nth-child({}) .colour"
STATES = [
    {},
    {DIMMER.format(1): 50, DIMMER.format(3): 0},
    {DIMMER.format(2): 200, "#exposure": "2.5", "#bloom": "0.3"},
    {COLOUR.format(1): np.log(6500), COLOUR.format(3): np.log(2500), "#curve": "srgb"},
    {"#balance": "off", "#bloom": "0"},
    {"#balance": "kelvin", "#kelvin": np.log(3000), "#exposure": "-1.5", "#curve": "srgb"},
]


def shown(page, states, folder):
    script = SCRIPT.replace("STATES", json.dumps(states))
    return evaluate(page, script, folder / "profile")


def pixels(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), int)


def canvas_of(found):
    return pixels(base64.b64decode(found["png"].partition(",")[2]))


@pytest.mark.parametrize(("height", "width"), [(90, 161), (128, 96)])
def test_the_canvas_is_the_image_of_the_command(mi, tmp_path, monkeypatch, height, width):
    monkeypatch.chdir(tmp_path)
    write_wall("wall.exr", height=height, width=width)
    first = lumitree.mix("wall.exr", {"hall": (0.5, 0.6, 0.7)}, exposure=0.33, bloom=0.1)
    first.save("wall.html")
    found = shown((tmp_path / "wall.html").read_text("utf-8"), STATES, tmp_path)
    commands = []
    assert np.abs(canvas_of(found[0]) - pixels(first.png)).mean() < 1
    for state, each in zip(STATES, found, strict=True):
        program, *arguments = shlex.split(each["command"])
        assert (program, arguments[0]) == ("lumitree", "mix")
        assert main(arguments) == 0
        difference = np.abs(canvas_of(each) - pixels((tmp_path / "wall.png").read_bytes()))
        assert difference.mean() < 1, state
        assert np.quantile(difference, 0.99) <= 4, state
        commands.append(each["command"])
    assert "--gain hall=0.5,0.6,0.7 --exposure=+0.33" in commands[0]
    assert "--gain desk=0.25 " in commands[1]
    assert "--gain room=0 " in commands[1]
    # Gains of the page times the gain of the placement; the room has none.
    tables = tomllib.loads(found[1]["placements"])["lamps"]
    assert tables["desk"] == {
        "asset": "lamp.lumitree", "at": [1, 2.5, 0], "size": 0.5, "gain": [0.5, 0.25, 0.25],
    }  # fmt: skip
    assert tables["hall"]["gain"] == pytest.approx([1, 0.6, 0.7])
    assert "# room: gain = [0, 0, 0]" in found[1]["placements"]
    # Its temperature becomes a black body's, with the luminous flux of before.
    gain = np.array(commands[3].partition("desk=")[2].partition(" ")[0].split(","), float)
    changed = gain * [3.0, 2.0, 0.9]
    assert lumitree.core.photometry.colour_temperature(changed)[0] == pytest.approx(6500, rel=0.01)


def test_pointing_names_the_lamp_and_keys_switch_it(mi, tmp_path):
    """Also without highlights, which arrays do not have."""
    layers = write_wall(tmp_path / "wall.exr")
    lumitree.mix(layers).save(tmp_path / "wall.html")
    script = """
await (async () => {
  await lumitree.ready;
  const canvas = document.getElementById("view"), tip = document.getElementById("tip");
  const box = canvas.getBoundingClientRect(), k = Math.min(box.width / 161, box.height / 90);
  const left = box.left + (box.width - 161 * k) / 2, top = box.top + (box.height - 90 * k) / 2;
  const frame = () => new Promise(done => requestAnimationFrame(done));
  const texts = [];
  for (const [x, y] of [[36, 27], [135, 54], [80, 3]]) {
    const place = { clientX: left + x * k, clientY: top + y * k };
    canvas.dispatchEvent(new PointerEvent("pointermove", place));
    await frame();
    await frame();
    texts.push(tip.textContent);
  }
  document.dispatchEvent(new KeyboardEvent("keydown", { key: "1" }));
  await frame();
  const buttons = [...document.querySelectorAll("#lamps button")];
  const pressed = buttons.map(each => each.getAttribute("aria-pressed"));
  const command = document.getElementById("command").value;
  document.dispatchEvent(new KeyboardEvent("keydown", { key: "0" }));
  await frame();
  return { texts, pressed, command, after: document.getElementById("command").value };
})()"""
    found = evaluate((tmp_path / "wall.html").read_text("utf-8"), script, tmp_path / "profile")
    assert [text.split()[0] for text in found["texts"]] == ["desk", "hall", "room"]
    assert found["pressed"] == ["false", "true", "true"]
    assert "--gain desk=0 " in found["command"]
    assert "desk" not in found["after"]
