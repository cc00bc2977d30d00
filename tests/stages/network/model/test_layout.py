"""Layouts are torch's own functions in another order of memory: the same values."""

import pytest
import torch
import torch.nn.functional as F

from posegaussian.stages.network.model.layout import shuffled, stacked, unshuffled

torch.set_num_threads(1)


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("cell", [2, 8])
def test_pixels_go_to_channels_and_back_as_torch_has_them(cell: int) -> None:
    maps = random(2, 3, 16, 24)
    found = unshuffled(maps, cell)
    assert torch.equal(found, F.pixel_unshuffle(maps, cell))
    assert found.is_contiguous(memory_format=torch.channels_last)
    back = shuffled(found, cell)
    assert torch.equal(back, maps)
    assert back.is_contiguous()


def test_maps_are_stacked_channels_last_whatever_order_they_came_in() -> None:
    parts = random(2, 4, 6, 5), random(2, 1, 6, 5), random(2, 3, 6, 5).contiguous(memory_format=torch.channels_last)
    found = stacked(*parts)
    assert torch.equal(found, torch.cat(parts, dim=1))
    assert found.is_contiguous(memory_format=torch.channels_last)
    assert stacked(parts[0].bfloat16(), parts[1]).dtype == torch.bfloat16
