"""Tuber instances by the network alone: its tuber cells vote for their tuber's centre, and each peak is a tuber."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segmenter.classes import BELT, OTHER, REACH, TUBER, ClassMap
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.flood import regrow
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances, SplitSettings, described

VOTE_SIGMA = 1.3
APART = 5
"""Output cells (4 mm) between two peaks at least; odd."""
LEAST_PEAK = 0.35
"""Smoothed votes per cell that make a peak."""
FARTHEST = 15.0
REGROW_MM = 4.0


def split_by_classes(classes: ClassMap, heights: HeightMap, belt: BeltGeometry, settings: SplitSettings) -> Instances:
    """The instances of one frame, as `segmenter.frame.instances.split` gives them."""
    coarse, n = _voted(classes.answer)
    rows, columns = heights.height_mm.shape
    i = np.minimum(((np.arange(rows) + 0.5) * classes.scale[0]).astype(int), coarse.shape[0] - 1)
    j = np.minimum(((np.arange(columns) + 0.5) * classes.scale[1]).astype(int), coarse.shape[1] - 1)
    labels = np.ascontiguousarray(coarse[i[:, None], j[None, :]])
    labels[heights.height_mm <= settings.rim_mm] = 0
    regrow(labels, heights.height_mm, settings.rim_mm, max(1, round(REGROW_MM / heights.cell_mm)))
    return described(labels, n, heights, belt, settings)


def _voted(answer: NDArray[np.float32]) -> tuple[NDArray[np.int32], int]:
    """((h, w) int32 labels 1..n on the network's grid, n)."""
    tuber = (answer[TUBER] > answer[OTHER]) & (answer[TUBER] > answer[BELT])
    labels = np.zeros(tuber.shape, np.int32)
    rows, columns = np.nonzero(tuber)
    if not len(rows):
        return labels, 0
    towards = np.stack([rows, columns], axis=1) + REACH * answer[3:, rows, columns].T
    at = np.clip(np.round(towards).astype(int), 0, np.array(tuber.shape) - 1)
    votes = np.zeros(tuber.shape, np.float32)
    np.add.at(votes, (at[:, 0], at[:, 1]), 1.0)
    votes = np.asarray(cv2.GaussianBlur(votes, (0, 0), VOTE_SIGMA, borderType=cv2.BORDER_CONSTANT), np.float32)
    highest = cv2.dilate(votes, np.ones((APART, APART), np.uint8))
    peaks = np.argwhere((votes >= highest) & (votes > LEAST_PEAK))
    if not len(peaks):
        return labels, 0
    away, nearest = cKDTree(peaks).query(towards)
    labels[rows, columns] = np.where(away <= FARTHEST, nearest + 1, 0)
    return labels, len(peaks)
