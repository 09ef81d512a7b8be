"""Where shadow rays of a shading point leave, and what is known of it there."""

import numpy as np
import pytest

from lumigate.core.jit import kernel
from lumigate.core.lamps.departures import FACES, on_one_facet, place_of, position_at, surface_at
from lumigate.core.sampling.hashing import hash_combine
from lumigate.core.sampling.sequences import sobol
from lumigate.core.view.points import SPREAD, ShadingPoints, further_member


@kernel
def _counted(points, seed, number, counts):
    """How often each place of a point looks at each quarter of a lamp."""
    for i in range(number):
        scramble = hash_combine(hash_combine(seed, i), 0)
        for index in range(8):
            place = place_of(points, 0, index, scramble)
            counts[place, int(sobol(index, 0, scramble) * 2) * 2 + int(sobol(index, 1, scramble) * 2)] += 1


@pytest.mark.parametrize("seed", [0, 1, 77])
def test_every_place_sees_all_of_a_lamp(seed):
    """Were places chosen by what scrambles the sequence of the lamp's samples, each would see one half of it three times as often."""
    counts, number = np.zeros((SPREAD + 1, 4)), 20_000
    _counted(ShadingPoints.allocate(1), np.uint32(seed), number, counts)
    np.testing.assert_array_equal(counts.sum(axis=1), 2 * number)
    np.testing.assert_allclose(counts, number / 2, rtol=0.05)  # some deviations of .012


def test_places_cover_the_samples_of_a_surface_evenly():
    """Four in Sobol's order lie in the four quarters of a pixel; of fewer samples each is taken as often as any other, nearly."""
    for members in (16, 8, 4):
        for chosen in range(members):
            assert sorted([chosen, *(further_member(chosen, j, members) for j in range(SPREAD))]) == list(
                range(chosen // 4 * 4, chosen // 4 * 4 + 4)
            )
    for members in (1, 2, 3, 5, 7):
        found = [[chosen, *(further_member(chosen, j, members) for j in range(SPREAD))] for chosen in range(members)]
        assert set(np.ravel(found)) == set(range(members))


def test_a_place_has_its_own_surface():
    points = ShadingPoints.allocate(1)
    points.position[0], points.ns[0], points.ng[0], points.triangle[0] = (1, 2, 3), (0, 0, 1), (0, 0, 1), 5
    points.spread[0, 1], points.facet[0, 1] = (0.5, 0, -1), 9
    points.varied[0, 2, FACES : FACES + 3] = (1, 0, -1)
    assert position_at(points, 0, 0) == (1, 2, 3) and position_at(points, 0, 2) == (1.5, 2, 2)
    assert surface_at(points, 0, 0) == (0, 0, 1, 0, 0, 1, 5)
    assert surface_at(points, 0, 2) == (0, 0, 1, 1, 0, 0, 9)
    assert on_one_facet(points, 0, 1) and not on_one_facet(points, 0, 2)
