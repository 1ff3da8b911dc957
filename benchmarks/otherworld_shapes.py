"""Bodies of the other world: tubers of several families, clods and stones, and how each lies on a flat belt.

Sizes and weights follow 421 measured tubers of 3DPotatoTwin (Sayaka, Kitahime, Corolle, MayQueen): ln L, ln W, ln D
(mm) and ln k (weight / (pi/6 L W D), g/ml) of each cultivar, and the measured densities. The shapes are our own: a
superellipsoid with spherical-harmonic bumps, knobs, a taper and a bend, whose exponent is solved so that the mesh has
the volume that the drawn k and density ask for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull
from scipy.special import sph_harm_y

VERTICES = 1200

# mean of ln L, ln W, ln D (mm), ln k (g/ml); covariance of the first three, upper triangle (LL LW LD WW WD DD);
# sd of ln k; density g/ml, mean and sd.
CULTIVARS: dict[str, tuple[tuple[float, ...], tuple[float, ...], float, tuple[float, float]]] = {
    "Sayaka": (
        (4.3176, 4.1307, 3.9462, 0.1617),
        (0.04673, 0.03046, 0.02452, 0.02606, 0.02052, 0.02089),
        0.0863,
        (1.074, 0.021),
    ),
    "Kitahime": (
        (4.2245, 4.1592, 4.0197, 0.2046),
        (0.02219, 0.01881, 0.01285, 0.01765, 0.01122, 0.01424),
        0.0566,
        (1.070, 0.010),
    ),
    "Corolle": (
        (4.4241, 3.8851, 3.7497, 0.1781),
        (0.03745, 0.02603, 0.02238, 0.02390, 0.02086, 0.02230),
        0.0708,
        (1.049, 0.012),
    ),
    "MayQueen": (
        (4.4928, 3.8703, 3.7272, 0.2093),
        (0.08759, 0.04914, 0.04759, 0.03471, 0.03288, 0.03742),
        0.0712,
        (1.062, 0.018),
    ),
}
# family: its cultivars, factor on all sizes, relative height of the bumps, knobs (at most), sd of the bend
FAMILIES: dict[str, tuple[tuple[str, ...], float, float, int, float]] = {
    "smooth": (("Sayaka", "Kitahime"), 1.0, 0.02, 0, 0.05),
    "bumpy": (("Sayaka", "Kitahime"), 1.0, 0.06, 0, 0.08),
    "knobby": (("Kitahime", "Sayaka"), 1.05, 0.04, 3, 0.10),
    "long": (("Corolle", "MayQueen"), 1.0, 0.03, 0, 0.18),
    "small": (("Sayaka", "MayQueen"), 0.62, 0.03, 0, 0.06),
}


@dataclass(frozen=True, slots=True)
class Body:
    """One body as it lies: vertices (N, 3) m in belt axes, centre of mass at x = y = 0, lowest point at z = 0."""

    vertices_m: np.ndarray
    triangles: np.ndarray
    volume_ml: float
    weight_g: float
    lwd_mm: tuple[float, float, float]
    kind: str

    @property
    def centre_z_m(self) -> float:
        return float(mass_centre(self.vertices_m, self.triangles)[1][2])


def sphere(count: int = VERTICES) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of evenly spread points: unit directions (count, 3) and outward triangles (M, 3)."""
    n = np.arange(count) + 0.5
    z = 1 - 2 * n / count
    turn = np.pi * (1 + 5**0.5) * n
    flat = np.sqrt(1 - z * z)
    unit = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1)
    return unit, outward(unit, ConvexHull(unit).simplices)


def outward(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles of a body around the origin, each turned so that its normal points outwards."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    turned = triangles.copy()
    turned[inward] = turned[inward][:, ::-1]
    return turned


def mass_centre(vertices: np.ndarray, triangles: np.ndarray) -> tuple[float, np.ndarray]:
    """Volume and centre of mass (3,) of a closed mesh, in the vertices' unit."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    parts = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume = float(parts.sum())
    return volume, ((a + b + c) * parts[:, None]).sum(0) / (4 * volume)


def bumps(unit: np.ndarray, rng: np.random.Generator, *, height: float, top: int) -> np.ndarray:
    """A random sum of real spherical harmonics of degree 2 to `top`, its rms `height`."""
    polar, turn = np.arccos(np.clip(unit[:, 2], -1, 1)), np.arctan2(unit[:, 1], unit[:, 0])
    field = np.zeros(len(unit))
    for degree in range(2, top + 1):
        for order in range(degree + 1):
            wave = sph_harm_y(degree, order, polar, turn)
            field += (rng.normal() * wave.real + rng.normal() * wave.imag) / degree
    return np.asarray(field * height / field.std())


def tuber(rng: np.random.Generator, family: str) -> Body:
    """A tuber of a family, lying at rest."""
    cultivars, factor, bump, knobs, bend_sd = FAMILIES[family]
    mean, upper, k_sd, density = CULTIVARS[cultivars[int(rng.integers(len(cultivars)))]]
    ll, lw, ld, ww, wd, dd = upper
    covariance = np.array([[ll, lw, ld], [lw, ww, wd], [ld, wd, dd]])
    lwd = np.zeros(3)
    while not 31_000 < np.prod(lwd) < 1_100_000:  # 16 to 620 g, the lightest and heaviest of the measured ones
        lwd = np.sort(np.exp(rng.multivariate_normal(mean[:3], covariance)) * factor)[::-1]
    g_per_ml = float(np.clip(rng.normal(*density), 1.02, 1.12))
    fullness = float(np.exp(mean[3] + rng.normal() * k_sd)) / g_per_ml

    unit, triangles = sphere()
    radial = 1 + bumps(unit, rng, height=bump, top=7)
    for _ in range(int(rng.integers(1, knobs + 1)) if knobs else 0):
        towards = rng.normal(size=3)
        cosine = unit @ (towards / np.linalg.norm(towards))
        radial *= 1 + rng.uniform(0.15, 0.45) * np.exp((cosine - 1) / rng.uniform(0.05, 0.15))
    taper, bend = rng.normal() * 0.08, rng.normal() * bend_sd

    def mesh(exponent: float) -> np.ndarray:
        super_radius = (np.abs(unit) ** exponent).sum(1) ** (-1 / exponent)
        points = unit * (super_radius * radial)[:, None]
        points[:, 1:] *= 1 + taper * points[:, :1]
        points[:, 2] += bend * points[:, 0] ** 2
        low, high = points.min(0), points.max(0)
        return np.asarray((points - (low + high) / 2) / (high - low) * lwd / 1000)

    wanted_m3 = fullness * np.pi / 6 * float(np.prod(lwd)) * 1e-9
    low, high = 1.6, 4.0
    for _ in range(18):
        middle = (low + high) / 2
        low, high = (middle, high) if mass_centre(mesh(middle), triangles)[0] < wanted_m3 else (low, middle)
    return at_rest(mesh((low + high) / 2), triangles, rng, g_per_ml=g_per_ml, kind=family)


def clod(rng: np.random.Generator) -> Body:
    """A clod of soil: a rough lump."""
    unit, triangles = sphere()
    radial = np.clip(1 + bumps(unit, rng, height=0.11, top=13), 0.5, None)
    size_m = rng.uniform(0.016, 0.034) * np.array([1.0, rng.uniform(0.7, 1), rng.uniform(0.55, 0.9)])
    return at_rest(unit * radial[:, None] * size_m, triangles, rng, g_per_ml=1.5, kind="clod")


def stone(rng: np.random.Generator) -> Body:
    """A broken stone: the sphere cut flat on several sides."""
    unit, triangles = sphere()
    radial = np.full(len(unit), 1.0)
    for _ in range(int(rng.integers(6, 11))):
        normal = rng.normal(size=3)
        cosine = unit @ (normal / np.linalg.norm(normal))
        cut = rng.uniform(0.55, 0.85)
        radial = np.where(cosine > 0, np.minimum(radial, cut / np.maximum(cosine, 1e-6)), radial)
    size_m = rng.uniform(0.018, 0.036) * np.array([1.0, rng.uniform(0.7, 1), rng.uniform(0.5, 0.8)])
    return at_rest(unit * radial[:, None] * size_m, triangles, rng, g_per_ml=2.6, kind="stone")


def at_rest(points: np.ndarray, triangles: np.ndarray, rng: np.random.Generator, *, g_per_ml: float, kind: str) -> Body:
    """The body as it comes to rest on a plane: it starts in any orientation and rolls over its hull's edges until its
    centre of mass stands above the facet it lies on. Turned about the vertical at random."""
    volume, centre = mass_centre(points, triangles)
    points = points - centre
    lwd = tuple(float(v) for v in np.sort(np.ptp(points, axis=0))[::-1] * 1000)
    hull = ConvexHull(points)
    normals, heights = hull.equations[:, :3], -hull.equations[:, 3]
    start = rng.normal(size=3)
    facet = int(np.argmax(normals @ (start / np.linalg.norm(start))))
    while True:  # the centre of mass sinks with every step, so this ends
        around = hull.neighbors[facet]
        lower = around[np.argmin(heights[around])]
        if heights[lower] >= heights[facet]:
            break
        facet = int(lower)
    down = normals[facet]
    side = np.cross(down, [1.0, 0, 0] if abs(down[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    turned = points @ np.stack([side, np.cross(-down, side), -down], 1)
    angle = rng.uniform(0, 2 * np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = turned @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    turned[:, 2] -= turned[:, 2].min()
    volume_ml = volume * 1e6
    return Body(turned, triangles, volume_ml, volume_ml * g_per_ml, (lwd[0], lwd[1], lwd[2]), kind)
