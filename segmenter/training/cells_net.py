"""The network of cells: a small U-Net from heights to classes and centres, about 90 thousand parameters."""

from __future__ import annotations

import itertools

from torch import Tensor, nn

from segmenter.classes import CHANNELS
from segmenter.training.blocks import convolution

OPEN_AXES = {"image": {2: "rows", 3: "columns"}, "answer": {2: "rows_2", 3: "columns_2"}}
"""Any size of image."""


class BeltNet(nn.Module):
    """(B, 3, H, W) -> (B, 5, H/2, W/2), see `segmenter.classes`; H and W multiples of 32.

    The way up adds what the way down saw, after a 1x1 convolution: half the work of concatenating it.
    """

    def __init__(self, widths: tuple[int, ...] = (8, 16, 32, 64)) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(3, widths[0], 4, stride=2, padding=1),
            nn.BatchNorm2d(widths[0]),
            nn.ReLU(),
            *convolution(widths[0], widths[0]),
        )
        pairs = list(itertools.pairwise(widths))
        self.down = nn.ModuleList(nn.Sequential(*convolution(a, b, stride=2), *convolution(b, b)) for a, b in pairs)
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairs)
        self.up = nn.ModuleList(nn.Sequential(*convolution(a, a)) for a, _ in pairs)
        self.head = nn.Conv2d(widths[0], CHANNELS, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Logits and offsets."""
        seen = [self.stem(image)]
        for down in self.down:
            seen.append(down(seen[-1]))
        found = seen.pop()
        for narrow, up in zip(reversed(self.narrow), reversed(self.up), strict=True):
            found = up(nn.functional.interpolate(narrow(found), scale_factor=2.0, mode="nearest") + seen.pop())
        answer: Tensor = self.head(found)
        return answer
