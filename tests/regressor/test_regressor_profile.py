"""How a surface falls: the profile of bodies whose profile is known, and what holds for any."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from regressor.weigh.prepare import prepare_view
from regressor.weigh.profile import COUNT, PROFILE_NAMES, RINGS, SECTIONS, rim_profile
from regressor.weigh.surface import FIRST_NAMES, NAMES
from tests.regressor.ellipsoids import ellipsoid_view

STEP_M = 0.0005


def _profile(heights: np.ndarray, inside: np.ndarray) -> dict[str, float]:
    """Of heights (h, w) over a level grid of half millimetres, by name."""
    v, u = np.nonzero(inside)
    level = np.stack([u * STEP_M, v * STEP_M, 0.4 - heights[v, u]], axis=1)
    found = rim_profile(
        level,
        np.full(len(v), STEP_M**2),
        inside,
        heights=heights[v, u],
        height_m=float(heights[v, u].max()),
    )
    assert found.shape == (COUNT,)
    return dict(zip(PROFILE_NAMES, found.tolist(), strict=True))


def _disc(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(r (h, w) metres from the middle, inside (h, w))."""
    half = int(radius_m / STEP_M) + 3
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    r = np.hypot(u, v) * STEP_M
    return r, r <= radius_m


def test_a_cone_falls_in_a_straight_line() -> None:
    """Over a disc of 30 mm radius, 40 mm high in the middle, 10 mm at the rim."""
    r, inside = _disc(0.030)
    found = _profile(0.040 - r, inside)
    assert found["inradius_mm"] == pytest.approx(30, abs=0.7)
    assert found["major_mm"] == pytest.approx(30, rel=0.01)
    assert found["minor_mm"] == pytest.approx(30, rel=0.01)
    ends = (0.0, *RINGS, 1.0)
    for n, (outer, inner) in enumerate(pairwise(ends), start=1):
        far = (1 - outer, 1 - inner)
        mean_r = 2 / 3 * 0.030 * (far[0] ** 3 - far[1] ** 3) / (far[0] ** 2 - far[1] ** 2)
        assert found[f"ring{n}"] == pytest.approx((0.040 - mean_r) / 0.040, abs=0.02), n
    for share, name in zip(SECTIONS, ("area60_cm2", "area78_cm2", "area93_cm2"), strict=True):
        assert found[name] == pytest.approx(1e4 * np.pi * (0.040 * (1 - share)) ** 2, rel=0.05)
    assert found["sloping"] == pytest.approx(0, abs=1e-9)
    assert found["saddle"] == pytest.approx(0, abs=1e-9)


def test_a_box_stays_high_and_a_wedge_slopes() -> None:
    inside = np.pad(np.ones((60, 100), np.bool_), 2)
    flat = _profile(np.where(inside, 0.030, 0.0), inside)
    assert [flat[f"ring{n}"] for n in range(1, 7)] == pytest.approx([1.0] * 6)
    assert [flat[f"uneven{n}"] for n in range(1, 4)] == pytest.approx([0.0] * 3, abs=1e-6)
    assert flat["cap_ml"] == pytest.approx(0, abs=1e-9)
    assert flat["area93_cm2"] == pytest.approx(1e4 * 60 * 100 * STEP_M**2)
    assert flat["major_mm"] / flat["minor_mm"] == pytest.approx(100 / 60, rel=1e-3)
    along = np.arange(inside.shape[1]) / inside.shape[1]
    wedge = _profile(np.where(inside, 0.030 * (0.5 + 0.5 * along), 0.0), inside)
    assert wedge["sloping"] > 0.08
    assert wedge["uneven1"] > 0.1
    assert wedge["ring6"] < 0.9


def test_what_does_not_change_when_a_body_is_turned_or_grows() -> None:
    r, inside = _disc(0.030)
    v, u = np.mgrid[: r.shape[0], : r.shape[1]] - r.shape[0] // 2
    heights = np.where(inside, 0.04 - r + 0.003 * np.cos(0.4 * u) + 0.1 * STEP_M * v, 0.0)
    first, turned = _profile(heights, inside), _profile(np.rot90(heights).copy(), np.rot90(inside).copy())
    for name in PROFILE_NAMES:
        assert turned[name] == pytest.approx(first[name], rel=1e-6, abs=1e-9), name
    grown = _profile(2 * heights, inside)
    for name in PROFILE_NAMES:
        expected = first[name] * (2 if name == "cap_ml" else 1)
        assert grown[name] == pytest.approx(expected, rel=1e-6, abs=1e-9), name


def test_a_view_has_all_features_and_those_of_before_come_first() -> None:
    """A full body of the same outline and height stays higher at its rim than a slim one."""
    surface = prepare_view(ellipsoid_view()).surface
    assert surface.as_array().shape == (len(NAMES),) == (35,)
    assert np.isfinite(surface.as_array()).all()
    assert NAMES[: len(FIRST_NAMES)] == FIRST_NAMES
    assert tuple(surface.as_array()[: len(FIRST_NAMES)]) == tuple(getattr(surface, name) for name in FIRST_NAMES)
    tiny = np.pad(np.ones((6, 6), np.bool_), 1)
    assert np.isfinite(list(_profile(np.where(tiny, 0.01, 0.0), tiny).values())).all(), "rings narrower than a pixel"
