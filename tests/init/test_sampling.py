"""Laws of the sampling: whole budgets, exact inclusion probabilities."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from framework.compute.rng import stream
from framework.initialize.sampling import FLOOR, detail_density, draw, inclusion_probabilities

densities = st.lists(st.floats(0.01, 100), min_size=2, max_size=60).map(np.array)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(densities, st.integers(1, 70), st.integers(0, 5))
def test_probabilities_sum_to_the_budget_and_draws_keep_it(
    density: np.ndarray, budget: int, seed: int
) -> None:
    probability = inclusion_probabilities(density, budget)
    n = min(budget, len(density))
    assert np.isclose(probability.sum(), n) and (probability > 0).all() and (probability <= 1).all()
    assert (np.diff(probability[np.argsort(density)]) >= -1e-12).all()
    chosen = draw(probability, stream(seed, "test/draw"))
    assert len(chosen) == n and (np.diff(chosen) > 0).all()


def test_probabilities_follow_the_density_where_below_one() -> None:
    probability = inclusion_probabilities(np.array([1.0, 2.0, 3.0, 1000.0]), 2)
    np.testing.assert_allclose(probability, [1 / 6, 2 / 6, 3 / 6, 1])


def test_each_pixel_is_drawn_with_its_probability() -> None:
    probability = inclusion_probabilities(np.array([1.0, 2.0, 3.0, 4.0, 30.0]), 3)
    counts, n = np.zeros(5), 4000
    for seed in range(n):
        counts[draw(probability, stream(seed, "test/draw"))] += 1
    deviation = np.abs(counts / n - probability)
    assert (deviation <= 4 * np.sqrt(probability * (1 - probability) / n) + 1e-12).all()


def test_density_peaks_at_an_edge_and_ignores_brightness() -> None:
    image = np.zeros((3, 40, 60), np.float32)
    image[:, :, 30:] = 0.5
    density = detail_density(image, 0.5)
    assert density.argmax(1).min() >= 28 and density.argmax(1).max() <= 31
    np.testing.assert_allclose(density[:, 0], FLOOR)
    np.testing.assert_allclose(detail_density(image + 0.25, 0.5), density, atol=1e-6)
