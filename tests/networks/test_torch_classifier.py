"""TorchClassifier: modules, scripts, exported programs and functions."""

import numpy as np
import pytest
import torch
from made import random_events

from async_tnt import Processor, TNTConfig
from async_tnt.networks import TorchClassifier

VOLUME = np.random.default_rng(0).normal(size=(2, 6, 5)).astype(np.float32)
VOLUME.flags.writeable = False


@pytest.fixture(autouse=True)
def _one_thread():
    yield
    torch.set_num_threads(1)


def module(*layers):
    torch.manual_seed(0)
    return torch.nn.Sequential(*layers, torch.nn.Flatten(), torch.nn.Linear(60, 3))


def expected(net):
    with torch.no_grad():
        return net(torch.tensor(VOLUME)[None])[0].numpy()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_batch_of_one_goes_in_and_numpy_comes_out():
    net = module(torch.nn.ReLU(), torch.nn.Dropout(0.5)).eval()
    program = torch.export.export(net, (torch.zeros(1, 2, 6, 5),))
    scripted = torch.jit.trace(net, torch.zeros(1, 2, 6, 5))
    for other in (net, scripted, program, program.module(), lambda volume: net(volume)[0]):
        for volume in (VOLUME, VOLUME.astype(np.float64), np.asfortranarray(VOLUME)):
            logits = TorchClassifier(other)(volume)
            assert type(logits) is np.ndarray and logits.dtype == np.float32 and logits.shape == (3,)
            assert logits.flags.writeable and logits.base is None
            assert np.allclose(logits, expected(net), atol=1e-6)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_bare_module_as_a_classifier_says_how_it_is_passed():
    """One that takes arrays is fine as it is."""

    class OfArrays(torch.nn.Module):
        def forward(self, volume):
            return net(torch.tensor(volume)[None]).detach()

    net, config = module(), TNTConfig(sensor=(5, 6), grid=(5, 6), bins=2)
    for bare in (net, torch.jit.trace(net, torch.zeros(1, 2, 6, 5))):
        with pytest.raises(
            TypeError, match=r"a torch module is wrapped, TorchClassifier\(module\), or compiled"
        ) as raised:
            Processor(config, classifier=bare).fire()
        assert raised.value.__cause__ is not None and "\n" not in str(raised.value)
    assert Processor(config, classifier=OfArrays()).fire().logits.shape == (3,)


def test_eval_and_inference_mode_and_the_modules_own_type():
    halved = TorchClassifier(module().double())(VOLUME)
    assert halved.dtype == np.float32 and np.allclose(halved, expected(module()), atol=1e-6)
    seen = []

    class Watching(torch.nn.Module):
        def forward(self, volume):
            seen.append((self.training, torch.is_inference_mode_enabled(), tuple(volume.shape), volume.dtype))
            return volume.sum().reshape(1, 1)

    net = torch.nn.Sequential(Watching(), torch.nn.Dropout(0.9)).train()
    assert np.isclose(TorchClassifier(net)(VOLUME), VOLUME.sum(), atol=1e-4).all()
    assert seen == [(False, True, (1, 2, 6, 5), torch.float32)] and not net.training
    assert not torch.is_inference_mode_enabled()


def test_a_module_that_works_in_place_or_keeps_its_input_does_not_touch_the_window():
    kept = []

    def greedy(volume):
        kept.append(volume)
        return volume.mul_(-1).flatten(1)[:, :3]

    config = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=2, window_us=1000, landmark="center", t_max=1.0)
    processor = Processor(config, classifier=TorchClassifier(greedy))
    processor.push(random_events(300, sensor=(5, 6), duration_us=900))
    before = processor.volume().copy()
    processor.fire()
    assert before.any() and np.array_equal(processor.volume(), before)
    first = kept[0].clone()
    processor.push(random_events(300, sensor=(5, 6), duration_us=900, start_us=90, seed=1))
    processor.fire()
    assert torch.equal(kept[0], first) and not torch.equal(kept[1], first)


@pytest.mark.parametrize(
    "answer, error, message",
    [
        (lambda v: v, ValueError, r"must return logits \(1, n_classes\), got shape \(1, 2, 6, 5\)"),
        (lambda v: (v.flatten(1), 1), TypeError, "must return a tensor of logits, got tuple"),
    ],
)
def test_wrong_answers_and_settings(answer, error, message):
    with pytest.raises(error, match=f"^the module {message}$"):
        TorchClassifier(answer)(VOLUME)
    with pytest.raises(ValueError, match=r"^`threads` must be at least 1, got 0$"):
        TorchClassifier(len, threads=0)
    with pytest.raises(TypeError, match=r"^`module` must be callable, got int$"):
        TorchClassifier(5)
