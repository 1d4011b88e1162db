"""Images whose call was interrupted continue from the passes that were kept."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.core import checkpoint
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.rendering import passes
from support.fields import random_asset
from support.slow import slow
from support.small_room import SMALL_ROOM

SAMPLES = 12


def keep_passes(folder, monkeypatch):
    """A room and a lamp; passes of two samples per pixel, each of which is kept."""
    monkeypatch.chdir(folder)
    (folder / "room.xml").write_text(SMALL_ROOM)
    lumitree.save(random_asset(3), folder / "lamp.lumitree")
    monkeypatch.setattr(passes, "_SAMPLES_PER_PASS", dict.fromkeys(passes._SAMPLES_PER_PASS, 768))
    monkeypatch.setattr(passes, "_WORTH_SAVING", 0.0)
    monkeypatch.setattr(checkpoint, "_SECONDS", 0.0)
    monkeypatch.setattr(checkpoint, "_MOST_TIME", 1e9)


def note_passes(monkeypatch):
    """Seeds of the passes that were rendered; a list `stop_at` ends the process after so many."""
    render_pass, seeds = passes.render_pass, []

    def noted(scene, integrator, seed, samples):
        if len(seeds) == stop_at[0]:
            raise KeyboardInterrupt
        seeds.append(seed)
        return render_pass(scene, integrator, seed, samples)

    stop_at = [-1]
    monkeypatch.setattr(passes, "render_pass", noted)
    return seeds, stop_at


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    keep_passes(tmp_path, monkeypatch)
    return tmp_path


@pytest.fixture
def rendered(monkeypatch):
    return note_passes(monkeypatch)


def render(samples=SAMPLES, room="room.xml", source: Any = "lamp.lumitree", **options):
    lamp = lumitree.Placement(source, at=(0, 0, 0), size=1.5)
    options = {"work": "work", "layers": True, "progress": None, **options}
    return lumitree.render(room, [lamp], spp=samples, **options)


def interrupted(rendered, after, **options):
    """A call that is interrupted after some passes."""
    seeds, stop_at = rendered
    stop_at[0] = after
    with pytest.raises(KeyboardInterrupt):
        render(**options)
    stop_at[0] = -1
    seeds.clear()


@pytest.fixture(scope="module")
def kept_work(mi, tmp_path_factory):
    """The work folder of an image that was interrupted after four passes."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        folder = tmp_path_factory.mktemp("interrupted")
        keep_passes(folder, monkeypatch)
        interrupted(note_passes(monkeypatch), 4)
    return folder / "work"


def test_an_interrupted_image_continues(rendered):
    whole = render(work=None)
    seeds = rendered[0]
    expected = seeds.copy()
    seeds.clear()
    interrupted(rendered, 4)
    reports: list[lumitree.Progress] = []
    again = render(progress=reports.append)
    assert reports[-1].task == "render, continued after 8 samples per pixel"
    assert seeds == expected[4:]
    assert again.spp == SAMPLES
    assert again.noise == pytest.approx(whole.noise, rel=1e-3)
    for name, layer in whole.layers.items():
        np.testing.assert_allclose(again.layers[name], layer, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(again.pixels, whole.pixels, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("error", [KeyboardInterrupt, LumitreeError])
def test_passes_are_kept_whatever_ends_the_call(monkeypatch, error):
    render_pass, count = passes.render_pass, []

    def failing(*arguments):
        if len(count) == 4:
            raise error
        count.append(1)
        return render_pass(*arguments)

    monkeypatch.setattr(passes, "render_pass", failing)
    monkeypatch.setattr(checkpoint.Checkpoint, "offer", lambda *_: None)
    with pytest.raises(error):
        render()
    assert np.load("work/passes.npz")["passes"] == 4


def test_a_finished_image_is_not_rendered_again(rendered):
    first = render()
    rendered[0].clear()
    assert np.array_equal(render().pixels, first.pixels)
    assert rendered[0] == []


@pytest.mark.slow
def test_a_shorter_last_pass_is_only_that_of_the_same_number(rendered):
    render(samples=5)
    rendered[0].clear()
    render(samples=5)
    assert rendered[0] == []
    with pytest.warns(LumitreeWarning, match="its last pass has fewer"):
        render()
    assert len(rendered[0]) == SAMPLES // 2


def test_time_that_was_spent_counts(rendered):
    options = {"samples": None, "time": 1e5}
    interrupted(rendered, 3, **options)
    state = Path("work/passes.npz")
    arrays = dict(np.load(state))
    arrays["seconds"] = np.array(1e5 + 1)
    np.savez(state, **arrays)
    assert render(**options).spp == arrays["samples"]
    assert rendered[0] == []


def test_an_image_with_a_pixel_that_is_no_number_is_continued(rendered, kept_work):
    """It would be one too if it had not been interrupted."""
    state = Path("work/passes.npz")
    shutil.copytree(kept_work, "work")
    arrays = dict(np.load(state))
    for name in ("radiance", "grey", "squares"):
        arrays[name][0, 0] = np.nan
    np.savez(state, **arrays)
    found = render()
    assert np.isnan(found.pixels[0, 0]).all()
    assert np.isfinite(found.pixels[1:]).all()
    assert len(rendered[0]) == (SAMPLES - arrays["samples"]) // 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        slow("room", "scene"),
        slow("lamp", "lamps"),
        ("seed", "seed 0 -> 1"),
        slow("fewer", "more than 6"),
        slow("cut", "damaged"),
    ],
)
def test_what_is_no_state_of_this_image_is_not_continued(rendered, kept_work, change, message):
    state, options = Path("work/passes.npz"), {}
    shutil.copytree(kept_work, "work")
    if change == "room":
        Path("room.xml").write_text(SMALL_ROOM.replace('value="6"', 'value="5"'))
    elif change == "lamp":
        lumitree.save(random_asset(4), "lamp.lumitree")
    elif change == "seed":
        options["seed"] = 1
    elif change == "fewer":
        options["samples"] = 6
    else:
        state.write_bytes(state.read_bytes()[:-100])
    with pytest.warns(LumitreeWarning, match=f"not continued: .*{message}.*starts again"):
        found = render(**options)
    assert len(rendered[0]) == found.spp // 2 == options.get("samples", SAMPLES) // 2


def test_images_of_a_short_time_leave_nothing(rendered, monkeypatch, capsys):
    """The limit is raised from half a minute, which these images may take on a busy machine."""
    monkeypatch.setattr(passes, "_WORTH_SAVING", 1e6)
    monkeypatch.setattr(checkpoint, "_SECONDS", 1e6)
    interrupted(rendered, 4)
    assert not Path("work").exists()
    rendered[1][0] = 4
    command = ["render", "room.xml", "-o", "a.png", "--place", "lamp.lumitree", "--spp", "12"]
    assert main(command) == 130
    assert capsys.readouterr().err.endswith("the same command begins as this one did\n")


@pytest.mark.slow
def test_the_command_removes_what_it_kept(rendered, capsys):
    command = ["render", "room.xml", "-o", "image.png", "--place", "lamp.lumitree", "--spp", "12"]
    seeds, stop_at = rendered
    stop_at[0] = 4
    assert main(command) == 130
    assert capsys.readouterr().err.endswith("interrupted; the same command continues\n")
    assert Path("image.png.work/passes.npz").exists()
    assert not Path("image.png").exists()
    stop_at[0] = -1
    seeds.clear()
    assert main(command) == 0
    assert len(seeds) == 2
    assert not Path("image.png.work").exists()
    assert main([*command, "--work", "kept"]) == 0
    assert Path("kept/passes.npz").exists()
    capsys.readouterr()


def test_arrays_and_numpy_numbers_place_lamps():
    numbers: dict[str, Any] = {"at": np.zeros(3), "size": np.float32(1.5)}
    lamp = lumitree.Placement("lamp.lumitree", **numbers)
    first = lumitree.render("room.xml", [lamp], spp=2, work="work", progress=None)
    again = lumitree.render("room.xml", [lamp], spp=2, work="work", progress=None)
    np.testing.assert_array_equal(first.pixels, again.pixels)


def test_only_files_can_be_compared_later(mi):
    scene = mi.load_file("room.xml")
    with (
        pytest.warns(LumitreeWarning, match="created already"),
        pytest.raises(LumitreeError, match="work is given with a scene of type"),
    ):
        render(room=scene, layers=False)
    with pytest.raises(LumitreeError, match="as a loaded asset; expected the path"):
        render(source=lumitree.load("lamp.lumitree"))
    assert not Path("work").exists()
