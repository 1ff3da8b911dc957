"""A tuber that reaches into the band a stereo camera cannot see is cut there, though no border of the image cuts it."""

from __future__ import annotations

import numpy as np

from segmenter.frame.edges import cut_by_unseen


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
