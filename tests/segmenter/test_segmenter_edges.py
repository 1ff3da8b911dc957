"""A tuber that reaches into the band a stereo camera cannot see is cut there, though no border of the image cuts it."""

from __future__ import annotations

import numpy as np

from segmenter.frame.edges import cut_by_unseen
from segmenter.track.tracker import label_at


def test_a_label_at_the_end_of_what_was_seen_is_cut_on_that_side_only() -> None:
    seen = np.ones((20, 30), np.uint8)
    seen[:, :4] = 0
    labels = np.zeros((20, 30), np.int32)
    labels[5:12, 4:9] = 1
    labels[5:12, 12:17] = 2
    touching = cut_by_unseen(labels, 2, seen, 1)
    assert touching[1].tolist() == [0, 0, 7, 0]
    assert touching[2].tolist() == [0, 0, 0, 0]


def test_a_wholly_seen_image_ends_at_its_borders() -> None:
    labels = np.zeros((20, 30), np.int32)
    labels[:3, 10:15] = 1
    labels[16:, 27:] = 2
    touching = cut_by_unseen(labels, 2, np.ones((20, 30), np.uint8), 0)
    assert touching[1].tolist() == [5, 0, 0, 0]
    assert touching[2].tolist() == [0, 3, 0, 4]


def test_a_pixel_lies_in_its_own_cell() -> None:
    """Of two pixels a cell every fourth was taken for the next cell's: bare belt was looked for half a cell aside."""
    labels = np.arange(1, 61, dtype=np.int32).reshape(6, 10)
    for stride in (1, 2, 3, 4):
        found = [[label_at(labels, u, v, stride) for u in range(10 * stride)] for v in range(6 * stride)]
        assert np.array_equal(found, np.kron(labels, np.ones((stride, stride), np.int32)))
        assert label_at(labels, -1.0, 0.0, stride) == label_at(labels, 10.0 * stride, 0.0, stride) == 0
