"""Only some Gaussians have SH bands above 0: the others are as if theirs were zero, and stored
without."""

import pytest
import torch
from torch import Tensor

from framework.fisher.information import fisher_information
from framework.kernels import rasterize
from framework.kernels.reference import cutoff_margin, project, rasterize_reference
from framework.plugin import Edits
from framework.train.field import apply_edits
from framework.train.optim import Adam
from framework.types import Gaussians, concatenate
from tests.numerics.scenes import Case, random_case
from tests.record.fakes import make_gaussians


def mixed_case(seed: int, banded: int) -> tuple[Case, Gaussians, Gaussians]:
    """A case of SH degree seed % 4 > 0, the Gaussians of which the first `banded` have bands, and
    the same with zeros stored for the others."""
    case = random_case(seed)
    bands = case.gaussians.shN
    zeros = torch.cat([bands[:banded], torch.zeros_like(bands[banded:])])
    return case, case.gaussians.replace(shN=bands[:banded]), case.gaussians.replace(shN=zeros)


def _leaves(gaussians: Gaussians) -> Gaussians:
    return gaussians.map(lambda t: t.detach().clone().requires_grad_())


@pytest.mark.parametrize("banded", [1, 16, 37, 80])
@pytest.mark.parametrize("seed", [1, 6, 11])
def test_no_bands_are_zero_bands_to_the_bit(seed: int, banded: int) -> None:
    case, mixed, padded = mixed_case(seed, banded)
    images, gradients = [], []
    for gaussians in map(_leaves, (mixed, padded)):
        render = rasterize(gaussians, case.camera, background=case.background)
        loss = (render.rgb * torch.linspace(0, 1, render.rgb.numel()).view_as(render.rgb)).sum()
        images.append(render.rgb.detach())
        gradients.append(torch.autograd.grad(loss, [tensor for _, tensor in gaussians.items()]))
    assert torch.equal(*images)
    for name, ours, theirs in zip(dict(mixed.items()), *gradients, strict=True):
        assert torch.equal(ours, theirs[: len(ours)]), name
    ours, theirs = (fisher_information(g, case.camera) for g in (mixed, padded))
    assert torch.equal(ours.block, theirs.block) and torch.equal(ours.diagonal, theirs.diagonal)


@pytest.mark.parametrize("seed", [2, 3])
def test_kernels_and_reference_agree(seed: int) -> None:
    case, mixed, _ = mixed_case(seed, 20)
    off = cutoff_margin(project(mixed.map(Tensor.double), case.camera), case.camera) > 1e-3
    for degree in range(seed % 4 + 1):
        ours = rasterize(mixed, case.camera, sh_degree=degree).rgb[:, off]
        theirs = rasterize_reference(mixed, case.camera, sh_degree=degree).rgb[:, off]
        torch.testing.assert_close(ours, theirs, rtol=0, atol=2e-5)


def _mixed(n: int, banded: int) -> Gaussians:
    whole = make_gaussians(n, 1)
    return whole.replace(shN=whole.shN[:banded])


def _as_rows(gaussians: Gaussians) -> set[tuple[float, ...]]:
    """Every Gaussian with all it holds, whatever its place."""
    rows = []
    for i in range(len(gaussians)):
        parts = [t[i].flatten() for name, t in gaussians.items() if name != "shN"]
        parts += [gaussians.shN[i].flatten()] if i < len(gaussians.shN) else []
        rows.append(tuple(torch.cat(parts).tolist()))
    assert len(set(rows)) == len(rows)
    return set(rows)


def _chosen(n: int, *rows: int) -> Tensor:
    mask = torch.zeros(n, dtype=torch.bool)
    mask[list(rows)] = True
    return mask


def test_masks_and_row_numbers_choose_whole_gaussians() -> None:
    subject = _mixed(10, 6)
    for chosen in (subject[_chosen(10, 1, 5, 7)], subject[torch.tensor([5, 1, 7])]):
        assert len(chosen) == 3 and len(chosen.shN) == 2
        assert _as_rows(chosen) < _as_rows(subject)
    for rows in ([7, 5, 1], [-1]):
        with pytest.raises(ValueError, match="sort them"):
            subject[torch.tensor(rows)]


def test_concatenation_keeps_every_gaussian_whole() -> None:
    parts = [_mixed(10, 6), _mixed(5, 0), _mixed(7, 7)]
    joined = concatenate(parts)
    assert len(joined) == 22 and len(joined.shN) == 13
    assert _as_rows(joined) == set.union(*map(_as_rows, parts))


def test_an_edit_drops_bands_of_parameters_and_moments_alike() -> None:
    params = _mixed(10, 6)
    gradients = make_gaussians(10, 1)
    gradients = gradients.replace(shN=gradients.shN[:6])
    adam = Adam(params)
    adam.step(params, gradients, dict.fromkeys(dict(params.items()), 0.01))
    moments = adam.state().first.clone()
    edits = Edits(keep=~_chosen(10, 0, 8), bands=_chosen(10, 0, 2, 4, 9), append=_mixed(3, 1))
    assert edits.changes_the_rows
    edited = apply_edits(params, adam, edits, "here")
    assert len(edited) == 11 and len(edited.shN) == 3
    # with bands: 2, 4 and the first new one; without: 1, 3, 5, 6, 7, 9 and two new ones
    order = torch.tensor([2, 4, 1, 3, 5, 6, 7, 9])
    old = torch.tensor([0, 1, *range(3, 9)])
    assert torch.equal(edited.means[old], params.means[order])
    assert torch.equal(edited.shN[:2], params.shN[[2, 4]])
    after = adam.state().first
    assert torch.equal(after.means[old], moments.means[order])
    assert torch.equal(after.shN[:2], moments.shN[[2, 4]]) and not after.shN[2].any()
    adam.step(edited, edited.clone(), dict.fromkeys(dict(params.items()), 0.01))
