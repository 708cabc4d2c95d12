"""What SH bands gain and cost: against least squares on the images and dense determinants."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.fisher.information import fisher_information
from framework.kernels import rasterize
from framework.kernels.reference import sh_basis
from framework.toolbox.bands import BandsEvidence, bands_evidence
from framework.types import Gaussians
from plugins.capacity.evidence import Evidence
from tests.capacity.population import pulls, watched
from tests.plugins.fakes import Log, stage, wall_of_gaussians

NOISE = 1e-4


def coloured(n: int, degree: int, strength: float = 0.1) -> Gaussians:
    """The wall with random bands, nowhere darker than 0."""
    wall = wall_of_gaussians(n)
    terms = (degree + 1) ** 2 - 1
    draws = stream(0, "bands").normal(0, strength, (n, terms, 3)).astype(np.float32)
    return replace(wall, shN=torch.from_numpy(draws))


def evidence(subject: Gaussians, noise: float = NOISE) -> BandsEvidence:
    views = stage()[0]
    reference = [fisher_information(subject, view.camera).diagonal[:, 11:] for view in views]
    return bands_evidence(subject, [view.camera.center for view in views], reference, noise)


@pytest.mark.parametrize("degree", [1, 3])
def test_the_gain_is_what_the_best_single_colour_misses(degree: int) -> None:
    """For a single Gaussian, a pixel is weight x colour, whatever the colour."""
    subject = coloured(1, degree)
    actual = evidence(subject)
    rows = []
    for view in stage()[0]:
        direction = torch.nn.functional.normalize(subject.means - view.camera.center, dim=1)
        values = sh_basis(direction.float(), degree)[0]
        mine = subject.sh0[0, 0] * values[0] + (values[1:, None] * subject.shN[0]).sum(0)
        weight = rasterize(subject, view.camera).alpha.square().double().sum()
        rows.append((float(weight), mine.double().numpy()))
    weights, colours = (np.array(column) for column in zip(*rows, strict=True))
    mean = (weights[:, None] * colours).sum(0) / weights.sum()
    missed = (weights[:, None] * (colours - mean) ** 2).sum()
    assert missed > 0
    assert actual.gain[0] == pytest.approx(missed / (2 * NOISE), rel=1e-3)
    assert actual.sh0[0] * float(values[0]) == pytest.approx(mean, rel=1e-3)
    # what the images really lose, with that colour in the place of the bands
    plain = subject.replace(sh0=torch.from_numpy(actual.sh0[:, None]).float())
    plain = plain.with_bands(torch.zeros(1, dtype=torch.bool))
    pairs = [
        (rasterize(subject, view.camera).rgb, rasterize(plain, view.camera).rgb)
        for view in stage()[0]
    ]
    lost = sum(float((ours - theirs).square().double().sum()) for ours, theirs in pairs)
    assert lost == pytest.approx(missed, rel=1e-3)


def test_the_cost_is_half_the_log_determinant_of_what_the_views_tell() -> None:
    subject = coloured(5, 2)
    cost = evidence(subject).cost
    spread = float(subject.shN.square().double().mean())
    views = stage()[0]
    expected = np.full(5, math.log(2))
    reference = [
        fisher_information(subject, view.camera).diagonal[:, 11:].double() for view in views
    ]
    for i in range(5):
        for channel in range(3):
            weights = np.array([4 * math.pi * float(k[i, channel]) for k in reference])
            centers = torch.stack([view.camera.center for view in views])
            directions = torch.nn.functional.normalize(subject.means[i] - centers, dim=1)
            y = sh_basis(directions, 2)[:, 1:].numpy()
            # sh0's flat prior: the Schur complement of its block
            joint = np.einsum("v,vk,vl->kl", weights, y, y)
            mean = np.einsum("v,vk->k", weights, y)
            joint = joint - np.outer(mean, mean) / weights.sum()
            expected[i] += 0.5 * np.linalg.slogdet(np.eye(8) + spread / NOISE * joint)[1]
    assert np.allclose(cost, expected, rtol=1e-6)


def test_bands_stay_where_they_pay() -> None:
    """Half of the wall is coloured by direction far beyond the noise, half hardly at all."""
    strong = coloured(100, 1)
    shN = strong.shN.clone()
    shN[50:] *= 1e-4
    subject = strong.replace(shN=shN)
    log = Log({})
    ctx = replace(watched(subject, 69, log), sh_degree=1)
    views = [replace(view, image=ctx.render(view.camera).rgb) for view in ctx.views]
    ctx = replace(ctx, views=tuple(views))
    method = Evidence()
    edits, _ = method.update(ctx, method.init_state(ctx), pulls(torch.ones(100)))
    assert edits is not None and edits.bands is not None
    assert not edits.bands[50:].any() and edits.bands[:50].float().mean() > 0.8
    assert edits.keep is not None and edits.sh0 is not None
    assert log.values["bands_dropped"][0] == float((edits.keep & ~edits.bands).sum())
    assert torch.equal(edits.sh0[edits.bands], subject.sh0[edits.bands])
    assert not torch.equal(edits.sh0[~edits.bands], subject.sh0[~edits.bands])
