"""The edges of a training step by blocks: the same values and gradients as tensor operations have."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from regressor.network.edge_maximum import CENTROIDS, Statistics, edge_maximum

SEED = 2311
EPS = 1e-5
NAMES = ("source", "centroid", "w2", "w3", "scale", "shift")


def drawn(*, neighbours: int = 64, centroids: int = 2 * CENTROIDS + 3, repeated: int = 0) -> list[Tensor]:
    """Source, centroid, both weights, scale and shift of a norm; the last `repeated` neighbours are the first again."""
    generator = torch.Generator().manual_seed(SEED)
    shapes = ((3, neighbours, 24), (3, centroids, 24), (20, 24), (40, 20), (20,), (20,))
    out = [torch.randn(shape, generator=generator) for shape in shapes]
    if repeated:
        out[0][:, -repeated:] = out[0][:, :repeated]
    return out


def plainly(parts: list[Tensor], fixed: Statistics | None) -> Tensor:
    """What `edge_maximum` is documented to be, in the dtype of `parts`."""
    source, centroid, w2, w3, scale, shift = parts
    edges = torch.relu(source[:, None] - centroid[:, :, None])
    inputs = edges @ w2.T
    mean = inputs.mean((0, 1, 2)) if fixed is None else fixed.mean.to(inputs.dtype)
    variance = inputs.var((0, 1, 2), correction=0) if fixed is None else fixed.variance.to(inputs.dtype)
    awake = torch.relu((inputs - mean) / torch.sqrt(variance + EPS) * scale + shift)
    return (awake @ w3.T).amax(2)


def gradients(out: Tensor, parts: list[Tensor]) -> dict[str, Tensor]:
    towards = torch.linspace(-1, 1, out.numel(), dtype=out.dtype).reshape(out.shape)
    return dict(zip(NAMES, torch.autograd.grad((out * towards).sum(), parts), strict=True))


def off(found: Tensor, expected: Tensor) -> float:
    """Share of the expected one's length."""
    return float((found.detach().double() - expected.detach()).norm() / expected.detach().norm())


FIXED = Statistics(torch.linspace(-1, 1, 20), torch.linspace(0.5, 20, 20), 0)


@pytest.mark.parametrize("fixed", [None, FIXED], ids=["own statistics", "fixed statistics"])
@pytest.mark.parametrize("repeated", [0, 30])
def test_values_statistics_and_gradients_are_those_of_the_plain_form(fixed: Statistics | None, repeated: int) -> None:
    """Of equal maxima the first takes the gradient, so those of repeated neighbours are compared as their sum."""
    parts = [part.requires_grad_() for part in drawn(repeated=repeated)]
    exact = [part.detach().double().requires_grad_() for part in parts]
    expected = plainly(exact, fixed)
    source, centroid, w2, w3, scale, shift = parts
    out, used = edge_maximum(source, centroid, (w2, w3), (scale, shift), fixed=fixed, eps=EPS, compute=torch.float32)
    assert torch.allclose(out.double(), expected, atol=1e-4)
    found, true = gradients(out, parts), gradients(expected, exact)
    if repeated:
        for one in (found, true):
            one["source"][:, :repeated] += one["source"][:, -repeated:]
            one["source"] = one["source"][:, :-repeated]
    assert {name: off(found[name], true[name]) < 1e-4 for name in NAMES} == dict.fromkeys(NAMES, True)
    if fixed is None:
        inputs = torch.relu(source[:, None] - centroid[:, :, None]) @ w2.T
        assert torch.allclose(used.mean, inputs.mean((0, 1, 2)), atol=1e-5)
        assert torch.allclose(used.variance, inputs.var((0, 1, 2), correction=0), rtol=1e-4)
        assert used.rows == inputs.shape[:3].numel()
    else:
        assert used is fixed


def test_in_bfloat16_both_stray_alike_from_the_exact_gradients() -> None:
    parts = [part.requires_grad_() for part in drawn()]
    exact = [part.detach().double().requires_grad_() for part in parts]
    source, centroid, w2, w3, scale, shift = parts
    out, _ = edge_maximum(source, centroid, (w2, w3), (scale, shift), fixed=None, eps=EPS, compute=torch.bfloat16)
    expected = plainly(exact, None)
    assert off(out, expected) < 0.01
    narrow = [part.detach().bfloat16().requires_grad_() for part in parts]
    by_torch = gradients(plainly(narrow, None), narrow)
    found, true = gradients(out, parts), gradients(expected, exact)
    assert all(off(found[name], true[name]) < 1.5 * off(by_torch[name], true[name]) + 0.01 for name in NAMES)


@pytest.mark.parametrize(("neighbours", "centroids"), [(1, 1), (7, CENTROIDS), (256, 2)])
def test_any_number_of_neighbours_and_centroids(neighbours: int, centroids: int) -> None:
    parts = [part.requires_grad_() for part in drawn(neighbours=neighbours, centroids=centroids)]
    source, centroid, w2, w3, scale, shift = parts
    out, _ = edge_maximum(source, centroid, (w2, w3), (scale, shift), fixed=FIXED, eps=EPS, compute=torch.float32)
    exact = [part.detach().double().requires_grad_() for part in parts]
    true = gradients(plainly(exact, FIXED), exact)
    found = gradients(out, parts)
    assert all(off(found[name], true[name]) < 1e-4 for name in NAMES)
