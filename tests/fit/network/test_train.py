"""Training, runs on disk, and the field they give."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys

import jax
import numpy as np
import pytest

import lumitree
from lumitree.errors import LumitreeError
from lumitree.fit.network import train as training
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.rays import load_rays
from lumitree.fit.network.step import psnr
from lumitree.fit.network.train import load_run, train
from lumitree.fit.network.trained_field import load_field
from lumitree.lamp.dataset import Dataset
from support.sphere import CENTRE, RADIUS, TINY, sphere_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return sphere_dataset(tmp_path_factory.mktemp("sphere")).folder


@pytest.fixture(scope="module")
def tiny_run(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiny") / "run"
    train(dataset, folder, TINY)
    return folder


def _final_state(folder):
    return load_run(folder).state


def _history(folder):
    """Rows of step, seconds, loss and PSNR."""
    return np.load(folder / "run.npz")["history"]


def _assert_same(first, second):
    jax.tree.map(np.testing.assert_array_equal, first, second)


@pytest.mark.slow
def test_resumed_run_equals_uninterrupted_one(dataset, tiny_run, tmp_path):
    half = train(dataset, tmp_path / "run", TINY, stop_after=10)
    assert half.steps == 10
    assert int(_final_state(tmp_path / "run").step) == 10
    rest = train(dataset, tmp_path / "run", TINY, resume=True)
    assert rest.steps == 20
    assert rest.seconds > half.seconds
    _assert_same(_final_state(tiny_run), _final_state(tmp_path / "run"))
    assert _history(tmp_path / "run")[:, 0].tolist() == [10, 20]


def test_finished_run_may_be_resumed_again(dataset, tiny_run, tmp_path):
    shutil.copytree(tiny_run, tmp_path / "run")
    assert train(dataset, tmp_path / "run", TINY, resume=True).steps == 20
    _assert_same(_final_state(tiny_run), _final_state(tmp_path / "run"))


@pytest.mark.slow
def test_training_learns_the_sphere(dataset, tmp_path):
    config = dataclasses.replace(TINY, width=32, output_width=32, rays_per_batch=256, num_steps=160)
    result = train(dataset, tmp_path / "run", config)
    assert result.psnr > result.psnr_black + 5
    field = load_field(tmp_path / "run")
    # Just under the surface it is dense, in the corner of the box it is empty.
    inside = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]]) * 0.9 * RADIUS + CENTRE
    assert field.query(inside)[0].min() > 2
    assert field.query([[-0.95, -0.75, -0.65]])[0] == 0


def test_field_says_what_extraction_needs(tiny_run):
    field = load_field(tiny_run)
    assert (field.config, field.luminaire, field.num_steps) == (TINY, "sphere", 20)
    assert 3 < field.max_radiance < 4.1
    np.testing.assert_array_equal(field.frame.half_extents, [1.0, 0.8, 0.7])
    np.testing.assert_array_equal(field.frame.world_from_local, np.eye(4))


@pytest.mark.slow
def test_the_rendered_views_are_those_of_the_training(dataset, tiny_run):
    """`TrainedField.render` reproduces the PSNR that training reports for the held-out rays."""
    data = Dataset.open(dataset)
    rays, _ = load_rays(data, TINY.opacity_kind, TINY.skip_empty)
    held = rays.held_out()
    field = load_field(tiny_run)
    radiance, opacity = field.render(held.origins, held.directions)
    found = float(psnr(radiance, held.radiance, rays.max_radiance))
    assert found == pytest.approx(_history(tiny_run)[-1, 3], abs=1e-3)
    assert opacity.shape == (len(held.opacity),)
    # The number of rays of a call changes nothing.
    few, _ = field.render(held.origins[:3], held.directions[:3])
    np.testing.assert_allclose(few, radiance[:3], atol=1e-5)


@pytest.mark.slow
def test_a_run_with_literal_weights_trains_and_is_not_extracted(dataset, tmp_path):
    config = dataclasses.replace(TINY, emission_weights="literal", num_steps=2)
    train(dataset, tmp_path / "run", config)
    assert load_field(tmp_path / "run").config.emission_weights == "literal"
    with pytest.raises(LumitreeError, match="literal emission weights"):
        lumitree.extract(tmp_path / "run", tree_depth=3)


def test_query_does_not_depend_on_its_chunks(tiny_run):
    field = load_field(tiny_run)
    positions = np.random.default_rng(0).uniform(-1.2, 1.2, (20_000, 3)).astype(np.float32)
    density, coefficients = field.query(positions)
    assert density.dtype == coefficients.dtype == np.float32
    assert coefficients.shape == (20_000, 3, 9)
    assert (density > 0).any()
    outside = np.any(np.abs(positions) > 1.001 * field.frame.half_extents, axis=-1)
    assert (density[outside] == 0).all()
    picked = np.flatnonzero(density)[::500]
    again = field.query(positions[picked])
    np.testing.assert_allclose(again[0], density[picked], rtol=1e-5)
    np.testing.assert_allclose(again[1], coefficients[picked], rtol=1e-4, atol=1e-5)
    assert field.query(np.zeros((0, 3)))[0].shape == (0,)


@pytest.mark.slow
def test_an_unfinished_run_is_extracted_with_a_warning(dataset, tmp_path):
    train(dataset, tmp_path / "run", TINY, stop_after=2)
    with (
        pytest.warns(lumitree.LumitreeWarning, match=r"is at step \d+ of .*--resume` finishes"),
        contextlib.suppress(LumitreeError),
    ):
        lumitree.extract(tmp_path / "run", tree_depth=2)


def test_interrupt_saves_first(dataset, tmp_path, monkeypatch):
    draw = training.RaySet.draw

    def interrupted_draw(self, seed, step, count):
        if step == 6:
            os.kill(os.getpid(), signal.SIGINT)
        return draw(self, seed, step, count)

    monkeypatch.setattr(training.RaySet, "draw", interrupted_draw)
    handler = signal.getsignal(signal.SIGINT)
    assert train(dataset, tmp_path / "run", TINY).stopped_by == signal.SIGINT
    assert signal.getsignal(signal.SIGINT) is handler
    assert int(_final_state(tmp_path / "run").step) == 7


def test_loss_that_is_not_finite_names_the_step(dataset, tmp_path, monkeypatch):
    train(dataset, tmp_path / "run", TINY, stop_after=5)
    draw = training.RaySet.draw

    def poisoned_draw(self, seed, step, count):
        batch = draw(self, seed, step, count)
        return batch._replace(radiance=batch.radiance * (np.nan if step == 7 else 1))

    monkeypatch.setattr(training.RaySet, "draw", poisoned_draw)
    with pytest.raises(LumitreeError, match=r"not finite at step 8.*checkpoint there is good"):
        train(dataset, tmp_path / "run", TINY, resume=True)
    assert int(_final_state(tmp_path / "run").step) == 5


def test_run_folder_that_cannot_be_used_is_refused(dataset, tiny_run, tmp_path):
    with pytest.raises(LumitreeError, match="not empty; continue it with --resume"):
        train(dataset, tiny_run, TINY)
    with pytest.raises(LumitreeError, match="nothing to resume"):
        train(dataset, tmp_path / "none", TINY, resume=True)
    with pytest.raises(LumitreeError, match="l_max 2 -> 1"):
        train(dataset, tiny_run, dataclasses.replace(TINY, l_max=1), resume=True)
    with pytest.raises(LumitreeError, match="max_radiance"):
        train(sphere_dataset(tmp_path / "b", 4, 16, 2.0).folder, tiny_run, TINY, resume=True)


def test_damaged_run_is_refused(tiny_run, tmp_path):
    with pytest.raises(LumitreeError, match=r"has no run\.npz"):
        load_field(tmp_path)
    content = (tiny_run / "run.npz").read_bytes()
    (tmp_path / "run.npz").write_bytes(content[:-50])
    with pytest.raises(LumitreeError, match="is damaged"):
        load_field(tmp_path)
    arrays = dict(np.load(tiny_run / "run.npz"))
    record = json.loads(str(arrays["fingerprint"]))
    for change in (
        {"state1": arrays["state1"][:1]},
        {"fingerprint": np.array(json.dumps(record | {"config": {"x" * 5000: 1}}))},
        {"fingerprint": np.array("{}")},
    ):
        np.savez(tmp_path / "run.npz", **arrays | change)
        with pytest.raises(LumitreeError, match=r"run\.npz is damaged") as refusal:
            load_field(tmp_path)
        assert str(refusal.value).isprintable()
        assert len(str(refusal.value)) < 1000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"law": "cubic"}, "law is 'cubic'; expected linear, exponential"),
        ({"opacity_kind": "alpha"}, "opacity_kind is 'alpha'"),
        ({"colour_loss": "l1"}, "colour_loss is 'l1'"),
        ({"emission_weights": "all"}, "emission_weights is 'all'"),
        ({"num_coarse": 0}, "num_coarse is 0; expected 1 to 4,096"),
        ({"width": 10**9}, "width is 1000000000; expected 1 to 4,096"),
        ({"width": 64.0}, r"width is 64\.0"),
        ({"l_max": 5}, "l_max is 5; expected 0 to 4"),
        ({"learning_rate_end": 1.0}, "do not decay"),
        ({"learning_rate_start": float("nan")}, "do not decay"),
    ],
)
def test_bad_settings_are_refused(change, message):
    with pytest.raises(LumitreeError, match=message):
        TrainConfig(**change)


def test_settings_do_not_load_jax():
    code = "import lumitree.fit.network.config, sys; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
