import math

import numpy as np
import pytest

from training import network as module
from training.network import Adam, Network


def double(sizes, seed=0):
    """A network in double precision, with biases, all weights being of one size."""
    random = np.random.default_rng(seed)
    network = Network.random(sizes, random)
    return Network([random.normal(0, 0.5, part.shape) for part in network.weights])


class SquaredError:
    """Half the mean squared error, by the outputs; keeps the loss of the last call."""

    def __init__(self, target):
        self.target = target
        self.loss = math.nan

    def __call__(self, outputs):
        error = outputs - self.target
        self.loss = 0.5 * (error**2).sum() / len(error)
        return error / len(error)


@pytest.mark.parametrize("hidden", [(), (5,), (6, 4), (5, 4, 3)])
@pytest.mark.parametrize("dropout", [0.0, 0.3])
def test_gradients_are_finite_differences(hidden, dropout):
    random = np.random.default_rng(1)
    network = double((3, *hidden, 2))
    x = random.normal(size=(20, 3))
    loss = SquaredError(random.normal(size=(20, 2)))

    def run():  # leaves the same units out each time
        return network.gradients(x, loss, dropout, np.random.default_rng(2))

    step = 1e-5
    for part, gradient in zip(network.weights, run(), strict=True):
        assert gradient.shape == part.shape
        for index in np.ndindex(part.shape):
            kept = part[index]
            losses = []
            for change in (step, -step):
                part[index] = kept + change
                run()
                losses.append(loss.loss)
            part[index] = kept
            found = (losses[0] - losses[1]) / (2 * step)
            assert gradient[index] == pytest.approx(found, abs=1e-7, rel=1e-5)


def test_units_are_sigmoid_weighted():
    network = double((3, 5, 4, 2))
    x = np.random.default_rng(1).normal(size=(7, 3))
    units = x
    for matrix, bias in ((network.weights[0], network.weights[1]), tuple(network.weights[2:4])):
        a = units @ matrix + bias
        units = a / (1 + np.exp(-a))
    np.testing.assert_allclose(network.hidden(x), units, atol=1e-12)
    outputs = units @ network.weights[4] + network.weights[5]
    np.testing.assert_allclose(network.outputs(x), outputs, atol=1e-12)


def test_large_sums_do_not_overflow():
    network = Network([np.float32([[1e4, -1e4]]), np.zeros(2, np.float32), np.ones((2, 1)), [0.0]])
    assert network.outputs(np.float32([[1.0]]))[0, 0] == pytest.approx(1e4)


def test_what_dropout_leaves_out_the_rest_makes_up_for():
    """With one hidden layer the mean over the units left out is what the whole network says."""
    network = double((3, 40, 2))
    x = np.random.default_rng(1).normal(size=(4, 3))
    seen = []

    def keep(outputs):
        seen.append(outputs.copy())
        return outputs

    random = np.random.default_rng(2)
    for _ in range(4000):
        network.gradients(x, keep, 0.25, random)
    spread = np.std(seen, axis=0)
    assert (spread > 0.05).all()
    bound = 4 * spread.max() / math.sqrt(len(seen))
    np.testing.assert_allclose(np.mean(seen, axis=0), network.outputs(x), atol=bound)
    seen.clear()
    network.gradients(x, keep, 0.0, random)
    np.testing.assert_allclose(seen[0], network.outputs(x), atol=1e-12)


def test_adam_is_the_published_update():
    """Kingma and Ba, algorithm 1, in double precision; the rate rises, then falls to nothing."""
    random = np.random.default_rng(0)
    steps, highest = 400, 0.01
    weights = [random.normal(size=(4, 3)).astype(np.float32), np.zeros(3, np.float32)]
    expected = [part.astype(float) for part in weights]
    start = [part.copy() for part in weights]
    mean = [np.zeros_like(part) for part in expected]
    square = [np.zeros_like(part) for part in expected]
    first, second = module._BETA
    optimiser = Adam(weights, steps, highest)
    for done in range(1, steps + 1):
        # Of very different sizes, as gradients are.
        gradients = [random.normal(1, 3, part.shape) * 10 ** random.uniform(-3, 2) for part in mean]
        rate = highest * min(1, done / module._WARM_UP)
        rate *= (1 + math.cos(math.pi * (done - 1) / steps)) / 2
        for part, gradient, m, v in zip(expected, gradients, mean, square, strict=True):
            m[:] = first * m + (1 - first) * gradient
            v[:] = second * v + (1 - second) * gradient**2
            corrected = m / (1 - first**done), v / (1 - second**done)
            part -= rate * corrected[0] / (np.sqrt(corrected[1]) + 1e-8)
        optimiser.step([gradient.astype(np.float32) for gradient in gradients])
        for part, exact in zip(weights, expected, strict=True):
            np.testing.assert_allclose(part, exact, atol=2e-5)
    assert all(part.dtype == np.float32 for part in weights)
    assert max(abs(a - b).max() for a, b in zip(weights, start, strict=True)) > 0.1
    before = [part.copy() for part in weights]
    optimiser.step([np.ones_like(part) for part in weights])  # one more than asked for
    for part, same in zip(weights, before, strict=True):
        np.testing.assert_allclose(part, same, atol=1e-7)


def test_a_network_learns_a_known_function():
    random = np.random.default_rng(0)

    def sample(count):
        x = random.uniform(-1, 1, (count, 2)).astype(np.float32)
        return x, np.column_stack([np.sin(3 * x[:, 0]) * x[:, 1], x[:, 0] ** 2]).astype(np.float32)

    network = Network.random((2, 32, 32, 2), random)
    optimiser = Adam(network.weights, 1500, 5e-3)
    test, truth = sample(1000)
    before = network.outputs(test)
    for _ in range(1500):
        x, y = sample(128)
        optimiser.step(network.gradients(x, SquaredError(y), 0.0, random))
    found = network.outputs(test)
    assert found.dtype == np.float32
    assert ((before - truth) ** 2).mean() > 0.5 * truth.var(axis=0).mean()
    assert ((found - truth) ** 2).mean() < 0.005 * truth.var(axis=0).mean()
