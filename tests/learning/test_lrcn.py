"""The network is that of the paper's Table 1, and computes what it says."""

import math

import numpy as np
import pytest
import torch
from support import synthetic_videos
from torch import nn

from slipstitch.config.train import TrainSettings
from slipstitch.learning.lrcn import LRCN, class_probabilities
from slipstitch.learning.prediction import chance_loss
from slipstitch.learning.torch_setup import computes_bfloat16

torch.set_num_threads(1)  # threads that wait for one another: 20 times slower on a busy machine


def network(pixels=16, classes=4, condition_classes=0, **changes):
    torch.manual_seed(0)
    return LRCN(TrainSettings(**changes), classes, pixels, condition_classes)


def without_dropout(net):
    net.fully_connected[2].p = 0.0
    return net


def frames(videos=2, count=5, pixels=16):
    torch.manual_seed(1)
    return torch.randint(0, 256, (videos, count, pixels, pixels, 3), dtype=torch.uint8)


# Table 1 at 224 pixels, borders padded: a row a layer that has weights or pools, with its output.
POOLINGS = (2, 5, 7)  # the others are conv1a, conv1b, conv2a, conv2b, conv3a, conv4a
CHANNELS = (64, 64, 64, 128, 128, 128, 256, 256, 512)
SIDES = (224, 224, 112, 112, 112, 56, 56, 28, 28)


def full_width():
    """The network at full width and 224 pixels with 16 coefficients and 10 fabrics: shapes only."""
    with torch.device("meta"):
        return LRCN(TrainSettings(width=1.0, initialisation="pytorch"), 16, 224, 10)


def test_its_convolutions_and_poolings_are_those_of_table_1():
    net, found = full_width(), []
    kinds = nn.Conv2d | nn.MaxPool2d
    layers = [layer for layer in net.convolutions.modules() if isinstance(layer, kinds)]
    for layer in layers:
        layer.register_forward_hook(lambda layer, inputs, output: found.append(output.shape[1:]))
    net.convolutions(torch.zeros(1, 3, 224, 224, device="meta"))
    assert found == list(zip(CHANNELS, SIDES, SIDES, strict=True))
    for number, layer in enumerate(layers):
        pools = number in POOLINGS
        assert isinstance(layer, nn.MaxPool2d if pools else nn.Conv2d), number
        size = (layer.kernel_size, layer.stride)
        assert size == ((3, 2) if pools else ((3, 3), (1, 1))), number
    rectifiers = [layer for layer in net.convolutions.modules() if isinstance(layer, nn.ReLU)]
    assert len(rectifiers) == 6


def test_two_lstm_layers_then_two_fully_connected_ones_with_dropout_between_only():
    net = full_width()
    assert net.lstm.num_layers == 2 and net.lstm.hidden_size == 256 and net.lstm.dropout == 0
    kinds = [type(layer) for layer in net.fully_connected]
    assert kinds == [nn.Linear, nn.ReLU, nn.Dropout, nn.Linear]
    assert sum(isinstance(layer, nn.Dropout) for layer in net.modules()) == 1


def test_the_material_goes_through_a_softmax_layer_of_its_own_beside_every_frame():
    net = network(condition_classes=3).eval()
    seen = []
    net.lstm.register_forward_pre_hook(lambda lstm, inputs: seen.append(inputs[0]))
    net(frames(), torch.tensor([0, 2]))
    told = seen[0][..., :3]
    assert torch.equal(told, told[:, :1].expand_as(told))  # the same for every frame
    assert torch.allclose(told.sum(-1), torch.ones(2, 5)) and told.min() > 0
    assert not torch.allclose(told[0], told[1])
    assert [type(layer) for layer in net.material] == [nn.Linear, nn.Softmax]
    assert full_width().material[0].out_features == 10  # as many as fabrics, by default


def test_at_full_width_and_224_pixels_it_has_the_papers_weights_and_cost():
    convolutions = 9 * (3 * 64 + 64 * 64 + 64 * 128 + 128 * 128 + 128 * 256 + 256 * 512)
    channels = 64 + 64 + 128 + 128 + 256 + 512
    heads = (10 * 10 + 10) + (256 * 256 + 256) + (256 * 16 + 16)

    def lstm(inputs):
        return 4 * 256 * (inputs + 256 + 2) + 4 * 256 * (256 + 256 + 2)

    def weights(net):
        return sum(weight.numel() for weight in net.parameters())

    # Of the batch normalisation two numbers a channel, and two a feature.
    net = full_width()
    assert weights(net) == convolutions + 2 * channels + 2 * 512 + lstm(512 + 10) + heads
    assert net.multiply_accumulates == pytest.approx(6.56e9, rel=5e-4)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"channels": [8, 16], "convolutions": [1, 1]},
        {"initialisation": "glorot"},
        {"initialisation": "pytorch"},
    ],
)
def test_every_size_and_initialisation_gives_probabilities(changes):
    probabilities = class_probabilities(network(**changes), frames().numpy())
    assert probabilities.shape == (2, 4) and probabilities.min() > 0
    assert probabilities.sum(1) == pytest.approx(1.0)


def test_the_answer_depends_on_frames_order_and_condition_and_on_no_neighbour_in_the_batch():
    net = network().eval()
    video = frames(3, count=8)
    assert not torch.allclose(net(video), net(video.flip(1)))
    assert torch.allclose(net(video)[1:2], net(video[1:2]), atol=1e-5)
    net, video = network(condition_classes=3).eval(), frames()
    first, second = (net(video, torch.tensor([0, other])) for other in (0, 2))
    assert torch.equal(first[0], second[0]) and not torch.allclose(first[1], second[1])


def test_chance_is_ln_k_for_equal_classes_and_less_for_unequal_ones():
    assert chance_loss([0, 1, 2, 3] * 5) == pytest.approx(math.log(4))
    assert chance_loss([0, 0, 0, 1]) == pytest.approx(0.5623351446)


def drawn_videos(videos: int) -> torch.Tensor:
    """Videos of 30 frames at 64 pixels, with noise."""
    drawn = [
        [synthetic_videos.draw(64, math.sin(0.42 * t), 0.1 * v, 0.5, v, 0) for t in range(30)]
        for v in range(videos)
    ]
    noise = np.random.default_rng(0).normal(0, 4, np.shape(drawn))
    return torch.from_numpy(np.clip(drawn + noise, 0, 255).astype(np.uint8))


def gradients_cosine(net: LRCN, video: torch.Tensor) -> float:
    """Cosine between the gradients in bfloat16 and in float32, over all weights."""
    gradients = []
    for bfloat16 in (False, True):
        net.zero_grad()
        nn.functional.cross_entropy(net(video, None, bfloat16), torch.arange(len(video))).backward()
        gradients.append(torch.cat([weight.grad.flatten() for weight in net.parameters()]))
    return torch.nn.functional.cosine_similarity(*gradients, dim=0).item()


def trained(net: LRCN, video: torch.Tensor, steps: int) -> LRCN:
    optimizer = torch.optim.Adadelta(net.parameters(), lr=1.0, rho=0.95)
    for _ in range(steps):
        optimizer.zero_grad()
        nn.functional.cross_entropy(net(video, None, True), torch.arange(len(video))).backward()
        optimizer.step()
    return net


needs_bfloat16 = pytest.mark.skipif(
    not computes_bfloat16("auto"), reason="needs a processor with AVX512-BF16"
)


@needs_bfloat16
@pytest.mark.parametrize(("videos", "steps"), [(2, 0), (4, 0), (2, 10)])
def test_gradients_in_bfloat16_agree_with_float32(videos, steps):
    video = drawn_videos(videos)
    net = without_dropout(network(64))
    net.mean.fill_(video.float().mean())
    net.deviation.fill_(video.float().std())
    assert gradients_cosine(trained(net, video, steps), video) >= 0.999


@needs_bfloat16
def test_answers_in_bfloat16_are_nearly_those_in_float32():
    video = drawn_videos(4)
    net = trained(without_dropout(network(64)), video, 10).eval()
    with torch.inference_mode():
        exact, rounded = (net(video, None, bfloat16).softmax(1) for bfloat16 in (False, True))
    assert (exact - rounded).abs().max() < 0.02


def test_auto_precision_follows_the_processor():
    assert computes_bfloat16("auto") == torch.cpu._is_avx512_bf16_supported()
    assert computes_bfloat16("bfloat16") and not computes_bfloat16("float32")
