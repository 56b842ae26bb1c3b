"""The training loop with real steps of tiny networks: repeatable, resumable, measured without being disturbed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from airline.errors import ConfigError, InputError
from airline.network.spec import SPECS, UNetSpec
from airline.network.unet import UNet
from airline.network.weights import load_unet, save_unet
from airline.stages.edges import UNetEdges
from airline.training import session as checkpoint
from airline.training.crops import Crops
from airline.training.dataset import Sample
from airline.training.loop import Schedule, State, Validation, edge_loss, find_device, split, train
from tests.helpers.pictures import labelled, picture

SMALL = UNetSpec((8, 16, 32))
SETTINGS = {"--steps": 6, "--minutes": None, "--seed": 0}
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return [labelled(seed) for seed in range(3)]


def fresh(seed: int = 0, spec: UNetSpec = SMALL) -> State:
    torch.manual_seed(seed)
    return State(UNet(spec, norm=True), CPU)


def small(samples, seed=1, **more) -> Crops:
    return Crops(samples, seed, batch=2, size=64, **more)


def run(state, samples, steps, after=lambda loss: False, seed=1) -> State:
    train(state, small(samples, seed), Schedule(steps, warmup=2), after)
    return state


def same(a: State, b: State) -> bool:
    """Same weights, batch-norm statistics and optimiser moments, to the last bit."""
    moments = [[row[key] for row in s.optimiser.state.values() for key in ("exp_avg", "exp_avg_sq")] for s in (a, b)]
    tensors = [[*s.net.state_dict().values(), *rows] for s, rows in zip((a, b), moments, strict=True)]
    return all(torch.equal(one, other) for one, other in zip(*tensors, strict=True))


def test_a_few_steps_lower_the_loss_and_repeat_exactly(samples):
    image, target, weights = small(samples, 9).at(9)
    before = edge_loss(fresh().net.eval()(image), target, weights).item()
    first, second = run(fresh(), samples, 60), run(fresh(), samples, 60)
    assert same(first, second), "the same seed gives the same weights"
    assert edge_loss(first.net.eval()(image), target, weights).item() < 0.85 * before
    assert not same(run(fresh(), samples, 3, seed=1), run(fresh(), samples, 3, seed=2))


def test_threads_that_make_batches_change_nothing(samples):
    crops = small(samples, 3)
    for first, workers in ((0, 1), (0, 4), (5, 4)):
        ahead = crops.ahead(first, workers)
        for step in range(first, first + 6):
            assert all(torch.equal(a, b) for a, b in zip(next(ahead), crops.at(step), strict=True))
        ahead.close()


def test_learning_rate_follows_the_steps_or_the_clock():
    steps, clock = Schedule(1000, warmup=100), Schedule(minutes=10, warmup=100)
    for schedule in (steps, clock):
        assert schedule.rate(0, 0) == pytest.approx(2e-5)
        assert schedule.rate(99, 0) == pytest.approx(2e-3)
    assert steps.rate(100, 1e9) == pytest.approx(2e-3), "whatever the clock says"
    assert steps.rate(550, 0) == clock.rate(5000, 300) == pytest.approx(0.505 * 2e-3)
    assert steps.rate(1000, 0) == clock.rate(5000, 600) == clock.rate(5000, 700) == pytest.approx(2e-5)
    assert steps.done(250, 1e9) == clock.done(10**9, 150) == 0.25


@pytest.mark.parametrize("stop", [1, 6])
def test_a_stopped_training_goes_on_as_if_nothing_had_happened(samples, tmp_path, stop):
    stopped, resumed = fresh(), fresh(seed=5)  # what it starts from must not matter
    run(stopped, samples, 6, lambda loss: stopped.step == stop)
    checkpoint.save(stopped, SETTINGS, stop == 6, tmp_path / "state")
    checkpoint.restore(resumed, SETTINGS, tmp_path / "state")
    assert (resumed.step, resumed.seconds) == (stop, stopped.seconds)
    assert same(run(resumed, samples, 6), run(fresh(), samples, 6))


def test_the_clock_ends_a_training_and_goes_on_where_it_was(samples):
    schedule, crops, state = Schedule(minutes=0.3 / 60), small(samples), fresh()
    train(state, crops, schedule, lambda loss: state.step == 1)
    assert 0 < state.seconds < 0.3
    train(state, crops, schedule)
    steps = state.step
    assert steps > 1
    assert state.seconds >= 0.3
    train(state, crops, schedule)
    assert state.step == steps, "the time is up"


@pytest.mark.parametrize(
    ("name", "value", "finished"),
    [("--steps", 4, False), ("--steps", 8, False), ("--seed", 1, False), ("--steps", 5, True), ("--seed", 1, True)],
)
def test_a_checkpoint_of_other_settings_is_refused(samples, tmp_path, name, value, finished):
    checkpoint.save(run(fresh(), samples, 1), SETTINGS, finished, tmp_path / "state")
    state = fresh()
    with pytest.raises(InputError, match=f"other settings .*{name} was {SETTINGS[name]} and is {value}"):
        checkpoint.restore(state, {**SETTINGS, name: value}, tmp_path / "state")
    assert same(state, fresh()), "a refused checkpoint leaves no trace"
    with pytest.raises(InputError, match="no checkpoint of this training"):
        checkpoint.restore(fresh(spec=UNetSpec((8, 16))), SETTINGS, tmp_path / "state")


def test_a_damaged_checkpoint_is_a_clear_error(samples, tmp_path):
    path = tmp_path / "state"
    checkpoint.save(run(fresh(), samples, 1), SETTINGS, False, path)
    whole = path.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 0xFF]) + whole[half + 1 :]
    for damaged in (b"", b"no checkpoint", whole[:half], whole[:-5], flipped):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged"):
            checkpoint.restore(fresh(), SETTINGS, path)
    for content, reason in (([1, 2], "damaged"), ({"net": {}}, "no checkpoint of this training")):
        torch.save(content, path)
        with pytest.raises(InputError, match=reason):
            checkpoint.restore(fresh(), SETTINGS, path)
    with pytest.raises(InputError, match="cannot write"):
        checkpoint.save(fresh(), SETTINGS, False, tmp_path / "nowhere" / "state")


def test_a_loss_that_is_no_number_stops_the_training(samples):
    with pytest.raises(ConfigError, match="loss is nan at step 1"):
        train(fresh(), small(samples, weight=float("nan")), Schedule(5))


@pytest.mark.parametrize(("count", "held_out"), [(2, 1), (39, 1), (40, 2), (1200, 60), (3000, 60)])
def test_split_holds_out_a_twentieth_and_at_most_sixty(count, held_out):
    numbered = list(range(count))
    assert split(numbered) == (numbered[:held_out], numbered[held_out:])


def test_validation_scores_a_trained_network_and_disturbs_nothing(samples, tmp_path):
    validation = Validation({"photographs": samples[:2], "scenes": samples[2:], "none": []}, small(samples))
    scores = validation.measure(load_unet("default"), CPU)
    assert set(scores) == {"photographs", "scenes"}
    assert scores["photographs"][1].f2 > 70
    untrained = fresh()
    blank = validation.measure(untrained.net, CPU)
    assert blank["photographs"][1].f2 < scores["photographs"][1].f2 - 20
    assert blank["photographs"][0] > scores["photographs"][0]

    def watched(loss: float) -> bool:
        validation.measure(untrained.net, CPU)
        return False

    assert same(run(untrained, samples, 3, watched), run(fresh(), samples, 3))


def test_sheets_show_image_labels_edges_and_lines(tmp_path):
    wide = labelled(4, 200, 100)
    validation = Validation({"photographs": [wide]}, small([wide]))
    validation.write_sheet(load_unet("default"), CPU, tmp_path / "sheet.png")
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet.shape == (204, 4 * 404, 3)
    image, labels, edges, lines = (sheet[:200, 404 * k : 404 * k + 400].astype(float) for k in range(4))
    assert np.corrcoef(cv2.resize(wide.gray, (400, 200)).ravel(), image[..., 0].ravel())[0, 1] > 0.99
    assert np.corrcoef(labels[..., 0].ravel(), edges[..., 0].ravel())[0, 1] > 0.5
    coloured = np.ptp(lines, axis=2) > 60
    assert labels[coloured].mean() > 4 * labels[~coloured].mean()
    with pytest.raises(InputError, match="cannot write"):
        validation.write_sheet(load_unet("default"), CPU, tmp_path / "nowhere" / "sheet.png")


def test_the_network_is_measured_as_it_will_be_used(tmp_path):
    state = fresh()
    save_unet(state.net, tmp_path / "net.safetensors")
    gray = picture(3, 151, 97)  # no multiple of the stride
    logits = state.net.folded().answer(torch.from_numpy(gray[None, None].astype(np.float32)))
    used = UNetEdges(tmp_path / "net.safetensors", "cpu").detect(gray)
    assert np.abs(torch.sigmoid(logits)[0, 0].detach().numpy() - used).max() < 1e-5


def test_named_networks_have_the_sizes_they_are_known_by():
    thousands = {name: sum(p.numel() for p in UNet(spec).parameters()) / 1e3 for name, spec in SPECS.items()}
    assert thousands == pytest.approx({"default": 121.2, "fast": 39.5, "accurate": 194.0, "paper": 25_808}, rel=0.01)
    assert all(256 % spec.stride == 0 for spec in SPECS.values()), "crops fit"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_training_and_validation_on_cuda(samples, tmp_path):
    torch.manual_seed(0)
    state = State(UNet(SMALL, norm=True), find_device("cuda"))
    run(state, samples, 3)
    checkpoint.save(state, SETTINGS, False, tmp_path / "state")
    resumed = fresh()
    checkpoint.restore(resumed, SETTINGS, tmp_path / "state")
    assert run(resumed, samples, 4).step == 4
    validation = Validation({"photographs": samples}, small(samples))
    assert validation.measure(state.net, state.device)["photographs"][0] > 0
